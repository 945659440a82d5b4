"""The floor of a recording tells which way is up, where the recording does not say it.

Some frames are read, and every pixel of theirs votes with its surface's normal, by the area that it shows. Of the
normals within `WITHIN_DEG` of the axis that is usual for the format, the largest group is the floor's, tables'
included, if few points lie below its largest plane; that plane, fitted to its points, says where up is. Ceilings look
down and do not vote. Rejected: the mean of the camera's own up, which tilts as a hand does.

Not here: rooms without a floor in sight, slopes, and cameras that lie on their side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.formats import format_count
from xihenet.io.frame_files import FrameCamera
from xihenet.records import ArrayBool, ArrayF64, RgbdFrame

N_FRAMES, POINTS_PER_FRAME = 12, 3000
REACH = 1 / 24  # Of a picture's width, to either side: some 10 cm at 2 m, over which noise of 1 cm turns a normal by 6
WITHIN_DEG = 50.0  # Of the usual axis: a wall is at 90 minus the tilt, and a tilt of 40 is a phone held at the floor
AGREEING_DEG = (8.0, 5.0)  # Of the group's mean, at first and once it is found
N_CANDIDATES = 200
THICK_M = 0.06  # Within so much of its height a point belongs to the plane: 1 % of 5 m, and as much again
FEWEST_POINTS, LEAST_SHARE = 200, 0.04  # Of the area that is seen
MOST_BELOW = 0.1  # Share of all points that may lie below a floor: what a sensor says of mirrors and of windows
LEAST_IN_FRAME = 20  # Points by which a frame shows it


def upright(capture: Capture, assumed: str) -> Capture:
    """`capture`, of which `assumed` was taken to point up, turned so that its floor does; and a note that says so.

    Reads N_FRAMES of it, and raises as they do. Where no floor is found, it stays as it is.
    """
    n = len(capture.frames)
    looked_at = [capture.frames[i] for i in np.linspace(0, n - 1, min(n, N_FRAMES)).round().astype(int)]
    seen = [_surfaces(i, one.read()) for i, one in enumerate(looked_at)]
    points_m, normals, areas, frame_of = (np.concatenate(parts) for parts in zip(*seen, strict=True))
    found = floor_normal(points_m, normals, areas)
    axis = assumed.upper() if assumed.startswith("-") else f"+{assumed.upper()}"
    if found is None:
        n_without = format_count(len(looked_at), "frame")
        note = f"Which way is up is not given, and {n_without} show no floor: {axis} is taken."
        return replace(capture, notes=(*capture.notes, note))
    up, is_floor = found
    n_show = int(np.count_nonzero(np.bincount(frame_of[is_floor]) >= LEAST_IN_FRAME))
    off = np.degrees(np.arccos(np.clip(up[2], -1, 1)))
    shown = f"{format_count(n_show, 'frame')} show{'s' if n_show == 1 else ''}"
    note = f"Up is the normal of the floor, which {shown}: {off:.1f} degrees from {axis}."
    turn = rotation_between(up, np.array([0.0, 0, 1]))
    frames = [_turned(frame, turn) for frame in capture.frames]
    return replace(
        capture, frames=frames, blender_from_file=turn @ capture.blender_from_file, notes=(*capture.notes, note)
    )


def floor_normal(points_m: ArrayF64, normals: ArrayF64, areas: ArrayF64) -> tuple[ArrayF64, ArrayBool] | None:
    """Unit (3,) upward normal of the floor, and which points lie on it, (P,); None where there is none.

    `points_m`, `normals` (P, 3), unit, towards the camera, and `areas` (P,) that each stands for, are those of a world
    in which +Z is about up.
    """
    may_be = normals[:, 2] > np.cos(np.radians(WITHIN_DEG))
    if np.count_nonzero(may_be) < FEWEST_POINTS:
        return None
    up = _largest_group(normals[may_be], areas[may_be])
    agrees = normals @ up > np.cos(np.radians(AGREEING_DEG[-1]))
    heights = points_m @ up
    level = _heaviest_level(heights[agrees], areas[agrees], heights, areas)
    if level is None:
        return None
    is_floor = agrees & (np.abs(heights - level) < THICK_M)
    if np.count_nonzero(is_floor) < FEWEST_POINTS or areas[is_floor].sum() < LEAST_SHARE * areas.sum():
        return None
    on_floor = points_m[is_floor] - np.average(points_m[is_floor], axis=0, weights=areas[is_floor])
    fitted = np.linalg.eigh((on_floor * areas[is_floor, None]).T @ on_floor)[1][:, 0]
    return fitted * np.sign(fitted @ up), is_floor


def _largest_group(normals: ArrayF64, areas: ArrayF64) -> ArrayF64:
    """Unit (3,) about which most area has its normals; nearer to +Z counts for more, since walls are far from it."""
    picked = normals[:: max(1, len(normals) // N_CANDIDATES)]
    weight = areas * normals[:, 2] ** 2
    votes = (picked @ normals.T > np.cos(np.radians(AGREEING_DEG[0]))) @ weight
    up: ArrayF64 = picked[votes.argmax()]
    for degrees in AGREEING_DEG:
        agrees = normals @ up > np.cos(np.radians(degrees))
        mean = (normals[agrees] * areas[agrees, None]).sum(axis=0)
        up = mean / np.linalg.norm(mean)
    return up


def _heaviest_level(levels: ArrayF64, weights: ArrayF64, all_heights: ArrayF64, areas: ArrayF64) -> float | None:
    """Height of the plane with most area among `levels` that has little below it; None if there is none."""
    low = float(levels.min())
    bins = ((levels - low) / (THICK_M / 2)).astype(np.intp)
    by_bin = np.pad(np.bincount(bins, weights), 1)
    by_plane = by_bin[:-2] + by_bin[1:-1] + by_bin[2:]
    for at in by_plane.argsort()[::-1]:
        if by_plane[at] <= 0:
            return None
        level = low + (at + 0.5) * THICK_M / 2
        if areas[all_heights < level - THICK_M].sum() < MOST_BELOW * areas.sum():
            return float(level)
    return None


def _surfaces(number: int, frame: RgbdFrame) -> tuple[ArrayF64, ...]:
    """Points and normals (P, 3), areas (P,) and `number` (P,), of pixels of which both neighbours are near."""
    height, width = frame.plane_depth_m.shape
    points = unproject_frame(frame).points_m.reshape(height, width, 3).astype(np.float64)
    points[~valid_plane_depth(frame.plane_depth_m)] = np.nan
    step = max(1, round((height * width / POINTS_PER_FRAME) ** 0.5))
    reach = max(1, round(width * REACH))
    if height <= 2 * reach or width <= 2 * reach:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp)
    rows, columns = (np.arange(reach, n - reach, step) for n in (height, width))
    at = points[np.ix_(rows, columns)]
    across = points[np.ix_(rows, columns + reach)] - points[np.ix_(rows, columns - reach)]
    down = points[np.ix_(rows + reach, columns)] - points[np.ix_(rows - reach, columns)]
    normals = np.cross(down, across)
    areas = np.linalg.norm(normals, axis=-1)
    # An edge between a near and a far surface has a normal too: there, both halves of a step differ.
    bends = np.abs(points[np.ix_(rows, columns + reach)] + points[np.ix_(rows, columns - reach)] - 2 * at)
    bends += np.abs(points[np.ix_(rows + reach, columns)] + points[np.ix_(rows - reach, columns)] - 2 * at)
    with np.errstate(invalid="ignore"):  # Where there is no depth, which is not flat
        is_flat = (bends.max(axis=-1) < THICK_M) & (areas > 0)
    at, normals, areas = at[is_flat], normals[is_flat] / areas[is_flat, None], areas[is_flat]
    faces = np.sign(((frame.world_from_camera[:3, 3] - at) * normals).sum(axis=-1))
    return at, normals * faces[:, None], areas, np.full(len(at), number)


def rotation_between(start: ArrayF64, end: ArrayF64) -> ArrayF64:
    """(3, 3) the smallest rotation that takes unit (3,) `start` to `end`; they are not opposite."""
    x, y, z = np.cross(start, end)
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + skew + skew @ skew / (1 + start @ end)


def _turned(frame: CapturedFrame, turn: ArrayF64) -> CapturedFrame:
    """`frame` in a world that is turned by (3, 3)."""
    pose = frame.camera.world_from_camera.copy()
    pose[:3] = turn @ pose[:3]
    camera = FrameCamera(frame.camera.intrinsics, pose, turn @ frame.camera.blender_from_file)
    return frame.changed(lambda read: replace(read, world_from_camera=pose), camera)
