"""Unit-sphere sampling, point after point in float64: slow, and meant to be read and compared with.

The rules and their reasons are in `sampling` and `patches`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from xihenet.invalid import added
from xihenet.patches import FARTHEST_M, LEVEL_SHARE, MOST_ALONG, NEAREST_M, OFF_LINE, POINT_GAP
from xihenet.records import (
    FAR_M,
    AnchorSurfaces,
    ArrayBool,
    ArrayF32,
    ArrayF64,
    ArrayInt,
    PixelGrid,
    PointCloud,
    UnitSphereCloud,
)
from xihenet.sampling import MOST_ASIDE, checked_position, rays_to
from xihenet.sphere import AnchorLattice

LARGEST_FLOAT32 = np.finfo(np.float32).max


def sample_unit_sphere_reference(cloud: PointCloud, position_m: ArrayLike, lattice: AnchorLattice) -> UnitSphereCloud:
    """As `sample_unit_sphere`."""
    position = checked_position(position_m)
    with np.errstate(over="ignore", invalid="ignore"):  # A distance beyond float32 is left out and counted below.
        relative = cloud.points_m.astype(np.float64) - position
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
        surfaces = surfaces.with_far_light(is_far, [rays[pixel] for pixel in winner[is_far].tolist()])
    if surfaces is not None and cloud.grid is not None and cloud.grid.openings is not None:
        through = np.isin(winner, cloud.grid.openings)
        nearest_m = np.where(through, np.maximum(nearest_m, np.float32(FAR_M)), nearest_m)
        looking = _looking_through(cloud, cloud.grid.camera_m, cloud.grid.openings, lattice)
        for anchor in np.flatnonzero(through):
            cosines = {cell: float(lattice.directions[cell] @ lattice.directions[anchor]) for cell in sorted(looking)}
            closest = max(cosines, key=lambda cell: cosines[cell], default=None)
            if closest is not None and cosines[closest] >= np.cos(MOST_ASIDE):
                winner[anchor] = looking[closest]
        surfaces = surfaces.with_far_light(through, rays_to(cloud.points_m[winner[through]], cloud.grid.camera_m))
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
        ray = rays_to(cloud.points_m[[pixel]], camera_m)[0]
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


@dataclass(frozen=True, eq=False)
class PlainPicture:
    """The P points of a picture, relative to the position."""

    grid: PixelGrid
    points: ArrayF64  # (P, 3)
    is_usable: ArrayBool  # (P,) neither at the position nor without a place or a colour
    anchors: ArrayInt  # (P,) nearest to each
    camera: ArrayF64  # (3,)
    borders: dict[tuple[int, int], tuple[ArrayF64, ArrayF64]] = field(default_factory=dict)  # That were asked for

    def patch_points(self, winners: ArrayInt) -> list[tuple[int, ArrayF64]]:
        """The points of all patches that are cut, each with its pixel.

        `winners` (N,) are the pixels nearest of each anchor, -1 for anchors without one.
        """
        found: list[tuple[int, ArrayF64]] = []
        gap = POINT_GAP * np.sqrt(4 * np.pi / len(winners))
        for pixel in winners[winners >= 0].tolist():
            point = self.points[pixel]
            if not (NEAREST_M < np.linalg.norm(point) < FARTHEST_M and self._is_sparse(pixel)):
                continue
            (left, right), (up, down) = (self._to_border(pixel, axis) for axis in (0, 1))
            across, along = _shares(point, right - left, gap), _shares(point, down - up, gap)
            if len(across) * len(along) == 1:
                continue
            for v in along:
                for u in across:
                    found.append(
                        (pixel, point + abs(u) * (right if u > 0 else left) + abs(v) * (down if v > 0 else up))
                    )
        return found

    def surfaces(self, pixels: ArrayInt, directions: ArrayF64) -> AnchorSurfaces:
        """What anchors in `directions` (N, 3) show that these pixels (N,) have won; -1 is an anchor that is not set."""
        n = len(pixels)
        facing, camera_distance_m = np.zeros((2, n), np.float32)
        view_direction = np.zeros((n, 3), np.float32)
        for anchor in np.flatnonzero(pixels >= 0):
            pixel = int(pixels[anchor])
            point = self.points[pixel]
            (left, right), (up, down) = (self._to_border(pixel, axis) for axis in (0, 1))
            to_camera, normal = self.camera - point, _unit(np.cross(right - left, down - up))
            camera_distance_m[anchor] = np.linalg.norm(to_camera)
            view_direction[anchor] = _unit(to_camera)
            facing[anchor] = -np.copysign(1, normal @ _unit(to_camera)) * (normal @ directions[anchor])
        return AnchorSurfaces(facing, camera_distance_m, view_direction)

    def _is_sparse(self, pixel: int) -> bool:
        return any(
            self._is_alone(pixel, axis) and any(self._is_alone(p, axis) for p in self._beside(pixel, axis))
            for axis in (0, 1)
        )

    def _is_alone(self, pixel: int, axis: int) -> bool:
        return all(self.anchors[p] != self.anchors[pixel] for p in self._beside(pixel, axis))

    def _beside(self, pixel: int, axis: int) -> list[int]:
        """Neighbours along an axis of the picture, inside it."""
        return [p for p in (self._neighbour(pixel, axis, step) for step in (-1, 1)) if p != pixel]

    def _to_border(self, pixel: int, axis: int) -> tuple[ArrayF64, ArrayF64]:
        """From a pixel's point to its borders before and after along an axis of the picture."""
        if (pixel, axis) not in self.borders:
            self.borders[pixel, axis] = self._found_border(pixel, axis)
        return self.borders[pixel, axis]

    def _found_border(self, pixel: int, axis: int) -> tuple[ArrayF64, ArrayF64]:
        line = [self._neighbour(pixel, axis, step) for step in range(-2, 3)]
        from_camera = self.points[line] - self.camera
        with np.errstate(all="ignore"):  # Of neighbours that do not count.
            inverse = 1 / np.linalg.norm(from_camera, axis=1)
            usable = self.is_usable[line] & (np.linalg.norm(self.points[line], axis=1) < FARTHEST_M)
            inverse[~usable] = np.nan
            before, after = (
                line[beside] != pixel and _is_one_surface(inverse, from_camera[:, 2], edge)
                for edge, beside in ((1, 1), (2, 3))
            )
            to_before, to_after = ((self.points[line[i]] - self.points[pixel]) / 2 for i in (1, 3))
        nowhere = np.zeros(3)
        return (
            to_before if before else -to_after if after else nowhere,
            to_after if after else -to_before if before else nowhere,
        )

    def _neighbour(self, pixel: int, axis: int, step: int) -> int:
        """The pixel `step` farther along an axis; itself where the picture ends."""
        row, column = divmod(pixel, self.grid.width)
        row, column = (row, column + step) if axis == 0 else (row + step, column)
        is_inside = 0 <= row < self.grid.height and 0 <= column < self.grid.width
        return row * self.grid.width + column if is_inside else pixel


def _is_one_surface(inverse: ArrayF64, heights: ArrayF64, edge: int) -> bool:
    """Whether pixels `edge` and `edge` + 1 of five are on one surface."""
    slopes = np.diff(inverse)
    slope = abs(slopes[edge])
    bend = np.fmin(abs(slopes[edge] - slopes[edge - 1]), abs(slopes[edge + 1] - slopes[edge]))
    climb = abs(heights[edge + 1] - heights[edge]) * inverse[1 if edge == 1 else 3]
    return bool(bend <= OFF_LINE[0] * slope + OFF_LINE[1] * inverse[2] or climb < LEVEL_SHARE * slope * abs(heights[2]))


def _shares(centre: ArrayF64, span: ArrayF64, gap: float) -> ArrayF64:
    """Places of the points along one side of a patch, -1 to 1."""
    across = span - (span @ centre) / (centre @ centre) * centre
    n = int(np.clip(np.ceil(np.linalg.norm(across) / np.linalg.norm(centre) / gap), 1, MOST_ALONG))
    return (2 * np.arange(n) + 1) / n - 1


def _unit(vector: ArrayF64) -> ArrayF64:
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else np.zeros(3)
