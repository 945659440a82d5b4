"""Sampling on the unit sphere: which of a frame's many points say what light arrives at one position?

Unit-sphere sampling, the paper's choice: every point is projected to the unit sphere around the position, goes to its
nearest anchor, and the nearest point wins the anchor, since it hides what lies behind it. Distance and colour of an
anchor always come from one and the same point. `sampling_reference` is the same in a readable loop. Where the pixels of
a picture lie sparser than the anchors, as on a table at a flat angle, the patches of surface that they show compete as
well, cut into points: see `patches`. All else is sampled as if there were none. What is seen through an opening such as
a window competes where the opening is, and counts as far away. Last come the other pixels whose distance is not known
(`PixelGrid.far`): where nothing else is seen, theirs is the light from far away.

Distance and point number are packed into one 64-bit key, so that a single minimum per anchor yields the winner, and
points that are equally near are told apart by their number. Rejected: sorting by distance, which takes longer than all
the rest. Uniform random and farthest-point sampling are here as the paper's baselines, merging is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihenet.invalid import added, counted
from xihenet.patches import (
    FARTHEST_M,
    SeenGrid,
    cut_patches,
    describe_surfaces,
    fit_patches,
    lines_through,
    sparse_pixels,
)
from xihenet.records import (
    FAR_M,
    AnchorSurfaces,
    ArrayBool,
    ArrayF32,
    ArrayF64,
    ArrayInt,
    FarPixels,
    PointCloud,
    UnitSphereCloud,
)
from xihenet.sphere import TABLE_SIZE, AnchorLattice, NearestMethod

MOST_ASIDE = np.radians(50)
"""The light from far away that is seen through an opening is taken for that of directions up to this angle beside."""
SAME_SURFACE = 1.3
"""Two distances in one direction are those of one surface if neither is more than so many times the other."""
N_BESIDE = 6
"""Anchors around each, of which one takes what of its surface found its own anchor taken."""
_NO_POINT = np.uint64(2**64 - 1)
_INFINITY_KEY = np.uint64(int(np.float32(np.inf).view(np.uint32)) << 32)


def sample_unit_sphere(
    cloud: PointCloud,
    position_m: ArrayLike,
    lattice: AnchorLattice,
    *,
    method: NearestMethod = "exact",
    table_size: tuple[int, int] = TABLE_SIZE,
    with_surfaces: bool = True,
) -> UnitSphereCloud:
    """Give each anchor the colour and the ray distance of the nearest point in its direction.

    The cloud's points and `position_m` (3,), where the light is wanted, are in the world frame, metres; ValueError
    unless the position is finite. `method` and `table_size` as of `AnchorLattice.nearest`.

    With `surfaces` if the cloud has a grid, unless they are not wanted, which is faster. Points that are NaN or
    infinite, that lie at the position itself, whose distance overflows float32, or whose colour is NaN or infinite are
    left out and counted. Of points with the same distance in float32 the first one wins. Colours are clipped to [0, 1].

    Distances are within 4e-7 of their size plus 2^-48 of the position's distance from the origin (1e-11 m at 10 km)
    plus the step of the smallest float32, 1e-45 m; a point nearer than that may pass for one at the position itself.
    """
    position = checked_position(position_m)
    columns = _relative_columns(cloud.points_m, position)
    distance_m = _distances(columns)
    invalid = _exclude_unusable(columns, distance_m, cloud)
    nearest = partial(lattice.nearest_to_columns, method=method, table_size=table_size)
    anchors = nearest(columns)
    shown = _Shown.of_points(_nearest_points(anchors, distance_m, lattice.n), distance_m)
    grid = cloud.grid
    if grid is not None:
        with np.errstate(over="ignore"):  # A camera that float32 cannot hold has no points that count.
            camera = (grid.camera_m - position).astype(np.float32)
        seen = SeenGrid(grid, columns, distance_m, camera, not distance_m.max() < FARTHEST_M)
        _add_patches(shown, seen, anchors, lattice, nearest, with_surfaces=with_surfaces)
        if grid.far is not None:
            _add_far_light(shown, cloud, grid.far, camera, nearest)
        if grid.openings is not None:
            _look_through_openings(shown, cloud, grid.camera_m, grid.openings, lattice, nearest)
    is_set = shown.is_set
    srgb = np.zeros((lattice.n, 3), np.float32)
    srgb[is_set] = cloud.srgb.take(shown.point[is_set], axis=0).clip(0, 1)
    return UnitSphereCloud(srgb, np.where(is_set, shown.distance_m, np.float32(0)), is_set, invalid, shown.surfaces)


_Nearest = Callable[[ArrayF32], ArrayInt]
"""The anchors (P,) nearest to directions (3, P)."""


@dataclass(eq=False)
class _Shown:
    """What each of N anchors shows, as far as points have competed for it."""

    point: ArrayInt  # (N,) number of the point whose colour it has; -1 for an anchor that is not set
    distance_m: ArrayF32  # (N,) infinite for one that is not set
    surfaces: AnchorSurfaces | None = None

    @classmethod
    def of_points(cls, point: ArrayInt, distance_m: ArrayF32) -> _Shown:
        """Of the points at distances (P,) that have won."""
        nearest_m = np.full(len(point), np.inf, np.float32)
        nearest_m[point >= 0] = distance_m[point[point >= 0]]
        return cls(point, nearest_m)

    @property
    def is_set(self) -> ArrayBool:
        """(N,)."""
        return self.point >= 0


def _add_patches(
    shown: _Shown, seen: SeenGrid, anchors: ArrayInt, lattice: AnchorLattice, nearest: _Nearest, *, with_surfaces: bool
) -> None:
    """Let the patches of the pixels that won an anchor compete as well, and say what surfaces are shown, if wanted.

    `anchors` (P,) are the nearest ones of all pixels.
    """
    pixels = shown.point[shown.is_set]
    lines = lines_through(seen.grid, pixels)
    patch_of_anchor = np.full(lattice.n, -1)
    patch_of_anchor[shown.is_set] = np.arange(len(pixels))
    sparse = sparse_pixels(seen, lines, anchors)
    # Patches of the other pixels are fitted for their surfaces alone.
    patches = fit_patches(seen, lines) if with_surfaces else None
    may_reach = fit_patches(seen, lines.take(sparse, axis=2)) if patches is None else patches.chosen(sparse)
    cut, points = cut_patches(may_reach, lattice.n)
    if len(cut):
        cut_m = _distances(points)
        nearest_cut = _nearest_points(nearest(points), cut_m, lattice.n)
        reached = np.flatnonzero(nearest_cut >= 0)
        reached = reached[cut_m[nearest_cut[reached]] < shown.distance_m[reached]]
        winners = nearest_cut[reached]
        shown.distance_m[reached], patch_of_anchor[reached] = cut_m[winners], sparse[cut[winners]]
    is_set = patch_of_anchor >= 0
    shown.point[is_set] = pixels[patch_of_anchor[is_set]]
    if patches is not None:
        shown.surfaces = describe_surfaces(seen, patches, patch_of_anchor[is_set], is_set, lattice.directions)


def _add_far_light(shown: _Shown, cloud: PointCloud, far: FarPixels, camera: ArrayF32, nearest: _Nearest) -> None:
    """Let pixels without a distance take the anchors that are left."""
    points = far.rays * np.float32(FAR_M) + camera[:, None]
    distance_m = _distances(points)
    is_usable = (distance_m > 0) & (distance_m < np.inf) & np.isfinite(cloud.srgb[far.pixels]).all(axis=1)
    points[:, ~is_usable], distance_m[~is_usable] = 1, np.inf
    reaching = _nearest_points(nearest(points), distance_m, len(shown.point))
    is_new = (reaching >= 0) & ~shown.is_set
    reaching = reaching[is_new]
    shown.distance_m[is_new], shown.point[is_new] = distance_m[reaching], far.pixels[reaching]
    if shown.surfaces is not None:
        shown.surfaces = shown.surfaces.with_far_light(is_new, far.rays.T[reaching])


def _look_through_openings(
    shown: _Shown, cloud: PointCloud, camera_m: ArrayF64, openings: ArrayInt, lattice: AnchorLattice, nearest: _Nearest
) -> None:
    """What anchors show through an opening is far away, though it competes where the opening is.

    Light from far away depends on its direction and not on the place. So such an anchor shows the pixel of an opening
    that looks in its own direction, or of those that look within `MOST_ASIDE` of it the one that comes closest.
    """
    is_opening = np.zeros(len(cloud.srgb), np.bool_)  # numpy.isin sorts, which takes 20 times as long.
    is_opening[openings] = True
    through = np.flatnonzero(shown.is_set)
    through = through[is_opening[shown.point[through]]]
    shown.distance_m[through] = np.maximum(shown.distance_m[through], np.float32(FAR_M))
    rays = rays_to(cloud.points_m[openings], camera_m)
    is_usable = np.isfinite(rays).all(axis=1) & np.isfinite(cloud.srgb[openings]).all(axis=1)
    openings, rays = openings[is_usable], rays[is_usable]
    if len(through) and len(openings):
        cells = nearest(np.ascontiguousarray(rays.T, np.float32))
        apart = np.square(rays - lattice.directions[cells]).sum(axis=1).astype(np.float32)
        looking = _nearest_points(cells, apart, lattice.n)
        looked_at = np.flatnonzero(looking >= 0)
        # Not a product of matrices: that wakes BLAS threads.
        cosines = np.einsum("mc,kc->mk", lattice.directions[through], lattice.directions[looked_at])
        is_near = cosines.max(axis=1) >= np.cos(MOST_ASIDE)
        closest = openings[looking[looked_at[cosines.argmax(axis=1)]]]
        shown.point[through] = np.where(is_near, closest, shown.point[through])
    if shown.surfaces is not None:
        is_through = np.zeros(lattice.n, np.bool_)
        is_through[through] = True
        shown.surfaces = shown.surfaces.with_far_light(
            is_through, rays_to(cloud.points_m[shown.point[through]], camera_m)
        )


def rays_to(points_m: ArrayF32 | ArrayF64, camera_m: ArrayF64) -> ArrayF64:
    """(K, 3) unit, from the camera to points (K, 3); NaN where that is none."""
    rays = points_m.astype(np.float64) - camera_m
    with np.errstate(invalid="ignore"):  # A point in the camera itself has no ray: NaN says so.
        unit: ArrayF64 = rays / np.sqrt((rays * rays).sum(axis=1, keepdims=True))
    return unit


def sample_again(cloud: UnitSphereCloud, moved_m: ArrayLike, lattice: AnchorLattice) -> UnitSphereCloud:
    """What `cloud` has seen, from `moved_m` (3,) beside its position: surfaces go to the anchors where they lie now.

    Anchors into whose direction none came are not set, but for one beside which lies part of a surface that shares its
    anchor with another. `cloud` has the lattice's anchors, else ValueError. Surfaces face the new position as much as
    they did the old one, which is nearly so where it is near. Where each lies is kept exactly (`beside_m`): many small
    moves are as one large one, though each of them is less than the width of an anchor.
    """
    if len(cloud) != lattice.n:
        raise ValueError(f"sample_again: the lattice has {lattice.n} anchors and the cloud {len(cloud)}")
    points_m = lattice.directions * cloud.distance_m[:, None] - checked_position(moved_m)
    if cloud.beside_m is not None:
        points_m += cloud.beside_m
    shown = np.flatnonzero(cloud.is_set & points_m.any(axis=1))
    with np.errstate(over="ignore"):  # What is too far for float32 is taken for not seen.
        columns = np.ascontiguousarray(points_m[shown].T, np.float32)
    distance_m = _distances(columns)
    anchors = lattice.nearest_to_columns(columns)
    winners = _nearest_points(anchors, distance_m, lattice.n)
    _put_beside(winners, anchors, distance_m, lattice)
    is_set = winners >= 0
    source = np.zeros(lattice.n, np.intp)
    source[is_set] = shown[winners[is_set]]

    def taken(values: Any) -> Any:
        return values[source] * (is_set if values.ndim == 1 else is_set[:, None])

    nearest_m = np.zeros(lattice.n, np.float32)
    nearest_m[is_set] = distance_m[winners[is_set]]
    old = cloud.surfaces
    surfaces = None if old is None else AnchorSurfaces(*(taken(getattr(old, field.name)) for field in fields(old)))
    beside_m = (points_m[source] - lattice.directions * nearest_m[:, None]) * is_set[:, None]
    return UnitSphereCloud(taken(cloud.srgb), nearest_m, is_set, surfaces=surfaces, beside_m=beside_m)


def _put_beside(winners: ArrayInt, anchors: ArrayInt, distance_m: ArrayF32, lattice: AnchorLattice) -> None:
    """Give points (P,) that lost to one of their own surface an anchor beside their own that is free, in place.

    `winners` (N,) are numbers of points, -1 for anchors without one; `anchors` (P,) those nearest to each. Without it a
    surface would lose a part of itself whenever two of its points come to share an anchor.
    """
    with np.errstate(over="ignore"):  # All is of one surface at the end of float32.
        has_lost = distance_m <= SAME_SURFACE * distance_m[winners[anchors]]
    has_lost[winners[winners >= 0]] = False
    left = np.flatnonzero(has_lost)
    for beside in lattice.neighbours(min(1 + N_BESIDE, lattice.n)).T[1:]:
        wanted = beside[anchors[left]]
        is_free = winners[wanted] < 0
        asking = left[is_free]
        given = _nearest_points(wanted[is_free], distance_m[asking], lattice.n)
        has_new = given >= 0
        winners[has_new] = asking[given[has_new]]
        has_lost[winners[has_new]] = False
        left = left[has_lost[left]]


def sample_uniform(cloud: PointCloud, n: int, rng: np.random.Generator) -> PointCloud:
    """`n` different points, each equally likely, in the cloud's order; all if it has no more than `n`.

    Points and colours that are NaN or infinite are left out. Raises ValueError for a negative `n`.
    """
    usable = _finite_points(cloud, n)
    return _chosen(cloud, np.sort(rng.choice(usable, min(n, len(usable)), replace=False)))


def sample_farthest(cloud: PointCloud, n: int, rng: np.random.Generator) -> PointCloud:
    """`n` points of which each is the farthest from those before it, the first at random; all if there are no more.

    Points and colours that are NaN or infinite are left out. ValueError for a negative `n`; ImportError without the
    package `fpsample`, naming the extra that brings it.
    """
    try:
        import fpsample
    except ImportError as error:
        raise ImportError("farthest-point sampling needs fpsample: pip install 'xihe-blender[bench]'") from error
    usable = _finite_points(cloud, n)
    if n == 0 or len(usable) <= n:
        return _chosen(cloud, usable[:n])
    first = int(rng.integers(len(usable)))
    points_m = cloud.points_m[usable]
    if points_m.dtype == np.float64:  # It calculates in float32, which is too coarse so far from the origin.
        points_m = _relative_columns(points_m, points_m[first]).T
    # Of its methods the bucket one is the fastest, and exact; 2^7 points per bucket suit some 50,000 points.
    picked = fpsample.bucket_fps_kdline_sampling(points_m, n, h=min(7, len(usable).bit_length() - 1), start_idx=first)
    return _chosen(cloud, usable[np.asarray(picked, np.intp)])


def checked_position(position_m: ArrayLike) -> ArrayF64:
    """(3,), a read-only copy, which moves with nobody's array; ValueError unless it is three finite numbers."""
    try:
        position = np.array(position_m, np.float64)
    except (TypeError, ValueError, OverflowError):
        position = np.full(3, np.nan)
    position.flags.writeable = False
    if position.shape != (3,) or not np.isfinite(position).all():
        raise ValueError(f"position_m: expected three finite numbers, got {position_m!r}")
    return position


