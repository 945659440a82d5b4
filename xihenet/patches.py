"""The patch of surface that a pixel shows: where it ends, how it is turned, and which points lie on it.

From a position just above a table that the camera sees at a flat angle, neighbouring pixels lie farther apart than
anchors do, and the floor shows between them. So pixels that are sparse among the anchors are taken for pieces of
surface that reach half-way to their neighbours, and are cut into points of their colour as densely as the anchors ask.

Which pixels? Those that are the nearest of their anchor and alone in its cell, along a row or a column of the picture,
beside another such one. This knows neither metres nor the lens, and changes nothing elsewhere. A sparse pixel behind
the nearest one of its cell has no patch: in seven rooms as good as no more leaked without those (0.1 % of the anchors
at most), for half of the cost.

What is one surface? Over the pixels of a plane the inverse of the distance to the camera is linear (along the optical
axis exactly, along the ray nearly, over three pixels). So two neighbours are on one surface if a third beside them, on
either side, continues their line: a crease passes, a step does not. A table that only two rows show has no third: two
pixels at one height, whose distances would have them climb or fall if one hid the other, are on a level surface. Where
only one side of a pixel passes, the other half continues it to the pixel's own border and no farther: what lies between
two surfaces stays unknown. Pixels without a usable point pass on no side, and a single row has no patches.

Rejected: an upsampled depth image, which costs as much for what is far, where nothing is gained; and quads between four
pixels, which lose half a pixel along every edge, and there the leaks are. Not in the paper.

Aimed at was 1.25 times the time of unprojecting and sampling without patches. It is 1.5 to 1.7 times in eight views of
two furnished scenes and 1.4 in a noisy box (2026-11-22, 256x192 pixels, 1280 anchors, minima of interleaved
repetitions; `addon_tests/bench/steps.py` prints such ratios): many small calls of NumPy, none of which stands out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from xihenet.records import AnchorSurfaces, ArrayBool, ArrayF32, ArrayF64, ArrayInt, PixelGrid

# In anchor spacings, sqrt(4 pi / N): as far apart are the points of a patch, at most. Cells are 0.9 wide and more; 0.5
# costs twice the points and left as many leaks in seven rooms.
POINT_GAP = 0.7

MOST_ALONG = 32  # Points along one side of a patch, at most
OFF_LINE = 0.25, 0.003  # A third pixel off the line of two: share of their difference, of the inverse distance
LEVEL_SHARE = 0.25  # Of the height by which a step along the ray would differ: closer in height is one level surface
NEAREST_M, FARTHEST_M = 1e-6, 1e6  # Patches are of points between; float32 can hold the fourth powers that are needed


@dataclass(frozen=True, eq=False)
class SeenGrid:
    """The points of one picture as seen from a position."""

    grid: PixelGrid
    columns: ArrayF32  # (3, P) x, y and z relative to the position
    distance_m: ArrayF32  # (P,) from the position, infinite for points that cannot be used
    camera: ArrayF32  # (3,) relative to the position
    has_holes: bool  # some points cannot be used, or are farther than FARTHEST_M


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of Q pixels, in metres relative to the position."""

    centre: ArrayF32  # (3, Q) the pixels' points
    # (2, 3, 2, Q) from there to the pixel's borders: first those to the left and above, then those to the right and
    # below; 0 along an axis of the picture on which no neighbour is of the same surface.
    to_border: ArrayF32

    def chosen(self, which: ArrayInt) -> Patches:
        """Those of these numbers."""
        return Patches(self.centre.take(which, axis=1), self.to_border.take(which, axis=3))


def lines_through(grid: PixelGrid, pixels: ArrayInt) -> ArrayInt:
    """(5, 2, Q) numbers of the pixels from two before to two after each one, along both axes; itself for those outside.

    Pixels are given by their numbers (Q,).
    """
    row = pixels // grid.width
    numbers = np.empty((5, 2, len(pixels)), np.intp)
    _steps_inside(grid.width).take(pixels - row * grid.width, axis=1, out=numbers[:, 0], mode="clip")
    np.multiply(_steps_inside(grid.height).take(row, axis=1), grid.width, out=numbers[:, 1])
    numbers += pixels
    return numbers


