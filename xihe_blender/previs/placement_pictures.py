"""The pictures of a placement map: the room from above and through the phone, each place in the colour of its error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from xihe_blender.io.outputs import write_picture
from xihe_blender.io.placement_results import Place, PlacementResults
from xihe_blender.previs.room_from_above import DIMMED, WIDTH_PX, RoomFromAbove
from xihe_blender.report.placement import RAMP
from xihenet.camera import project_points, valid_plane_depth
from xihenet.records import ArrayF64, ArrayU8, RgbdFrame

UNKNOWN = (128.0, 128.0, 128.0)
AROUND_M = 0.4
"""Of the room that is shown beyond the outermost places."""

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
    """The room with the places as squares, the highest on top."""
    room = RoomFromAbove(frames, positions, max(AROUND_M, 2 * spacing_m))
    half = max(1, int(0.28 * spacing_m * room.pixels_per_m))
    for k in np.argsort(positions[:, 2], kind="stable"):
        room.square(positions[k], painted[k], half)
    return room.picture.round().astype(np.uint8)


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
