"""Which of a frame's many points say what light arrives at one position?

Unit-sphere sampling, the paper's choice: every point is projected to the unit sphere around the position, goes to its
nearest anchor, and the nearest point wins the anchor, since it hides what lies behind it. Distance and colour of an
anchor always come from one and the same point. `sample_unit_sphere_reference` is the same in a readable loop. Where the
pixels of a picture lie sparser than the anchors, as on a table at a flat angle, the patches of surface that they show
compete as well, cut into points: see `patches`. All else is sampled as if there were none. What is seen through an
opening such as a window competes where the opening is, and counts as far away. Last come the other pixels whose
distance is not known (`PixelGrid.far`): where nothing else is seen, theirs is the light from far away.

Distance and point number are packed into one 64-bit key, so that a single minimum per anchor yields the winner, and
points that are equally near are told apart by their number. Rejected: sorting by distance, which takes longer than all
the rest. Uniform random and farthest-point sampling are here as the paper's baselines, merging is not.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import fields
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
from xihenet.patches_reference import PlainPicture
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

LARGEST_FLOAT32 = np.finfo(np.float32).max
MOST_ASIDE = np.radians(50)
"""The light from far away that is seen through an opening is taken for that of directions up to this angle beside."""
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
    anchors = lattice.nearest_to_columns(columns, method, table_size)
    is_set, winners = _nearest_points(anchors, distance_m, lattice.n)
    nearest_m = np.full(lattice.n, np.inf, np.float32)
    nearest_m[is_set] = distance_m[winners]
    surfaces = None
    if cloud.grid is not None:
        with np.errstate(over="ignore"):  # A camera that float32 cannot hold has no points that count.
            camera = (cloud.grid.camera_m - position).astype(np.float32)
        seen = SeenGrid(cloud.grid, columns, distance_m, camera, not distance_m.max() < FARTHEST_M)
        nearest = partial(lattice.nearest_to_columns, method=method, table_size=table_size)
        is_set, winners, surfaces = _with_patches(
            seen, anchors, winners, nearest_m, lattice, nearest, with_surfaces=with_surfaces
        )
        if cloud.grid.far is not None:
            is_set, winners, surfaces = _with_far_light(
                cloud, cloud.grid.far, camera, is_set, winners, nearest_m, surfaces, nearest
            )
        if cloud.grid.openings is not None:
            winners, surfaces = _with_openings(
                cloud, cloud.grid.camera_m, cloud.grid.openings, is_set, winners, nearest_m, surfaces, lattice, nearest
            )
    nearest_m[~is_set] = 0
    srgb = np.zeros((lattice.n, 3), np.float32)
    srgb[is_set] = cloud.srgb.take(winners, axis=0).clip(0, 1)
    return UnitSphereCloud(srgb, nearest_m, is_set, invalid, surfaces)


def _with_patches(
    seen: SeenGrid, anchors: ArrayInt, winners: ArrayInt, nearest_m: ArrayF32, lattice: AnchorLattice,
    nearest: Callable[[ArrayF32], ArrayInt], *, with_surfaces: bool,
) -> tuple[ArrayBool, ArrayInt, AnchorSurfaces | None]:  # fmt: skip
    """After patches have competed as well: which anchors are set, the pixel that won each of those, and what it shows.

    `nearest_m` (N,) is changed in place; `winners` are the pixels of its finite ones, in order.
    """
    lines = lines_through(seen.grid, winners)
    patch_of_anchor = np.full(len(nearest_m), -1)
    patch_of_anchor[nearest_m < np.inf] = np.arange(len(winners))
    sparse = sparse_pixels(seen, lines, anchors)
    # Patches of the other pixels are fitted for their surfaces alone.
    patches = fit_patches(seen, lines) if with_surfaces else None
    may_reach = fit_patches(seen, lines.take(sparse, axis=2)) if patches is None else patches.chosen(sparse)
    cut, points = cut_patches(may_reach, len(nearest_m))
    if len(cut):
        cut_m = _distances(points)
        is_reached, nearest_cut = _nearest_points(nearest(points), cut_m, len(nearest_m))
        reached = np.flatnonzero(is_reached)
        is_nearer = cut_m[nearest_cut] < nearest_m[reached]
        reached, nearest_cut = reached[is_nearer], nearest_cut[is_nearer]
        nearest_m[reached], patch_of_anchor[reached] = cut_m[nearest_cut], sparse[cut[nearest_cut]]
    is_set = patch_of_anchor >= 0
    shown = patch_of_anchor[is_set]
    surfaces = None if patches is None else describe_surfaces(seen, patches, shown, is_set, lattice.directions)
    return is_set, winners[shown], surfaces


def _with_far_light(
    cloud: PointCloud, far: FarPixels, camera: ArrayF32, is_set: ArrayBool, winners: ArrayInt, nearest_m: ArrayF32,
    surfaces: AnchorSurfaces | None, nearest: Callable[[ArrayF32], ArrayInt],
) -> tuple[ArrayBool, ArrayInt, AnchorSurfaces | None]:  # fmt: skip
    """After pixels without a distance have taken the anchors that are left; as of `_with_patches`."""
    points = far.rays * np.float32(FAR_M) + camera[:, None]
    distance_m = _distances(points)
    is_usable = (distance_m > 0) & (distance_m < np.inf) & np.isfinite(cloud.srgb[far.pixels]).all(axis=1)
    points[:, ~is_usable], distance_m[~is_usable] = 1, np.inf
    is_reached, reaching = _nearest_points(nearest(points), distance_m, len(nearest_m))
    is_new = is_reached & ~is_set
    reaching = reaching[is_new[is_reached]]
    nearest_m[is_new] = distance_m[reaching]
    pixel_of_anchor = np.full(len(nearest_m), -1)
    pixel_of_anchor[is_set], pixel_of_anchor[is_new] = winners, far.pixels[reaching]
    if surfaces is not None:
        surfaces = _seen_from_afar(surfaces, is_new, far.rays.T[reaching])
    is_set = is_set | is_new
    return is_set, pixel_of_anchor[is_set], surfaces


def _with_openings(
    cloud: PointCloud, camera_m: ArrayF64, openings: ArrayInt, is_set: ArrayBool, winners: ArrayInt,
    distance_m: ArrayF32, surfaces: AnchorSurfaces | None, lattice: AnchorLattice,
    nearest: Callable[[ArrayF32], ArrayInt],
) -> tuple[ArrayInt, AnchorSurfaces | None]:  # fmt: skip
    """What anchors show through an opening is far away, though it competes where the opening is.

    Light from far away depends on its direction and not on the place. So such an anchor shows the pixel of an opening
    that looks in its own direction, or of those that look within `MOST_ASIDE` of it the one that comes closest.
    `distance_m` (N,) is changed in place; `winners` are the pixels of the anchors `is_set`, in order.
    """
    is_opening = np.zeros(len(cloud.srgb), np.bool_)  # numpy.isin sorts, which takes 20 times as long.
    is_opening[openings] = True
    through = np.zeros(len(is_set), np.bool_)
    through[is_set] = is_opening.take(winners)
    distance_m[through] = np.maximum(distance_m[through], np.float32(FAR_M))
    rays = _rays(cloud.points_m[openings], camera_m)
    is_usable = np.isfinite(rays).all(axis=1) & np.isfinite(cloud.srgb[openings]).all(axis=1)
    openings, rays = openings[is_usable], rays[is_usable]
    if through.any() and len(openings):
        cells = nearest(np.ascontiguousarray(rays.T, np.float32))
        apart = np.square(rays - lattice.directions[cells]).sum(axis=1).astype(np.float32)
        is_looked, looking = _nearest_points(cells, apart, lattice.n)
        # Not a product of matrices: that wakes BLAS threads.
        cosines = np.einsum("mc,kc->mk", lattice.directions[through], lattice.directions[is_looked])
        closest, shown = cosines.argmax(axis=1), through[is_set]
        is_near = cosines.max(axis=1) >= np.cos(MOST_ASIDE)
        winners = winners.copy()
        winners[shown] = np.where(is_near, openings[looking[closest]], winners[shown])
    if surfaces is not None:
        surfaces = _seen_from_afar(surfaces, through, _rays(cloud.points_m[winners[through[is_set]]], camera_m))
    return winners, surfaces


def _rays(points_m: ArrayF32, camera_m: ArrayF64) -> ArrayF64:
    """(K, 3) unit, from the camera to points (K, 3); NaN where that is none."""
    rays = points_m.astype(np.float64) - camera_m
    with np.errstate(invalid="ignore"):  # A point in the camera itself has no ray: NaN says so.
        unit: ArrayF64 = rays / np.sqrt((rays * rays).sum(axis=1, keepdims=True))
    return unit


def _seen_from_afar(surfaces: AnchorSurfaces, is_far: ArrayBool, rays: ArrayLike) -> AnchorSurfaces:
    """Where anchors `is_far` (N,) show light from far away, along `rays` (K, 3), they face the position."""
    one, view_direction = np.float32(1), surfaces.view_direction.copy()
    view_direction[is_far] = -np.asarray(rays).reshape(-1, 3)
    return AnchorSurfaces(
        np.where(is_far, one, surfaces.facing),
        np.where(is_far, one, surfaces.incidence),
        np.where(is_far, np.float32(FAR_M), surfaces.camera_distance_m),
        view_direction,
        surfaces.is_edge,
    )


def sample_again(cloud: UnitSphereCloud, moved_m: ArrayLike, lattice: AnchorLattice) -> UnitSphereCloud:
    """What `cloud` has seen, from `moved_m` (3,) beside its position: surfaces go to the anchors where they lie now.

    Anchors into whose direction none came are not set. `cloud` has the lattice's anchors, else ValueError. Surfaces
    face the new position as much as they did the old one, which is nearly so where it is near.
    """
    if len(cloud) != lattice.n:
        raise ValueError(f"sample_again: the lattice has {lattice.n} anchors and the cloud {len(cloud)}")
    points_m = lattice.directions * cloud.distance_m[:, None] - checked_position(moved_m)
    shown = np.flatnonzero(cloud.is_set & points_m.any(axis=1))
    with np.errstate(over="ignore"):  # What is too far for float32 is taken for not seen.
        columns = np.ascontiguousarray(points_m[shown].T, np.float32)
    distance_m = _distances(columns)
    is_set, winners = _nearest_points(lattice.nearest_to_columns(columns), distance_m, lattice.n)
    source = np.zeros(lattice.n, np.intp)
    source[is_set] = shown[winners]

    def taken(values: Any) -> Any:
        return values[source] * (is_set if values.ndim == 1 else is_set[:, None])

    nearest_m = np.zeros(lattice.n, np.float32)
    nearest_m[is_set] = distance_m[winners]
    old = cloud.surfaces
    surfaces = None if old is None else AnchorSurfaces(*(taken(getattr(old, field.name)) for field in fields(old)))
    return UnitSphereCloud(taken(cloud.srgb), nearest_m, is_set, surfaces=surfaces)


def sample_unit_sphere_reference(cloud: PointCloud, position_m: ArrayLike, lattice: AnchorLattice) -> UnitSphereCloud:
    """As `sample_unit_sphere`, point after point in float64: slow, and meant to be read and compared with."""
    position = checked_position(position_m)
    relative = cloud.points_m.astype(np.float64) - position
    with np.errstate(over="ignore", invalid="ignore"):  # A distance beyond float32 is left out and counted below.
        distance_m = np.sqrt((relative * relative).sum(axis=1)).astype(np.float32)
    is_usable = np.isfinite(distance_m) & (distance_m > 0) & np.isfinite(cloud.srgb).all(axis=1)
    nearest_m, winner = np.full(lattice.n, np.inf, np.float32), np.full(lattice.n, -1)

    def compete(pixel: int, point: ArrayF64) -> None:
        point_m = np.float32(np.sqrt((point * point).sum()))
        anchor = int(np.argmax(lattice.directions @ point))
        if point_m < nearest_m[anchor]:
            nearest_m[anchor], winner[anchor] = point_m, pixel

    for pixel in np.flatnonzero(is_usable):
        compete(pixel, relative[pixel])
    picture = None
    if cloud.grid is not None:
        anchors = lattice.nearest(np.where(is_usable[:, None], relative, 1.0), "brute")
        picture = PlainPicture(cloud.grid, relative, is_usable, anchors, cloud.grid.camera_m - position)
        for pixel, point in picture.patch_points(winner.copy()):
            compete(pixel, point)
    surfaces = picture.surfaces(winner, lattice.directions) if picture else None
    if surfaces is not None and cloud.grid is not None and cloud.grid.far is not None:
        is_near, rays = winner >= 0, dict(zip(cloud.grid.far.pixels.tolist(), cloud.grid.far.rays.T, strict=True))
        for pixel, ray in rays.items():
            point = ray.astype(np.float64) * FAR_M + (cloud.grid.camera_m - position)
            is_free = not is_near[int(np.argmax(lattice.directions @ point))]
            if is_free and 0 < np.linalg.norm(point) < LARGEST_FLOAT32 and np.isfinite(cloud.srgb[pixel]).all():
                compete(pixel, point)
        is_far = (winner >= 0) & ~is_near
        surfaces = _seen_from_afar(surfaces, is_far, [rays[pixel] for pixel in winner[is_far].tolist()])
    if surfaces is not None and cloud.grid is not None and cloud.grid.openings is not None:
        through = np.isin(winner, cloud.grid.openings)
        nearest_m = np.where(through, np.maximum(nearest_m, np.float32(FAR_M)), nearest_m)
        looking = _looking_through(cloud, cloud.grid.camera_m, cloud.grid.openings, lattice)
        for anchor in np.flatnonzero(through):
            cosines = {cell: float(lattice.directions[cell] @ lattice.directions[anchor]) for cell in sorted(looking)}
            closest = max(cosines, key=lambda cell: cosines[cell], default=None)
            if closest is not None and cosines[closest] >= np.cos(MOST_ASIDE):
                winner[anchor] = looking[closest]
        surfaces = _seen_from_afar(surfaces, through, _rays(cloud.points_m[winner[through]], cloud.grid.camera_m))
    is_set = winner >= 0
    srgb = np.zeros((lattice.n, 3), np.float32)
    srgb[is_set] = cloud.srgb[winner[is_set]].clip(0, 1)
    invalid = added([cloud.invalid, _reasons(cloud, distance_m)])
    return UnitSphereCloud(srgb, np.where(is_set, nearest_m, 0), is_set, invalid, surfaces)


def _looking_through(
    cloud: PointCloud, camera_m: ArrayF64, openings: ArrayInt, lattice: AnchorLattice
) -> dict[int, int]:
    """By anchor, the pixel of an opening that looks closest to its direction, of those to which it is the nearest."""
    looking: dict[int, tuple[float, int]] = {}
    for pixel in openings.tolist():
        ray = _rays(cloud.points_m[[pixel]], camera_m)[0]
        if np.isfinite(ray).all() and np.isfinite(cloud.srgb[pixel]).all():
            cell = int(np.argmax(lattice.directions @ ray.astype(np.float32)))
            apart = float(np.float32(np.square(ray - lattice.directions[cell]).sum()))
            if cell not in looking or apart < looking[cell][0]:
                looking[cell] = apart, pixel
    return {cell: pixel for cell, (_, pixel) in looking.items()}


def _reasons(cloud: PointCloud, distance_m: ArrayF32) -> Counter[str]:
    """Why points are left out, one after the other, as far as the cloud does not name it."""
    reasons: Counter[str] = Counter()
    for point, colour, point_m in zip(cloud.points_m, cloud.srgb, distance_m, strict=True):
        if not np.isfinite(point_m):
            reasons["too_far" if np.isfinite(point).all() else "not_finite"] += 1
        elif not (point_m > 0 and np.isfinite(colour).all()):
            reasons["colour_not_finite" if point_m else "at_probe"] += 1
    reasons["not_finite"] -= sum(cloud.invalid.values())
    return +reasons


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
    # Of its methods the bucket one is the fastest, and exact; 2^7 points per bucket suit some 50,000 points.
    picked = fpsample.bucket_fps_kdline_sampling(cloud.points_m[usable], n, h=7, start_idx=first)
    return _chosen(cloud, usable[np.asarray(picked, np.intp)])


def checked_position(position_m: ArrayLike) -> ArrayF64:
    """(3,); ValueError unless it is three finite numbers."""
    position = np.asarray(position_m, np.float64)
    if position.shape != (3,) or not np.isfinite(position).all():
        raise ValueError(f"position_m: expected three finite numbers, got {position_m!r}")
    return position


def _relative_columns(points_m: ArrayF32, position: ArrayF64) -> ArrayF32:
    """(3, P) x, y and z of the points as seen from the position.

    The position is taken off in two parts, its float32 value and what that leaves. A float32 difference is rounded
    relative to itself and is exact where the two are close, so that rounding the position first loses nothing.
    """
    columns = np.empty((3, len(points_m)), np.float32)
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


def _nearest_points(anchors: ArrayInt, distance_m: ArrayF32, n_anchors: int) -> tuple[ArrayBool, ArrayInt]:
    """Which anchors have a point at a finite distance, and the number of the nearest one for each of those."""
    # The bits of floats that are not negative rise with the floats.
    keys = distance_m.view(np.uint32).astype(np.uint64)
    keys <<= np.uint64(32)
    keys |= np.arange(len(keys), dtype=np.uint64)
    best = np.full(n_anchors, _NO_POINT)
    np.minimum.at(best, anchors, keys)
    is_set: ArrayBool = best < _INFINITY_KEY
    return is_set, (best[is_set] & np.uint64(2**32 - 1)).astype(np.intp)


def has_usable_points(cloud: PointCloud) -> bool:
    """Whether any point's place and colour are finite."""
    return len(_finite_points(cloud, 0)) > 0


def _finite_points(cloud: PointCloud, n: int) -> ArrayInt:
    """Numbers of the points whose place and colour are finite."""
    if n < 0:
        raise ValueError(f"n: expected 0 points or more, got {n}")
    return np.flatnonzero(np.isfinite(cloud.points_m).all(axis=1) & np.isfinite(cloud.srgb).all(axis=1))


def _chosen(cloud: PointCloud, numbers: ArrayInt) -> PointCloud:
    return PointCloud(cloud.points_m[numbers], cloud.srgb[numbers])