@lru_cache(maxsize=16)
def _steps_inside(n: int) -> ArrayInt:
    """(5, n) steps -2 to 2 from each of `n` places in a row; 0 for those that leave it."""
    steps = np.arange(-2, 3, dtype=np.intp)[:, None]  # NumPy 1 makes 32 bits of it on Windows: `take` refuses those.
    to = np.arange(n) + steps
    return np.where((to >= 0) & (to < n), steps, 0)


def sparse_pixels(seen: SeenGrid, lines: ArrayInt, anchors: ArrayInt) -> ArrayInt:
    """Which of Q pixels are sparse among the anchors (P,), in rising order; `lines` are those through them (5, 2, Q).

    One alone is often a corner of a cell that a row cuts off; two side by side are rare where pixels are dense.
    """
    cells = anchors.take(lines)
    ends = lines[1:] == lines[:-1]
    # Nothing beyond the picture is in a pixel's cell, or alone.
    differs = (cells[1:] != cells[:-1]) | ends
    beside = (differs[0] & ~ends[1]) | (differs[3] & ~ends[2])
    is_sparse = (differs[1] & differs[2] & beside).any(axis=0)
    distance_m = seen.distance_m.take(lines[2, 0])
    return np.flatnonzero(is_sparse & (distance_m > NEAREST_M) & (distance_m < FARTHEST_M))


def fit_patches(seen: SeenGrid, lines: ArrayInt) -> Patches:
    """The patches of the pixels in the middle of these lines (5, 2, Q), each of which has a usable point."""
    line = seen.columns.take(lines, axis=1, mode="clip")
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):  # Of neighbours that do not count.
        from_camera = line - seen.camera[:, None, None, None]
        inverse = _inverse_lengths(from_camera)
        if seen.has_holes:  # NaN passes through and makes every comparison False.
            inverse[~(seen.distance_m.take(lines) < FARTHEST_M)] = np.nan
        is_one = _are_one_surface(inverse, from_camera[2])
        is_one &= lines[1:4:2] != lines[2]
        steps = line[:, 1:4:2] - line[:, 2:3]
    steps *= np.float32(0.5)
    # A neighbour that is not on the surface may be anywhere, infinitely far too, so it is left out and not times 0.
    np.copyto(steps, np.float32(0), where=~is_one)
    to_border: ArrayF32 = steps - steps[:, ::-1] * ~is_one
    return Patches(line[:, 2, 0], to_border.swapaxes(0, 1))


def _are_one_surface(inverse: ArrayF32, heights: ArrayF32) -> ArrayBool:
    """(2, 2, Q): whether the third of five pixels (5, 2, Q) is on one surface with the second, and with the fourth.

    `inverse` are those of the distances to the camera, `heights` are above the camera.
    """
    slopes = inverse[1:] - inverse[:-1]
    bends = np.abs(slopes[1:] - slopes[:-1])
    sizes = np.abs(slopes[1:3])
    share, floor = OFF_LINE
    is_one: ArrayBool = np.fmin(bends[:2], bends[1:]) < share * sizes + floor * inverse[2]
    # Along the ray the height would change by the share by which the neighbour's distance differs from the pixel's.
    climb = np.abs(heights[2:4] - heights[1:3]) * inverse[1:4:2]
    is_one |= climb < sizes * np.abs(np.float32(LEVEL_SHARE) * heights[2])
    return is_one


def _inverse_lengths(columns: ArrayF32) -> ArrayF32:
    squares = columns[0] * columns[0]
    squares += columns[1] * columns[1]
    squares += columns[2] * columns[2]
    np.sqrt(squares, out=squares)
    return np.divide(np.float32(1), squares, out=squares)


