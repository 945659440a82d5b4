"""The anchor table: which anchor is nearest to a direction, for the price of one look-up?

The sphere is cut into small cells once per lattice. A cell that lies wholly in the Voronoi cell of one anchor stores
that anchor, and the look-up is right there by construction. Any other cell stores the number of a short list of the
anchors that can win somewhere in it; only points that fall there, a few per cent, are compared.

The map. A direction d becomes p = d / (|x| + |y| + |z|), a point on an octahedron, whose x and y address square cells
in one of two layers, for the two signs of z. This needs no square root and no trigonometry, and the azimuth has no
seam. The corners of the square, half of its area, are never reached; a map that fills it takes more passes over the
points, which costs more time than the memory is worth. A table over azimuth and polar angle was rejected: it needs
trigonometry, and its cells shrink to slivers at the poles.

Why it is exact. A cell lies in one face of the octahedron, continued beyond the equator, where the lead of anchor i
over anchor j, (a_i - a_j) . p, is linear: i beats j everywhere in a cell if and only if it does at the four corners.
The build halves cells and drops from each the anchors that another one beats in this way; corner scores of the quarters
are averages of the whole's. What is left when the cells have their final size is the list. Cells with two
candidates, most of the small ones, are halved by a shorter way. `_MARGIN` covers points that float32 rounding puts into
the cell beside theirs.

Not here: anything about lattices. The table works for any set of different unit vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import reduce
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt

# With e = 2^-24: conversion, sums, division and product move p_x and p_y by 6 e of their size, the sum that makes them
# positive by e of at most 3 together, so p by at most 9 sqrt(2) e and the lead of one anchor over another, whose
# difference is at most 2 long, by 1.6e-6. Scores kept in float32 add e per halving, eleven at most, for two anchors:
# 1.4e-6.
_MARGIN = 4e-6


@dataclass(frozen=True, eq=False)
class AnchorTable:
    """The finished table; `find` is all that it is for."""

    directions: ArrayF64  # (n, 3) unit vectors
    n_cells: int  # along an edge of a layer
    # (2 (n_cells + 1)^2,) unsigned; below n an anchor, otherwise n + the number of a list. First the layer above the
    # equator, then the one below. Each repeats its last row and column, so that x = 1 and y = 1 need no clipping.
    codes: NDArray[Any]
    lists: ArrayInt  # (S, K) anchors in rising order, then the first again up to K; lists of two come first
    n_pairs: int  # of lists with two anchors
    pair_leads: ArrayF64  # (3, n_pairs) second anchor's direction minus the first's
    longer_directions: ArrayF64  # (S - n_pairs, K, 3) directions of the anchors of the other lists

    def find(self, columns: ArrayF32 | ArrayF64, taxicab: ArrayF32) -> ArrayInt:
        """The nearest anchor of each direction, (P,).

        `columns` (3, P) are x, y and z of directions of any length from 1e-30 to 1e30, contiguous; `taxicab` (P,) is
        |x| + |y| + |z| and is overwritten.
        """
        codes = self.codes.take(self._cells(columns.astype(np.float32, copy=False), taxicab), mode="clip")
        anchors = codes.astype(np.intp)
        undecided = np.flatnonzero(codes >= len(self.directions))
        if undecided.size:
            lists = anchors.take(undecided) - len(self.directions)
            anchors[undecided] = self._compare(lists, columns.take(undecided, axis=1).astype(np.float64))
        return anchors

    def _cells(self, columns: ArrayF32, taxicab: ArrayF32) -> NDArray[np.int32]:
        """The cell of each direction, as an index into `codes`."""
        half = np.float32(self.n_cells / 2)
        # In place where it can be: what the passes touch should stay in the cache.
        scale = row = np.divide(half, taxicab, out=taxicab)
        column = columns[0] * scale
        column += half
        row *= columns[1]
        row += half
        cells: NDArray[np.int32] = row.astype(np.int32)
        cells *= np.int32(self.n_cells + 1)
        cells += column.astype(np.int32)
        # The sign bit of z, spread over the word, selects the layer in half the time of a comparison and a product.
        below = columns[2].view(np.int32) >> np.int32(31)
        below &= np.int32(len(self.codes) // 2)
        cells += below
        return cells

    def _compare(self, lists: ArrayInt, columns: ArrayF64) -> ArrayInt:
        """The nearest anchor of each direction among those of its list; the lowest one if several are equally near."""
        # A longer list reads some pair here; its answer is replaced below.
        leads = self.pair_leads.take(lists, axis=1, mode="clip")
        leads *= columns
        second_wins = leads[0] + leads[1] + leads[2] > 0
        anchors: ArrayInt = self.lists.ravel().take(lists * self.lists.shape[1] + second_wins)
        longer = np.flatnonzero(lists >= self.n_pairs)
        if longer.size:
            rows = lists.take(longer)
            candidates = self.lists.take(rows, axis=0)
            rows -= self.n_pairs
            cosines = self.longer_directions.take(rows, axis=0) @ columns.take(longer, axis=1).T[:, :, None]
            winners = cosines.argmax(axis=1)[:, 0]
            anchors[longer] = candidates[np.arange(len(rows)), winners]
        return anchors


@dataclass(frozen=True, eq=False)
class _Cells:
    """Cells of one level and, cell after cell, the anchors that can still win in them."""

    row: ArrayInt  # (C,) along y; those of the layer below the equator follow those of the one above
    column: ArrayInt  # (C,) along x
    lengths: ArrayInt  # (C,) candidates per cell, at least 1
    anchors: ArrayInt  # (M,) candidates of all cells, in rising order within a cell; M is the sum of `lengths`
    scores: ArrayF32  # (2, 2, M) anchor . corner at the cell's corners, [row, column]


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Cells of one level with two candidates each."""

    row: ArrayInt  # (C,)
    column: ArrayInt  # (C,)
    anchors: ArrayInt  # (2, C) in rising order
    scores: ArrayF32  # (2, 2, 2, C) at the cell's corners, [row, column, candidate]