def _relative_columns(points_m: ArrayF32 | ArrayF64, position: ArrayF64) -> ArrayF32:
    """(3, P) x, y and z of the points as seen from the position.

    The position is taken off in two parts, its float32 value and what that leaves. A float32 difference is rounded
    relative to itself and is exact where the two are close, so that rounding the position first loses nothing.
    """
    columns = np.empty((3, len(points_m)), np.float32)
    if points_m.dtype == np.float64:
        with np.errstate(over="ignore"):  # As below
            for axis, column in enumerate(columns):
                np.subtract(points_m[:, axis], position[axis], out=column, casting="same_kind")
        return columns
    # Infinity and NaN stay what they are, and positions beyond float32 put all points there: they are counted later.
    with np.errstate(over="ignore", invalid="ignore"):
        coarse = position.astype(np.float32)
        fine = (position - coarse).astype(np.float32)
        for axis, column in enumerate(columns):
            np.subtract(points_m[:, axis], coarse[axis], out=column)
            if fine[axis] != 0:
                column -= fine[axis]
    return columns


def _distances(columns: ArrayF32) -> ArrayF32:
    """(P,) lengths in float32; through float64 where a square would leave the range of float32."""
    x, y, z = columns
    with np.errstate(over="ignore"):  # Squares that overflow are found by their size and taken again in float64.
        squares = x * x
        squares += y * y
        squares += z * z
        distances: ArrayF32 = np.sqrt(squares)
        if len(squares) and not (squares.min() > 1e-30 and squares.max() < 1e30):
            extreme = np.flatnonzero(~((squares > 1e-30) & (squares < 1e30)))
            few = columns.take(extreme, axis=1).astype(np.float64)
            distances[extreme] = np.sqrt((few * few).sum(axis=0)).astype(np.float32)
    return distances


