"""Surfaces of the room around an object: which flat ones, as far as the frames of a path show them?

An object casts its shadow on them: the table under it, the wall behind it. They are found in what the phone has
captured and not in the room itself, which nobody has who holds a phone.

Chosen: planes by RANSAC (Fischler and Bolles, 1981), one after the other, each fitted to its points by least squares
and cut to their outline. Rejected: a mesh of the depth picture, whose noise would be lit and shaded as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.records import ArrayBool, ArrayF64, RgbdFrame

MOST_SURFACES, MOST_TRIED = 3, 6
"""Floor and two walls: more are seldom in reach of a shadow."""

LEAST_SHARE, FEWEST_POINTS = 0.08, 40
"""Of the points in reach: fewer are a thing on the table, and no table."""

TOLERANCE = 0.02
"""Of the reach, and `TOLERANCE_M` besides: so far from its plane a point still belongs to a surface."""

TOLERANCE_M = 0.005
MOST_POINTS, N_TRIALS = 4000, 200

FILLED = 0.4
"""Least share of a surface's outline that points lie in, by squares as wide as `CELL` of the reach. A plane through the
rims of cups has holes, and a table has not."""

CELL = 0.15


@dataclass(frozen=True, eq=False)
class Surface:
    """A flat part of the room: `outline_m` (K, 3) its corners in order, convex, K >= 3, world, metres.

    `normal` (3,) is a unit vector, world, towards the object that stands in front of it. Points within `tolerance_m` of
    its plane belong to it.
    """

    outline_m: ArrayF64
    normal: ArrayF64
    tolerance_m: float

    @property
    def offset_m(self) -> float:
        """Of its plane: points on it have this product with the normal."""
        return float(self.outline_m[0] @ self.normal)


def points_within(frames: Sequence[RgbdFrame], centre_m: ArrayF64, reach_m: float) -> tuple[ArrayF64, ArrayF64]:
    """What pixels of `frames` show within `reach_m` of `centre_m` (3,), and from where: (P, 3) each, world, metres.

    Empty is legal.
    """
    found, seen_from = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for frame in frames:
        points_m = unproject_frame(frame).points_m[valid_plane_depth(frame.plane_depth_m).ravel()].astype(np.float64)
        found.append(points_m[((points_m - centre_m) ** 2).sum(axis=1) <= reach_m**2])
        seen_from.append(np.broadcast_to(frame.world_from_camera[:3, 3], found[-1].shape))
    return np.concatenate(found), np.concatenate(seen_from)


def surfaces_around(
    points_m: ArrayF64, seen_from_m: ArrayF64, centre_m: ArrayF64, reach_m: float, seed: int = 0
) -> list[Surface]:
    """The surfaces that points (P, 3) within `reach_m` of an object around `centre_m` (3,) lie on, the largest first.

    `seen_from_m` (P, 3) are the camera's places: a surface looks at the object and at those who have seen it. Points
    that are not finite are left out. Empty where there are too few, as for an object in the air. The same
    points and seed give the same surfaces. ValueError for a reach that is not positive.
    """
    if not reach_m > 0:
        raise ValueError(f"surfaces_around: expected a positive reach, got {reach_m}")
    rng = np.random.default_rng(seed)
    chosen = np.flatnonzero(np.isfinite(points_m).all(axis=1))
    if len(chosen) > MOST_POINTS:
        chosen = np.sort(rng.choice(chosen, MOST_POINTS, replace=False))
    left, seen_from_m = points_m[chosen], seen_from_m[chosen]
    fewest, tolerance_m = max(FEWEST_POINTS, LEAST_SHARE * len(left)), TOLERANCE * reach_m + TOLERANCE_M
    surfaces: list[Surface] = []
    for _ in range(MOST_TRIED):
        is_on = _largest_plane(left, tolerance_m, rng) if len(left) >= fewest else np.zeros(0, bool)
        if np.count_nonzero(is_on) < fewest or len(surfaces) == MOST_SURFACES:
            break
        surface = _surface_through(left[is_on], centre_m, tolerance_m)
        if surface is not None:
            is_on = np.abs(left @ surface.normal - surface.offset_m) <= tolerance_m
            is_faced = (seen_from_m[is_on] @ surface.normal > surface.offset_m).mean() > 0.5
            if is_faced and _filled_share(left[is_on], surface, CELL * reach_m) >= FILLED:
                surfaces.append(surface)
        left, seen_from_m = left[~is_on], seen_from_m[~is_on]
    return surfaces


def on_surfaces(points_m: ArrayF64, surfaces: Sequence[Surface]) -> ArrayBool:
    """Whether each point (..., 3) belongs to one of `surfaces` and lies within its outline; NaN does not."""
    is_on = np.zeros(points_m.shape[:-1], bool)
    for surface in surfaces:
        with np.errstate(invalid="ignore"):  # A NaN belongs to no surface.
            is_near = np.abs(points_m @ surface.normal - surface.offset_m) <= surface.tolerance_m
        is_on[is_near] |= _inside(points_m[is_near] @ _axes(surface), surface.outline_m @ _axes(surface))
    return is_on


def _axes(surface: Surface) -> ArrayF64:
    """(3, 2) two directions along the surface, at a right angle."""
    across = surface.outline_m[1] - surface.outline_m[0]
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(surface.normal, across)], axis=1)


def _inside(points: ArrayF64, corners: ArrayF64) -> ArrayBool:
    """Whether each point (P, 2) is within a convex outline (K, 2), whichever way that turns."""
    edges, to_points = np.roll(corners, -1, axis=0) - corners, points[:, None] - corners
    sides = edges[:, 0] * to_points[..., 1] - edges[:, 1] * to_points[..., 0]
    return (sides >= 0).all(axis=1) | (sides <= 0).all(axis=1)


def clear_of(surface: Surface, corners_m: ArrayF64) -> Surface:
    """`surface` moved back along its normal, so that an object's box, `corners_m` (K, 3), does not sink into it.

    It is where it was if the box does not sink, or by more than twice the tolerance: then it goes through the surface.
    """
    sunk_m = surface.offset_m - float((corners_m @ surface.normal).min())
    if not 0 < sunk_m <= 2 * surface.tolerance_m:
        return surface
    return replace(surface, outline_m=surface.outline_m - sunk_m * surface.normal)


def _largest_plane(points_m: ArrayF64, tolerance_m: float, rng: np.random.Generator) -> ArrayBool:
    """Which of the points lie on the plane through three of them that has most; none where all are in a line."""
    corners = points_m[rng.integers(len(points_m), size=(N_TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    is_triangle = lengths > 1e-12
    if not is_triangle.any():
        return np.zeros(len(points_m), bool)
    normals = normals[is_triangle] / lengths[is_triangle, None]
    offsets = (normals * corners[is_triangle, 0]).sum(axis=1)
    is_on = np.abs(points_m @ normals.T - offsets) <= tolerance_m
    return is_on[:, is_on.sum(axis=0).argmax()]


def _surface_through(points_m: ArrayF64, centre_m: ArrayF64, tolerance_m: float) -> Surface | None:
    """The plane of least squares through the points, cut to their outline, that looks at `centre_m`.

    None where they are as good as in a line, such as a cable or an edge: which way that looks, noise would say.
    """
    middle_m = points_m.mean(axis=0)
    _, sizes, (across, along, normal) = np.linalg.svd(points_m - middle_m, full_matrices=False)
    if sizes[1] <= tolerance_m / 2 * np.sqrt(len(points_m)):
        return None
    if (centre_m - middle_m) @ normal < 0:
        normal = -normal
    flat = (points_m - middle_m) @ np.stack([across, along], axis=1)
    corners = flat[_convex_hull(flat)]
    return Surface(middle_m + corners @ np.stack([across, along]), normal, tolerance_m)


def _filled_share(points_m: ArrayF64, surface: Surface, side_m: float) -> float:
    """Share of the squares of `side_m` with their middle inside the outline of `surface` that points lie in."""
    axes = _axes(surface)
    corners, cells = surface.outline_m @ axes / side_m, np.unique(np.floor(points_m @ axes / side_m), axis=0)
    low, high = np.floor(corners.min(axis=0)), np.floor(corners.max(axis=0))
    grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))), axis=-1).reshape(-1, 2)
    inside = grid[_inside(grid + 0.5, corners)]
    if not len(inside):
        return 1.0
    is_filled = (inside[:, None] == cells).all(axis=-1).any(axis=1)
    return float(is_filled.mean())


def _convex_hull(flat: ArrayF64) -> list[int]:
    """Which of the points (P, 2) are the corners of their convex outline, in order (Andrew's monotone chain)."""
    order, points = np.lexsort((flat[:, 1], flat[:, 0])).tolist(), flat.tolist()

    def half(indices: list[int]) -> list[int]:
        chain: list[int] = []
        for index in indices:
            while len(chain) > 1:
                (x, y), (ax, ay), (bx, by) = points[chain[-2]], points[chain[-1]], points[index]
                if (ax - x) * (by - y) - (ay - y) * (bx - x) > 0:
                    break
                chain.pop()
            chain.append(index)
        return chain[:-1]

    return half(order) + half(order[::-1])