Part = TypeVar("Part", _Cells, _Pairs)


def cells_for(n_anchors: int) -> int:
    """How many cells along an edge of a layer suit a lattice.

    36 sqrt(n) leaves 4 to 8 per cent of the points to be compared; fewer cells mean more of them, more cells more cache
    misses and a longer build. At most 2048: 17 MB.
    """
    return int(min(2048, 2 ** np.ceil(np.log2(36 * np.sqrt(n_anchors)))))


def build_anchor_table(directions: ArrayF64, n_cells: int) -> AnchorTable:
    """The table of (n, 3) unit vectors, n >= 1, by halving cells from 2 x 2 per layer to `n_cells` x `n_cells`.

    ValueError unless `n_cells` is a power of two, at least 2.
    """
    if n_cells < 2 or n_cells & (n_cells - 1):
        raise ValueError(f"n_cells: expected a power of two of at least 2, got {n_cells}")
    # In 16 bits where anchors fit: at 32 the last grid alone takes 0.1 s.
    codes = np.zeros((4, 2), _code_type(len(directions)))
    longer, pairs = _split(_undecided(_first_cells(directions), codes))
    while codes.shape[1] < n_cells:
        codes = codes.repeat(2, axis=0).repeat(2, axis=1)
        halved_pairs = _halved_pairs(pairs, codes)
        longer, new_pairs = _split(_halved(longer, codes))
        pairs = _joined([new_pairs, *halved_pairs])
    lists, list_of_cell = _unique_lists(longer, len(directions))
    keys = pairs.anchors[0] * len(directions) + pairs.anchors[1]
    of_two = np.unique(keys)
    padded = np.full((len(of_two), lists.shape[1]), -1)
    padded[:, 0], padded[:, 1] = np.divmod(of_two, len(directions))
    codes = codes.astype(_code_type(len(directions) + len(of_two) + len(lists)), copy=False)
    codes[pairs.row, pairs.column] = len(directions) + np.searchsorted(of_two, keys)
    codes[longer.row, longer.column] = len(directions) + len(of_two) + list_of_cell
    return _finished(directions, codes.reshape(2, n_cells, n_cells), np.concatenate([padded, lists]))


