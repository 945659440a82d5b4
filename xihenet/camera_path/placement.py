"""Places in a room where an object could stand or hang, as far as the frames of a path show it.

Two kinds: on upward surfaces that were seen, and in free air at a height. What nobody has seen is no place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from xihenet.camera import pixels_in_view, unproject_frame, valid_plane_depth
from xihenet.records import ArrayBool, ArrayF64, ArrayInt, RgbdFrame

Item = TypeVar("Item")

UPWARD = np.cos(np.radians(20.0))
"""Least z of a normal that counts as upward: a table that stands askew does, a cushion's flank does not."""

SAME_HEIGHT_M = 0.08
FEWEST_PIXELS = 4
"""Of one cell, over all frames: fewer are noise along an edge."""

MOST_IN_AIR = 10_000_000
"""Places of a grid that are looked at: more fit no memory."""

REACH_M = 5.0
"""From the camera: a phone's LiDAR sees no farther, and a garden behind a window is no place for an object."""


def evenly_chosen(found: Sequence[Item], most: int) -> list[Item]:
    """At most so many of what was found, evenly spread."""
    n = min(most, len(found))
    return [found[(2 * k + 1) * len(found) // (2 * n)] for k in range(n)]


def upward_points(frames: Sequence[RgbdFrame], reach_m: float = REACH_M) -> ArrayF64:
    """(P, 3) world, metres: what pixels of the frames show of upward surfaces within `reach_m` of the camera.

    Empty is legal.
    """
    return np.concatenate([np.zeros((0, 3)), *(_upward_points(frame, reach_m) for frame in frames)])


def places_among(points: ArrayF64, spacing_m: float) -> ArrayF64:
    """(K, 3) of (P, 3), world, metres: at most one place per cell of `spacing_m` and per height.

    A place is the mean of the points of its cell. In order of height, then y, then x. Empty is legal.
    ValueError for a spacing that is not positive.
    """
    if not spacing_m > 0:
        raise ValueError(f"places_among: expected a positive spacing, got {spacing_m}")
    if not len(points):
        return np.zeros((0, 3))
    cells = np.floor(points / (spacing_m, spacing_m, SAME_HEIGHT_M)).astype(np.int64)[:, ::-1]
    # One number for each cell, in order of height, then y, then x: rows are ten times as slow to sort.
    lowest = cells.min(axis=0)
    _, n_y, n_x = (int(n) for n in cells.max(axis=0) - lowest + 1)
    z, y, x = (cells - lowest).T
    keys, index, counts = np.unique((z * n_y + y) * n_x + x, return_inverse=True, return_counts=True)
    index = index.reshape(-1)
    means = np.stack([np.bincount(index, points[:, axis]) / counts for axis in range(3)], axis=1)
    return means[(counts >= FEWEST_PIXELS) & ~_beside_a_fuller_one(keys, counts, n_y * n_x)]


def _beside_a_fuller_one(keys: ArrayInt, counts: ArrayInt, a_storey: int) -> ArrayBool:
    """Cells right below or above one with more pixels: one surface, cut by the grid of heights."""
    above, below = _counts_of(keys + a_storey, keys, counts), _counts_of(keys - a_storey, keys, counts)
    return (above > counts) | (below >= counts)


def _counts_of(wanted: ArrayInt, keys: ArrayInt, counts: ArrayInt) -> ArrayInt:
    """The counts of the cells `wanted`, 0 for those that are not among `keys`, which ascend."""
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, counts[at], 0)


def _upward_points(frame: RgbdFrame, reach_m: float) -> ArrayF64:
    """Pixels within reach whose neighbours on both sides agree that the surface looks up, (K, 3)."""
    shape = (frame.intrinsics.height, frame.intrinsics.width, 3)
    points = unproject_frame(frame).points_m.astype(np.float64).reshape(shape)
    points[~valid_plane_depth(frame.plane_depth_m)] = np.nan  # An opening has points, and is no surface.
    inner, right, left = points[1:-1, 1:-1], points[1:-1, 2:], points[1:-1, :-2]
    upper, lower = points[:-2, 1:-1], points[2:, 1:-1]
    # What is not finite looks nowhere.
    with np.errstate(invalid="ignore"):
        is_up = _looks_up(right - inner, upper - inner) & _looks_up(inner - left, inner - lower)
        is_near = np.linalg.norm(inner - frame.world_from_camera[:3, 3], axis=-1) <= reach_m
    return inner[is_up & is_near]


def _looks_up(across: ArrayF64, upwards: ArrayF64) -> ArrayBool:
    """Whether the normal of a triangle (..., 3), as the camera sees it, looks up; a degenerate one does not."""
    normal = np.cross(across, upwards)
    return normal[..., 2] > UPWARD * np.linalg.norm(normal, axis=-1)


def seen_extent(frames: Sequence[RgbdFrame]) -> ArrayF64:
    """(2, 2) world, metres: between which x and y the frames show surfaces, but for one point in a hundred at each end.

    Empty, the low above the high, where they show none.
    """
    seen = [unproject_frame(frame).points_m[:, :2] for frame in frames]
    points = np.concatenate([np.zeros((0, 2), np.float32), *(one[np.isfinite(one).all(axis=1)] for one in seen)])
    return np.percentile(points, (1, 99), axis=0) if len(points) else np.array([[1.0, 1.0], [0.0, 0.0]])


def air_places(
    frames: Sequence[RgbdFrame], height_m: float, spacing_m: float, reach_m: float = REACH_M,
    extent_m: ArrayF64 | None = None,
) -> ArrayF64:  # fmt: skip
    """(K, 3) world, metres: a grid at z = `height_m` where a frame looks through free air within `reach_m`.

    In order of y, then x, within `extent_m`, that of the frames if it is None. Empty is legal. ValueError for a spacing
    that is not positive, or so small that more than MOST_IN_AIR places would be looked at.
    """
    if not spacing_m > 0:
        raise ValueError(f"air_places: expected a positive spacing, got {spacing_m}")
    if not frames:
        return np.zeros((0, 3))
    low, high = seen_extent(frames) if extent_m is None else extent_m
    # The seen may go on for kilometres, of which nothing is within reach.
    cameras_m = np.array([frame.world_from_camera[:2, 3] for frame in frames])
    begin = np.ceil((cameras_m.min(axis=0) - reach_m - low) / spacing_m - 0.5).clip(min=0)
    end = np.ceil((np.minimum(high, cameras_m.max(axis=0) + reach_m) - low) / spacing_m - 0.5)
    n_looked_at = float((end - begin).clip(min=0).prod())
    if not n_looked_at <= MOST_IN_AIR:
        raise ValueError(f"{n_looked_at:.2g} places {spacing_m:g} m apart are too many: give a larger spacing")
    x, y = (a + spacing_m * (np.arange(*ends) + 0.5) for a, *ends in zip(low, begin, end, strict=True))
    grid = np.stack([*(part.ravel() for part in np.meshgrid(x, y)), np.full(len(x) * len(y), height_m)], axis=1)
    is_free = np.zeros(len(grid), bool)
    for frame in frames:
        is_free |= _in_front_of_surfaces(grid, frame, reach_m)
    return grid[is_free]


def _in_front_of_surfaces(points_m: ArrayF64, frame: RgbdFrame, reach_m: float) -> ArrayBool:
    """Whether each point (K, 3) is in the picture, within reach and nearer than what its pixel shows."""
    points, pixels, depth_m = pixels_in_view(points_m, frame.intrinsics, frame.world_from_camera)
    shown_m = np.where(valid_plane_depth(frame.plane_depth_m), frame.plane_depth_m, 0).ravel()[pixels]
    is_in_reach = np.linalg.norm(points_m[points] - frame.world_from_camera[:3, 3], axis=1) <= reach_m
    is_in_front = np.zeros(len(points_m), bool)
    is_in_front[points] = is_in_reach & (depth_m < shown_m)
    return is_in_front
