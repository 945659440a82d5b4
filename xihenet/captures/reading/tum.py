"""Recordings of the TUM RGB-D benchmark: rgb.txt, depth.txt and groundtruth.txt beside pictures.

Colour, depth and poses have times of their own. A colour picture goes with the depth next to it in time, and with the
pose between those around it; more than AT_MOST_S away there is none. A pose with a number that is not finite, of a
moment at which tracking was lost, counts for none. Poses are camera to world, the camera looks along +Z with +Y down,
the world has +Z up. Depth is 16-bit, 5,000 to a metre. Intrinsics are not among the benchmark's files: they are those
that its own tools take for all of its cameras, unless a camera.json (`width`, `height`, `fx`, `fy`, `cx`, `cy`) lies
beside them, as we write one for another camera.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xihenet.captures.capture import Capture, CapturedFrame, inside
from xihenet.captures.reading.phone_frame import left_out, picture_frame
from xihenet.captures.reading.values import numbers, of_length_1, pose_numbers, pose_of
from xihenet.io.frame_files import BLENDER_FROM_UP, camera_facts, frame_camera
from xihenet.io.image_files import read_plane_depth
from xihenet.io.json_files import named, read_json
from xihenet.io.picture_size import same_field
from xihenet.records import ArrayF64, Intrinsics

FILES = ("rgb.txt", "depth.txt", "groundtruth.txt")
AT_MOST_S = 0.02
METRES_PER_UNIT = 1 / 5000
CAMERA, CAMERA_KEYS = "camera.json", ("width", "height", "fx", "fy", "cx", "cy")
OF_ANOTHER = f"For another camera, write its {', '.join(CAMERA_KEYS)} to {CAMERA}, beside {FILES[0]}"
# The middle of the first pixel is at 0.5 here and at 0 there.
INTRINSICS = Intrinsics(640, 480, 525.0, 525.0, 320.0, 240.0)


def is_in(folder: Path) -> bool:
    return all((folder / name).is_file() for name in FILES)


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`."""
    up = up or "z"
    colours, depths, poses = (_lines(folder / name, n) for name, n in zip(FILES, (1, 1, 7), strict=True))
    depth_s = np.array([time_s for time_s, _ in depths])
    tracked = [(time_s, pose_numbers(row, 7, str(folder / FILES[2]))) for time_s, row in poses]
    pose_s = np.array([time_s for time_s, row in tracked if row is not None])
    values = np.array([row for _, row in tracked if row is not None])
    if not len(pose_s):
        raise ValueError(f"{folder / FILES[2]}: expected finite numbers, and tracking was lost in all lines")
    intrinsics, notes = _intrinsics(folder / CAMERA)
    frames: list[CapturedFrame] = []
    for number, (time_s, (name,)) in enumerate(colours, start=1):
        nearest = int(np.abs(depth_s - time_s).argmin())
        with named(folder / FILES[2]):
            pose = _pose_at(time_s, pose_s, values)
        colour, plane_depth = inside(folder, name), inside(folder, depths[nearest][1][0])
        if (
            abs(depth_s[nearest] - time_s) > AT_MOST_S
            or pose is None
            or not (colour.is_file() and plane_depth.is_file())
        ):
            continue
        if notes and not frames:
            _check_size(folder, *read_plane_depth(plane_depth, METRES_PER_UNIT)[1])
        camera = frame_camera(intrinsics, pose.tolist(), is_opencv=True, up=up)
        frames.append(picture_frame(number, time_s - colours[0][0], camera, colour, plane_depth, METRES_PER_UNIT))
    if not frames:
        raise ValueError(f"{folder}: no colour picture has depth and a pose within {AT_MOST_S:g} s of it")
    notes += left_out(len(colours) - len(frames), "colour, depth or a pose")
    return Capture("TUM RGB-D", frames, BLENDER_FROM_UP[up], notes, is_opencv=True)


def _intrinsics(path: Path) -> tuple[Intrinsics, tuple[str, ...]]:
    """Those of camera.json, or the benchmark's and a note that says so."""
    if not path.is_file():
        return INTRINSICS, (f"Intrinsics are those that the benchmark takes for all of its cameras. {OF_ANOTHER}.",)
    content = read_json(path)
    with named(path):
        return camera_facts(content, CAMERA_KEYS)[0], ()


def _check_size(folder: Path, width: int, height: int) -> None:
    k = INTRINSICS
    if not same_field(width, height, k.width, k.height):
        said = f"pictures have {width}x{height} pixels, and the benchmark's {k.width}x{k.height}"
        raise ValueError(f"{folder}: its {said}. {OF_ANOTHER}")


def _lines(path: Path, n_values: int) -> list[tuple[float, list[str]]]:
    """Time and the other values of each line, by rising time."""
    lines = [line.split() for line in path.read_text(encoding="utf-8-sig", errors="replace").splitlines()]
    numbered = [(number, row) for number, row in enumerate(lines, 1) if row and not row[0].startswith("#")]
    expected = f"expected lines of a time and {n_values} more values"
    for number, row in numbered:
        if len(row) != 1 + n_values:
            raise ValueError(
                f"{path}, line {number}: {expected}, got {len(row)} in all: copy the file again, or delete the line"
            )
    rows = [row for _, row in numbered]
    if not rows:
        raise ValueError(f"{path}: {expected}, got no line: copy the file again")
    times = [float(numbers(row[:1], 1, str(path))[0]) for row in rows]
    return sorted(((time_s, row[1:]) for time_s, row in zip(times, rows, strict=True)), key=lambda one: one[0])


def _pose_at(time_s: float, pose_s: ArrayF64, values: ArrayF64) -> ArrayF64 | None:
    """(4, 4) between the poses around that time; None where one of them is too far away."""
    after = int(np.searchsorted(pose_s, time_s))
    around = [max(after - 1, 0), min(after, len(pose_s) - 1)]
    if np.abs(pose_s[around] - time_s).min() > AT_MOST_S:
        return None
    first, second = (
        np.concatenate([values[i, :3], of_length_1(values[i, 3:], f"pose at {pose_s[i]:.15g} s")]) for i in around
    )
    span = pose_s[around[1]] - pose_s[around[0]]
    share = float(np.clip((time_s - pose_s[around[0]]) / span, 0, 1)) if span > 0 else 0.0
    if second[3:] @ first[3:] < 0:
        second = np.concatenate([second[:3], -second[3:]])
    place = (1 - share) * first + share * second
    return pose_of(place[:3], place[3:])