def _code_type(n_codes: int) -> type[np.uint16 | np.uint32]:
    return np.uint16 if n_codes <= 2**16 else np.uint32


def _finished(directions: ArrayF64, codes: NDArray[Any], lists: ArrayInt) -> AnchorTable:
    """Pad the layers and prepare the pairs."""
    padded = np.pad(codes, ((0, 0), (0, 1), (0, 1)), mode="edge")
    n_pairs = int((lists[:, 2] < 0).sum())
    lists = np.where(lists < 0, lists[:, :1], lists)
    first, second = directions[lists[:n_pairs, 0]], directions[lists[:n_pairs, 1]]
    # A longer list reads the last pair before it is put right: there must be one.
    leads = np.ascontiguousarray((second - first).T) if n_pairs else np.zeros((3, 1))
    return AnchorTable(directions, codes.shape[1], padded.ravel(), lists, n_pairs, leads, directions[lists[n_pairs:]])


def _first_cells(directions: ArrayF64) -> _Cells:
    """The eight cells of 2 x 2 per layer, each with every anchor."""
    layer, row, column = (index.ravel() for index in np.indices((2, 2, 2)))
    y, x = np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], indexing="ij")
    height = 1 - np.abs(x) - np.abs(y)
    scores = []
    for cell in zip(layer, row, column, strict=True):
        corner = np.s_[cell[1] : cell[1] + 2, cell[2] : cell[2] + 2]
        points = np.stack([x[corner], y[corner], height[corner] * (-1 if cell[0] else 1)], axis=-1)
        scores.append((points @ directions.T).astype(np.float32))
    n = len(directions)
    every = np.tile(np.arange(n), 8)
    return _Cells(2 * layer + row, column, np.full(8, n), every, np.concatenate(scores, axis=2))


def _undecided(cells: _Cells, codes: NDArray[Any]) -> _Cells:
    """The cells that several candidates can win, with these; the winner of any other cell is written to `codes`.

    A candidate goes if the cell's strongest one beats it at all four corners, by more than the margin.
    """
    if not len(cells.lengths):
        return cells
    is_reached = _is_reached(cells.row, cells.column, codes.shape[1])
    starts = np.cumsum(cells.lengths) - cells.lengths
    strength = cells.scores.sum(axis=(0, 1))
    strongest = np.maximum.reduceat(strength, starts)
    position = np.where(strength == np.repeat(strongest, cells.lengths), np.arange(len(strength)), len(strength))
    leader = np.minimum.reduceat(position, starts)
    lead = cells.scores.take(np.repeat(leader, cells.lengths), axis=-1) - cells.scores
    can_win = lead.min(axis=(0, 1)) <= _MARGIN
    lengths = np.add.reduceat(can_win.astype(np.intp), starts)
    decided, is_open = is_reached & (lengths == 1), is_reached & (lengths > 1)
    codes[cells.row[decided], cells.column[decided]] = cells.anchors[leader[decided]]
    kept = np.flatnonzero(can_win & np.repeat(is_open, cells.lengths))
    of_cells = cells.row[is_open], cells.column[is_open], lengths[is_open]
    # `take` along the last axis is several times as fast as an index of it.
    return _Cells(*of_cells, cells.anchors[kept], cells.scores.take(kept, axis=-1))


def _halved(cells: _Cells, codes: NDArray[Any]) -> _Cells:
    """The undecided ones among the four quarters of each cell; `codes` are those of the finer grid."""
    grid = _scores_at_quarters(cells.scores)
    quarters = []
    for i, j in np.ndindex(2, 2):
        scores = grid[i : i + 2, j : j + 2]
        quarter = _Cells(2 * cells.row + i, 2 * cells.column + j, cells.lengths, cells.anchors, scores)
        quarters.append(_undecided(quarter, codes))
    return _joined(quarters)


