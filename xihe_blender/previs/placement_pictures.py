"""The pictures of a placement map: the room from above and through the phone, each place in the colour of its error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xihe_blender.io.outputs import write_picture
from xihe_blender.io.placement_results import Place, PlacementResults
from xihe_blender.report.placement import RAMP
from xihenet.camera import project_points, unproject_frame, valid_plane_depth
from xihenet.records import ArrayF64, ArrayU8, RgbdFrame

UNKNOWN = (128.0, 128.0, 128.0)
WIDTH_PX, HEIGHT_PX = 960, 720
DIMMED = 0.7
"""Of the room's own brightness, so that the places stand out."""

AROUND_M = 0.4
"""Of the room that is shown beyond the outermost places."""

PIXELS_A_CELL = 3
"""Across, of the room in the picture from above: points lie sparser than its pixels."""

HIDDEN_M = 0.05
"""A place so far behind what its pixel shows is hidden."""


def _colours(places: Sequence[Place], error_range: tuple[float, float]) -> ArrayF64:
    """(K, 3), 0 to 255."""
    errors = np.array([np.nan if place.expected_error is None else place.expected_error for place in places])
    low, high = error_range
    share = np.clip((errors - low) / max(high - low, 1e-9), 0, 1)
    steps, known = np.linspace(0, 1, len(RAMP)), np.nan_to_num(share)
    ramp = np.stack([np.interp(known, steps, channel) for channel in np.array(RAMP).T], axis=1)
    return np.where(np.isfinite(share)[:, None], ramp, UNKNOWN)


def write_pictures(folder: Path, frames: Sequence[RgbdFrame], results: PlacementResults) -> list[Path]:
    """`above.png` and `camera.png`; their paths."""
    paths = [folder / "pictures" / "above.png", folder / "pictures" / "camera.png"]
    positions = np.array([place.position_m for place in results.places])
    painted = _colours(results.places, results.error_range)
    write_picture(paths[0], _from_above(frames, positions, painted, results.spacing_m))
    write_picture(paths[1], _through_camera(frames, positions, painted))
    return paths


def _from_above(frames: Sequence[RgbdFrame], positions: ArrayF64, painted: ArrayF64, spacing_m: float) -> ArrayU8:
    """The room below the phone, seen from above with +Y up, and the places as squares, the highest on top."""
    clouds = [unproject_frame(frame) for frame in frames]
    eyes = float(np.mean([frame.world_from_camera[2, 3] for frame in frames]))
    points = np.concatenate([cloud.points_m for cloud in clouds]).astype(np.float64)
    srgb = np.concatenate([cloud.srgb for cloud in clouds])
    kept = np.isfinite(points).all(axis=1) & (points[:, 2] < max(eyes, positions[:, 2].max()))
    points, srgb = points[kept], srgb[kept]
    rim_m = max(AROUND_M, 2 * spacing_m)
    low, high = positions[:, :2].min(axis=0) - rim_m, positions[:, :2].max(axis=0) + rim_m
    scale = min(WIDTH_PX / (high[0] - low[0]), HEIGHT_PX / (high[1] - low[1]))
    width, height = (max(1, int(side)) for side in (high - low) * scale)
    picture = np.full((height, width, 3), 24.0)
    inside = ((points[:, :2] > low) & (points[:, :2] < high)).all(axis=1)
    order = np.argsort(points[inside][:, 2], kind="stable")
    column, row = _pixels(points[inside][order], low, high, scale, (width, height))
    for down in range(PIXELS_A_CELL):
        for across in range(PIXELS_A_CELL):
            at = np.minimum(row + down, height - 1), np.minimum(column + across, width - 1)
            picture[at] = 255 * DIMMED * srgb[inside][order]
    half = max(1, int(0.28 * spacing_m * scale))
    columns, rows = _pixels(positions, low, high, scale, (width, height))
    for k in np.argsort(positions[:, 2], kind="stable"):
        x, y = int(columns[k]), int(rows[k])
        picture[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1] = painted[k]
    return picture.round().astype(np.uint8)


def _pixels(
    points: ArrayF64, low: ArrayF64, high: ArrayF64, scale: float, size: tuple[int, int]
) -> tuple[ArrayF64, ArrayF64]:
    column = ((points[:, 0] - low[0]) * scale).astype(int).clip(0, size[0] - 1)
    row = ((high[1] - points[:, 1]) * scale).astype(int).clip(0, size[1] - 1)
    return column, row


def _through_camera(frames: Sequence[RgbdFrame], positions: ArrayF64, painted: ArrayF64) -> ArrayU8:
    """The captured frame that shows the most places, with a square at each that is not hidden."""
    seen = [_visible(positions, frame) for frame in frames]
    best = int(np.argmax([visible.sum() for _, visible, _ in seen]))
    frame, (pixels, visible, depth_m) = frames[best], seen[best]
    larger = max(1, round(WIDTH_PX / frame.intrinsics.width))
    picture = frame.srgb_u8.repeat(larger, axis=0).repeat(larger, axis=1).astype(np.float64) * DIMMED
    for k in sorted(np.flatnonzero(visible), key=lambda k: -depth_m[k]):
        half = int(np.clip(0.03 * frame.intrinsics.fx * larger / depth_m[k], 2, 14))
        x, y = (pixels[k] * larger).astype(int)
        picture[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1] = painted[k]
    return picture.round().astype(np.uint8)


def _visible(positions: ArrayF64, frame: RgbdFrame) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    pixels, depth_m = project_points(positions, frame.intrinsics, frame.world_from_camera)
    inside = (depth_m > 0) & (pixels >= 0).all(axis=1)
    inside &= (pixels < (frame.intrinsics.width, frame.intrinsics.height)).all(axis=1)
    column, row = np.where(inside[:, None], pixels, 0).astype(int).T
    behind = np.where(valid_plane_depth(frame.plane_depth_m), frame.plane_depth_m, np.inf)[row, column]
    return pixels, inside & (depth_m < behind + HIDDEN_M), depth_m