def cut_patches(patches: Patches, n_anchors: int) -> tuple[ArrayInt, ArrayF32]:
    """Points spread over the patches that reach farther than POINT_GAP of the spacing of `n_anchors`.

    Returns which patch each point is of (K,), and x, y and z (3, K), contiguous.
    """
    across, along = _n_along(patches, float(np.sqrt(4 * np.pi / n_anchors)))
    n_points = across * along
    many = np.flatnonzero(n_points > 1)
    n_points = n_points.take(many)
    starts, shares = _shares()
    first = starts[across.take(many), along.take(many)] - (np.cumsum(n_points) - n_points)
    place = np.repeat(np.arange(len(many)), n_points)
    share = shares.take(np.arange(len(place)) + first.take(place), axis=1)
    # Of those few alone: the borders of each side of each axis, one after the other.
    halves = patches.to_border.take(many, axis=3).transpose(1, 2, 0, 3).reshape(3, -1)
    sides = (share > 0) + np.array([[0], [2]])
    sides *= len(many)
    sides += place
    parts = halves.take(sides, axis=1)
    parts *= np.abs(share)
    points = patches.centre.take(many, axis=1).take(place, axis=1)
    points += parts[:, 0]
    points += parts[:, 1]
    return many.take(place), points


@lru_cache(maxsize=1)
def _shares() -> tuple[ArrayInt, ArrayF32]:
    """Where each grid of a x b points begins, [a, b], and the points of all, (2, M): -1 to 1 along each axis."""
    starts, (across, along) = np.zeros((MOST_ALONG + 1,) * 2, np.intp), np.indices((MOST_ALONG,) * 2).reshape(2, -1) + 1
    n_points = across * along
    starts[across, along] = first = np.cumsum(n_points) - n_points
    across, along, first = (np.repeat(of_grids, n_points) for of_grids in (across, along, first))
    row, column = np.divmod(np.arange(len(first)) - first, across)
    return starts, np.stack([(2 * column + 1) / across - 1, (2 * row + 1) / along - 1]).astype(np.float32)


def _n_along(patches: Patches, spacing: float) -> ArrayInt:
    """(2, Q) points that each side of the patches asks for: its angle, seen from the position, over their gap."""
    centre, span = patches.centre, patches.to_border[1] - patches.to_border[0]
    square = np.einsum("cq,cq->q", centre, centre)
    in_depth = np.einsum("cq,caq->aq", centre, span)
    squares = np.einsum("caq,caq->aq", span, span)
    squares -= in_depth * in_depth / square
    squares /= square
    # Rounding makes what lies in depth alone negative.
    angles = np.sqrt(np.maximum(squares, 0, out=squares), out=squares)
    angles *= np.float32(1 / (POINT_GAP * spacing))
    return np.minimum(np.maximum(np.ceil(angles), 1), MOST_ALONG).astype(np.intp)


def describe_surfaces(
    seen: SeenGrid, patches: Patches, shown: ArrayInt, is_set: ArrayBool, directions: ArrayF64
) -> AnchorSurfaces:
    """What the set anchors show: `shown` (S,) are their patches, in the anchors' order; see `AnchorSurfaces`.

    A near patch is seen from many directions, so facing is asked of those of the anchors (N, 3).

    Without a neighbour of the same surface along both axes of the picture the normal is not known.
    """
    # float64, which holds the squares of all that float32 does.
    borders = patches.to_border.take(shown, axis=3)
    span = np.empty((5, 2, len(shown)))
    np.subtract(borders[1], borders[0], out=span[:3])
    span[3:] = span[:2]  # x and y again, so that slices say the cross product, far faster than numpy.cross.
    vectors = np.empty((2, 3, len(shown)))
    np.multiply(span[1:4, 0], span[2:5, 1], out=vectors[0])
    vectors[0] -= span[2:5, 0] * span[1:4, 1]
    np.subtract(seen.camera[:, None], patches.centre.take(shown, axis=1), out=vectors[1])
    lengths = np.sqrt(np.einsum("vcs,vcs->vs", vectors, vectors))
    # Lengths of 0, where there is no normal or where the camera stands in the surface, leave zeros.
    vectors /= np.maximum(lengths, 1e-300)[:, None]
    normal, view_direction = vectors
    seen_side = np.einsum("cs,cs->s", normal, view_direction)
    found = np.zeros((len(is_set), 5), np.float32)
    rows = np.empty((5, len(shown)), np.float32)
    rows[0] = np.einsum("cs,sc->s", normal, directions[is_set])
    rows[0] *= -np.copysign(1, seen_side)
    rows[1] = lengths[1]
    rows[2:] = view_direction
    found[is_set] = rows.T
    return AnchorSurfaces(found[:, 0], found[:, 1], found[:, 2:])
