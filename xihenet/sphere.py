"""The sphere: which directions stand for all of it, and which of them is nearest to a given one?

The anchors are the reference's Fibonacci lattice with its pole on +Z, in the same index order, so that a record on the
wire means the same direction (the paper's section on unit-sphere sampling). Three ways to find the nearest anchor stay
side by side, so that what exactness costs can be shown:

- `exact`, the default: cells that know whether they are decided (`anchor_table`);
- `table`, the paper's acceleration grid over azimuth and polar angle: the anchor nearest to the centre of the cell;
- `brute`, every anchor's cosine in float64: the plain reference.

Rejected as slower by more than a magnitude: a k-d tree, which also needs SciPy, and the analytic inverse of the lattice
(Keinert et al. 2015). Lattices of one size are equal and share their tables, which are built on first use and cached.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from operator import index
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.anchor_table import AnchorTable, build_anchor_table, cells_for
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt

NearestMethod = Literal["exact", "table", "brute"]

TABLE_SIZE = (1024, 512)  # The paper's
MAX_ANCHORS = 65_536  # an anchor's index has 16 bits on the wire
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
_BRUTE_BLOCK = 2**18  # cosines at a time: 2 MB, which stays in the cache


@dataclass(frozen=True)
class AnchorLattice:
    """Fibonacci lattice of `n` anchors on the unit sphere, 1 to 65,536."""

    n: int

    def __post_init__(self) -> None:
        n = index(self.n)
        if not 1 <= n <= MAX_ANCHORS:
            raise ValueError(f"AnchorLattice.n: expected 1 to {MAX_ANCHORS} anchors, got {n}")
        object.__setattr__(self, "n", n)

    def __len__(self) -> int:
        return self.n

    @property
    def directions(self) -> ArrayF64:
        """(n, 3) unit vectors, world frame, +Z up; anchor 0 points to +Z. Read-only."""
        return _lattice_directions(self.n)

    def nearest(
        self, directions: ArrayLike, method: NearestMethod = "exact", table_size: tuple[int, int] = TABLE_SIZE
    ) -> ArrayInt:
        """The anchor with the largest cosine to each direction, (P,); 0 for a direction that is zero, NaN or infinite.

        Directions (P, 3) are in the world frame, of any positive length; P may be 0. Anything but float32 is read as
        float64. "exact" and "brute" are never more than 1e-7 below the best cosine; "table" is wrong for some per cent,
        and has `table_size` cells over azimuth and over polar angle. ValueError for another shape, an unknown method or
        a table without cells.
        """
        rows = np.asarray(directions)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise ValueError(f"directions: expected an array of shape (any, 3), got {rows.shape}")
        columns: NDArray[Any] = np.ascontiguousarray(rows.T, np.float32 if rows.dtype == np.float32 else np.float64)
        return self.nearest_to_columns(columns, method, table_size)

    def nearest_to_columns(
        self, columns: ArrayF32 | ArrayF64, method: NearestMethod = "exact", table_size: tuple[int, int] = TABLE_SIZE
    ) -> ArrayInt:
        """As `nearest`, for (3, P) contiguous x, y and z: a fifth faster, for those who have them that way."""
        if method not in ("exact", "table", "brute"):
            raise ValueError(f"method: expected exact, table or brute, got {method!r}")
        if columns.shape[1] == 0:
            return np.zeros(0, np.intp)
        if method == "exact":
            return _find_exactly(columns, _exact_table(self.n))
        if method == "table":
            return _look_up(columns, _angular_table(self.n, *table_size))
        return _largest_cosine(_rescaled(columns), self.directions)

    def means(
        self, directions: ArrayF64, values: ArrayLike, weights: ArrayF64 | None = None
    ) -> tuple[ArrayF64, ArrayBool]:
        """(n, 3) the mean of `values` (P, 3) over the directions (P, 3) around each anchor, and (n,) which have any.

        0 for those that have none. `weights` (P,), if any, are such as solid angles.
        """
        anchors = self.nearest(directions)
        of_each = np.ones(len(anchors)) if weights is None else weights
        total = np.bincount(anchors, of_each, self.n)
        sums = [np.bincount(anchors, of_each * channel, self.n) for channel in np.asarray(values).T]
        return np.stack(sums, axis=1) / np.where(total > 0, total, 1.0)[:, None], total > 0

    def neighbours(self, k: int) -> ArrayInt:
        """(n, k) for each anchor itself and its k - 1 nearest, nearest first, lower index first if equally near.

        0.02 s for 2048 anchors, 1.7 s for 65,536. Cached, read-only. ValueError unless 0 < k <= n.
        """
        if not 1 <= k <= self.n:
            raise ValueError(f"neighbours: expected 1 to {self.n} neighbours of {self.n} anchors, got {k}")
        return _neighbours(self.n, k)


@lru_cache(maxsize=32)
def _lattice_directions(n: int) -> ArrayF64:
    """(n, 3) the lattice; a single anchor points to +Z, where the formula would divide by zero."""
    i = np.arange(n)
    z = 1 - 2 * i / max(n - 1, 1)
    radius = np.sqrt(1 - z * z)
    azimuth = i * _GOLDEN_ANGLE
    directions: ArrayF64 = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    directions.flags.writeable = False
    return directions


@lru_cache(maxsize=16)  # the twelve of the joint entropy, 65 MB together, and some in use
def _exact_table(n: int) -> AnchorTable:
    return build_anchor_table(_lattice_directions(n), cells_for(n))


def _find_exactly(columns: ArrayF32 | ArrayF64, table: AnchorTable) -> ArrayInt:
    taxicab = _taxicab_lengths(columns)
    if not _is_ordinary(taxicab):
        columns = _rescaled(columns)
        taxicab = _taxicab_lengths(columns)
    return table.find(columns, taxicab.astype(np.float32, copy=False))


def _taxicab_lengths(columns: ArrayF32 | ArrayF64) -> NDArray[Any]:
    """(P,) |x| + |y| + |z|; infinite where it overflows."""
    lengths: NDArray[Any] = np.abs(columns[0])
    with np.errstate(over="ignore"):  # Infinite lengths are not ordinary, and their directions are scaled first.
        lengths += np.abs(columns[1])
        lengths += np.abs(columns[2])
    return lengths


def _is_ordinary(sizes: NDArray[Any]) -> bool:
    """Whether float32 can work with all sizes and their reciprocals. NaN is not ordinary, as comparisons fail."""
    return bool(sizes.min() > 1e-30 and sizes.max() < 1e30)


def _rescaled(columns: ArrayF32 | ArrayF64) -> ArrayF64:
    """The same directions with 1 as their largest component; +Z for those that are zero, NaN or infinite."""
    largest = np.abs(columns).max(axis=0).astype(np.float64)
    is_usable: ArrayBool = (largest > 0) & np.isfinite(largest)
    rescaled = np.tile(np.array([[0.0], [0.0], [1.0]]), len(largest))
    np.divide(columns, largest, out=rescaled, where=is_usable)
    return rescaled


@lru_cache(maxsize=8)
def _angular_table(n: int, width: int, height: int) -> NDArray[np.uint16]:
    """The paper's acceleration grid: the anchor nearest to the centre of each cell, [polar angle, azimuth].

    (height + 1, width + 1), from +Z to -Z and from -pi to pi: the last row and column are repeated, so that the pole at
    -Z and an azimuth of pi need no clipping.
    """
    if min(width, height) < 1 or width * height > 2**28:
        raise ValueError(f"table_size: expected 1 to 2^28 cells, got {width} x {height}")
    azimuth = (np.arange(width) + 0.5) * (2 * np.pi / width) - np.pi
    polar = ((np.arange(height) + 0.5) * (np.pi / height))[:, None]
    centres = np.empty((3, height, width))
    centres[0] = np.sin(polar) * np.cos(azimuth)
    centres[1] = np.sin(polar) * np.sin(azimuth)
    centres[2] = np.cos(polar)
    anchors = _find_exactly(centres.reshape(3, -1), _exact_table(n)).astype(np.uint16)
    return np.pad(anchors.reshape(height, width), ((0, 1), (0, 1)), mode="edge")


def _look_up(columns: ArrayF32 | ArrayF64, table: NDArray[np.uint16]) -> ArrayInt:
    """The anchor of the cell over azimuth and polar angle. All in float32, whose trigonometry NumPy vectorises."""
    height, width = table.shape[0] - 1, table.shape[1] - 1
    with np.errstate(over="ignore"):  # Infinite squares are not ordinary, and their directions are scaled first.
        x, y, z = columns.astype(np.float32, copy=False)
        horizontal = x * x
        horizontal += y * y
        squares = z * z
        squares += horizontal
    if not _is_ordinary(squares):
        return _look_up(_rescaled(columns), table)
    column = np.arctan2(y, x)
    column *= np.float32(width / (2 * np.pi))
    column += np.float32(width / 2)
    row = np.sqrt(horizontal, out=horizontal)
    np.arctan2(row, z, out=row)
    row *= np.float32(height / np.pi)
    cells = row.astype(np.int32)
    cells *= np.int32(width + 1)
    cells += column.astype(np.int32)
    return table.take(cells, mode="clip").astype(np.intp)


def _largest_cosine(columns: ArrayF64, directions: ArrayF64) -> ArrayInt:
    """The anchor with the largest scalar product, the lowest one of several; in blocks that fit the cache."""
    rows = max(1, _BRUTE_BLOCK // len(directions))
    anchors = np.empty(columns.shape[1], np.intp)
    for start in range(0, len(anchors), rows):
        cosines = columns[:, start : start + rows].T @ directions.T
        cosines.argmax(axis=1, out=anchors[start : start + rows])
    return anchors


_ROWS = 256  # anchors whose neighbours are searched together
_SEARCHED = 7  # Whoever asks for fewer neighbours gets the first of these, so that they are searched once.


@lru_cache(maxsize=32)
def _neighbours(n: int, k: int) -> ArrayInt:
    if k < _SEARCHED <= n:
        few = np.ascontiguousarray(_neighbours(n, _SEARCHED)[:, :k])
        few.flags.writeable = False
        return few
    directions = _lattice_directions(n)
    neighbours = np.empty((n, k), np.intp)
    band = k
    for start in range(0, n, _ROWS):
        own = directions[start : start + _ROWS]
        while True:
            first, last = max(0, start - band), min(n, start + len(own) + band)
            cosines = own @ directions[first:last].T
            # More than k, so that anchors that tie at the end are all there to be ordered.
            n_near = min(k + 8, last - first)
            near = np.argpartition(-cosines, n_near - 1, axis=1)[:, :n_near]
            near.sort(axis=1)
            values = np.take_along_axis(cosines, near, axis=1)
            order = np.argsort(-values, axis=1, kind="stable")[:, :k]
            # Rising numbers are falling heights: of those outside the band none is nearer than the next height.
            farthest = np.take_along_axis(values, order[:, -1:], axis=1)[:, 0]
            if all(np.all(farthest > _cosine_at_most(own, directions[i, 2])) for i in (first - 1, last) if 0 <= i < n):
                break
            band *= 2
        neighbours[start : start + len(own)] = first + np.take_along_axis(near, order, axis=1)
    neighbours.flags.writeable = False
    return neighbours


def _cosine_at_most(directions: ArrayF64, height: float) -> ArrayF64:
    """The largest cosine of each unit vector to those of that z, and what rounding may add to it."""
    return directions[:, 2] * height + np.sqrt((1 - directions[:, 2] ** 2) * (1 - height**2)) + 1e-12
