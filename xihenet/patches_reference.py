"""Patches of surface, pixel after pixel in float64: slow, and meant to be read and compared with `patches`.

Only `sample_unit_sphere_reference` uses it. The rules and their reasons are in `patches`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xihenet.patches import FARTHEST_M, LEVEL_SHARE, MOST_ALONG, NEAREST_M, POINT_GAP, SAME_SURFACE
from xihenet.records import AnchorSurfaces, ArrayBool, ArrayF64, ArrayInt, PixelGrid


@dataclass(frozen=True, eq=False)
class PlainPicture:
    """The P points of a picture, relative to the position."""

    grid: PixelGrid
    points: ArrayF64  # (P, 3)
    is_usable: ArrayBool  # (P,) neither at the position nor without a place or a colour
    anchors: ArrayInt  # (P,) nearest to each
    camera: ArrayF64  # (3,)

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
            (left, right, _), (up, down, _) = (self._to_border(pixel, axis) for axis in (0, 1))
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
        facing, incidence, camera_distance_m = np.zeros((3, n), np.float32)
        view_direction, is_edge = np.zeros((n, 3), np.float32), np.zeros(n, bool)
        for anchor in np.flatnonzero(pixels >= 0):
            pixel = int(pixels[anchor])
            point = self.points[pixel]
            (left, right, ends_across), (up, down, ends_along) = (self._to_border(pixel, axis) for axis in (0, 1))
            to_camera, normal = self.camera - point, np.cross(right - left, down - up)
            camera_distance_m[anchor] = np.linalg.norm(to_camera)
            view_direction[anchor] = _unit(to_camera)
            cosine = _unit(normal) @ _unit(to_camera)
            incidence[anchor] = abs(cosine)
            facing[anchor] = -np.copysign(1, cosine) * (_unit(normal) @ directions[anchor])
            is_edge[anchor] = ends_across or ends_along
        return AnchorSurfaces(facing, incidence, camera_distance_m, view_direction, is_edge)

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

    def _to_border(self, pixel: int, axis: int) -> tuple[ArrayF64, ArrayF64, bool]:
        """From a pixel's point to its borders before and after along an axis of the picture; whether one is an edge."""
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
            not (before and after),
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
    return bool(
        bend <= SAME_SURFACE[0] * slope + SAME_SURFACE[1] * inverse[2] or climb < LEVEL_SHARE * slope * abs(heights[2])
    )


def _shares(centre: ArrayF64, span: ArrayF64, gap: float) -> ArrayF64:
    """Places of the points along one side of a patch, -1 to 1."""
    across = span - (span @ centre) / (centre @ centre) * centre
    n = int(np.clip(np.ceil(np.linalg.norm(across) / np.linalg.norm(centre) / gap), 1, MOST_ALONG))
    return (2 * np.arange(n) + 1) / n - 1


def _unit(vector: ArrayF64) -> ArrayF64:
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else np.zeros(3)