def _exclude_unusable(columns: ArrayF32, distance_m: ArrayF32, cloud: PointCloud) -> dict[str, int]:
    """Move points that cannot be used to an infinite distance, in place; how many there are, by reason."""
    if not len(distance_m):
        return {}
    is_usable: ArrayBool | None = None
    # NaN passes through a minimum and makes every comparison False.
    if not (distance_m.min() > 0 and distance_m.max() < np.inf):
        is_usable = (distance_m > 0) & (distance_m < np.inf)
    if not cloud.has_finite_colours:
        is_finite = np.isfinite(cloud.srgb).all(axis=1)
        is_usable = is_finite if is_usable is None else is_usable & is_finite
    if is_usable is None:
        return {}
    unusable = np.flatnonzero(~is_usable)
    invalid = _why_unusable(distance_m[unusable], unusable, cloud)
    columns[:, unusable] = 1
    distance_m[unusable] = np.inf
    return invalid


def _why_unusable(distance_m: ArrayF32, unusable: ArrayInt, cloud: PointCloud) -> dict[str, int]:
    """Reasons of the points of these numbers, as far as the cloud does not name them, and their distances."""
    n_at_probe = np.count_nonzero(distance_m == 0)
    n_uncoloured = np.count_nonzero((distance_m > 0) & (distance_m < np.inf))
    n_left = len(unusable) - n_at_probe - n_uncoloured - sum(cloud.invalid.values())
    n_too_far = 0
    if n_left > 0:  # Else all are pixels without a plane depth, and there is no need to look at each.
        is_lost = ~((distance_m >= 0) & (distance_m < np.inf))
        n_too_far = np.count_nonzero(np.isfinite(cloud.points_m[unusable[is_lost]]).all(axis=1))
    own = counted(
        at_probe=n_at_probe, colour_not_finite=n_uncoloured, too_far=n_too_far, not_finite=max(n_left - n_too_far, 0)
    )
    return added([cloud.invalid, own])