def _halved_pairs(pairs: _Pairs, codes: NDArray[Any]) -> list[_Pairs]:
    """As `_halved`, quarter by quarter, where two candidates are left: most cells, once they are small."""
    grid = _scores_at_quarters(pairs.scores)
    lead = grid[:, :, 0] - grid[:, :, 1]  # of the first candidate over the second
    corners = lead[:-1, :-1], lead[:-1, 1:], lead[1:, :-1], lead[1:, 1:]
    low, high = (reduce(of, corners) for of in (np.minimum, np.maximum))
    quarters = []
    for i, j in np.ndindex(2, 2):
        row, column = 2 * pairs.row + i, 2 * pairs.column + j
        is_reached = _is_reached(row, column, codes.shape[1])
        for anchors, wins in zip(pairs.anchors, (low[i, j] > _MARGIN, high[i, j] < -_MARGIN), strict=True):
            decided = np.flatnonzero(is_reached & wins)
            codes.put(row[decided] * codes.shape[1] + column[decided], anchors[decided])
        kept = np.flatnonzero(is_reached & (low[i, j] <= _MARGIN) & (high[i, j] >= -_MARGIN))
        scores = np.array([[corner.take(kept, axis=1) for corner in line[j : j + 2]] for line in grid[i : i + 2]])
        quarters.append(_Pairs(row[kept], column[kept], pairs.anchors.take(kept, axis=1), scores))
    return quarters


def _scores_at_quarters(corners: ArrayF32) -> ArrayF32:
    """(3, 3, ...) scores at the corners of quarters, from those at the corners of cells (2, 2, ...)."""
    grid = np.empty((3, 3, *corners.shape[2:]), np.float32)
    grid[::2, ::2] = corners
    grid[1, ::2] = (corners[0] + corners[1]) / 2
    grid[::2, 1] = (corners[:, 0] + corners[:, 1]) / 2
    grid[1, 1] = (grid[0, 1] + grid[2, 1]) / 2
    return grid


def _is_reached(row: ArrayInt, column: ArrayInt, n_cells: int) -> ArrayBool:
    """Whether |x| + |y| <= 1 somewhere in a cell: its corner nearest to the middle decides."""
    y, x = (np.abs(2 * k - (n_cells - 1)) for k in (row % n_cells, column))
    is_reached: ArrayBool = x + y <= n_cells + 2
    return is_reached


def _split(cells: _Cells) -> tuple[_Cells, _Pairs]:
    """The cells with more than two candidates, and those with two."""
    is_pair = cells.lengths == 2
    of_pairs = np.repeat(is_pair, cells.lengths)
    row, column, lengths = cells.row, cells.column, cells.lengths
    anchors, scores = cells.anchors[of_pairs].reshape(-1, 2).T, cells.scores[..., of_pairs].reshape(2, 2, -1, 2)
    pairs = _Pairs(row[is_pair], column[is_pair], anchors, scores.swapaxes(2, 3))
    kept, chosen = ~of_pairs, ~is_pair
    return _Cells(row[chosen], column[chosen], lengths[chosen], cells.anchors[kept], cells.scores[..., kept]), pairs


def _joined(parts: Sequence[Part]) -> Part:
    first = parts[0]
    return type(first)(*(np.concatenate([getattr(p, f.name) for p in parts], axis=-1) for f in fields(first)))


def _unique_lists(cells: _Cells, n_anchors: int) -> tuple[ArrayInt, ArrayInt]:
    """The different candidate lists, (S, K) padded with -1 and shortest first, and the number of each cell's list."""
    n_columns = max(3, int(cells.lengths.max(initial=0)))
    starts = np.cumsum(cells.lengths) - cells.lengths
    table = np.full((len(starts), n_columns), -1, np.intp)
    rows = np.repeat(np.arange(len(starts)), cells.lengths)
    table[rows, np.arange(len(rows)) - starts[rows]] = cells.anchors
    first, list_of_cell = np.zeros(0, np.intp), cells.lengths
    for i in range(0, n_columns, 2):
        # Two columns at a time: with fewer than 2^24 cells and 2^17 anchors the key stays below 2^58.
        key = list_of_cell
        for column in table.T[i : i + 2]:
            key = key * (n_anchors + 1) + column + 1
        _, first, list_of_cell = np.unique(key, return_index=True, return_inverse=True)
    return table[first], list_of_cell