def _nearest_points(anchors: ArrayInt, distance_m: ArrayF32, n_anchors: int) -> ArrayInt:
    """(n_anchors,) the number of the nearest point of each anchor, -1 for one without a point at a finite distance."""
    # The bits of floats that are not negative rise with the floats.
    keys = distance_m.view(np.uint32).astype(np.uint64)
    keys <<= np.uint64(32)
    keys |= np.arange(len(keys), dtype=np.uint64)
    best = np.full(n_anchors, _NO_POINT)
    np.minimum.at(best, anchors, keys)
    return np.where(best < _INFINITY_KEY, (best & np.uint64(2**32 - 1)).astype(np.intp), -1)


def has_usable_points(cloud: PointCloud) -> bool:
    """Whether any point's place and colour are finite."""
    return len(_finite_points(cloud, 0)) > 0


def _finite_points(cloud: PointCloud, n: int) -> ArrayInt:
    """Numbers of the points whose place and colour are finite as float32."""
    if n < 0:
        raise ValueError(f"n: expected 0 points or more, got {n}")
    with np.errstate(over="ignore"):  # What float32 cannot hold is infinite, and left out below.
        points_m = cloud.points_m.astype(np.float32, copy=False)
    return np.flatnonzero(np.isfinite(points_m).all(axis=1) & np.isfinite(cloud.srgb).all(axis=1))


def _chosen(cloud: PointCloud, numbers: ArrayInt) -> PointCloud:
    return PointCloud(cloud.points_m[numbers], cloud.srgb[numbers])
