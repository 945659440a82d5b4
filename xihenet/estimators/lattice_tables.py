"""What of the lattice network depends on the anchors alone, and is therefore a table?

The anchors never move. Which of them a coarser anchor stands for, what the spherical harmonics are in their directions
and how radiance in the coarse directions becomes coefficients is computed once per number of anchors. NumPy inference
and torch training read the same tables, so the two cannot drift apart.

Any number of anchors is pooled to the first level, so one set of weights serves them all.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from xihenet.records import ArrayF32, ArrayInt
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_SH = 9


@dataclass(frozen=True, eq=False)
class PoolingTable:
    """Which fine anchors each coarse anchor stands for.

    `members` (n_coarse, k) are numbers of fine anchors; `n_fine`, one past the last, fills rows with fewer. `counts`
    (n_coarse,), float32, are the members of each row, at least 1.
    """

    members: ArrayInt
    counts: ArrayF32


@dataclass(frozen=True, eq=False)
class AnchorTables:
    """What is known of a lattice of n anchors, float32: directions (n, 3) and basis (n, 9).

    `basis_products` (n, 81) are of each two basis functions: their sum over the set anchors is the matrix of the least
    squares.
    """

    directions: ArrayF32
    basis: ArrayF32
    basis_products: ArrayF32


@lru_cache(maxsize=16)
def anchor_tables(n: int) -> AnchorTables:
    """The tables of `AnchorLattice(n)`."""
    directions = AnchorLattice(n).directions
    table = basis(directions, 2)
    products = (table[:, :, None] * table[:, None, :]).reshape(n, N_SH * N_SH)
    return AnchorTables(directions.astype(np.float32), table.astype(np.float32), products.astype(np.float32))


@lru_cache(maxsize=32)
def pooling_table(n_fine: int, n_coarse: int) -> PoolingTable:
    """Each fine anchor belongs to the coarse one nearest to it; a coarse one without any takes the fine one nearest."""
    fine, coarse = AnchorLattice(n_fine), AnchorLattice(n_coarse)
    owner = coarse.nearest(fine.directions, "brute")
    rows = [np.flatnonzero(owner == i) for i in range(n_coarse)]
    substitute = fine.nearest(coarse.directions, "brute")
    rows = [row if len(row) else substitute[i : i + 1] for i, row in enumerate(rows)]
    members = np.full((n_coarse, max(len(row) for row in rows)), n_fine, np.intp)
    for i, row in enumerate(rows):
        members[i, : len(row)] = row
    return PoolingTable(members, np.array([len(row) for row in rows], np.float32))


@dataclass(frozen=True, eq=False)
class SlotOrder:
    """The same pooling by adding blocks: each coarse anchor's first member, then the second of those that have one.

    Coarse anchors are ordered by falling number of members, so that each further block lies on the first so many.
    """

    coarse: ArrayInt  # (n_coarse,) numbers of the coarse anchors in that order
    fine: ArrayInt  # (m,) numbers of the fine anchors, block by block; more than all where one stands in for several
    lengths: tuple[int, ...]  # of the blocks
    counts: ArrayF32  # (n_coarse,) float32, members of each coarse anchor, at least 1
    is_first: ArrayF32  # (m,) float32, 1 but for a fine anchor that came before

    def sums(self, values: ArrayF32, axis: int) -> ArrayF32:
        """Sums over each coarse anchor's members along `axis`, which holds the m fine anchors in order."""
        before = (slice(None),) * axis
        result = values[(*before, slice(self.lengths[0]))].copy()
        start = self.lengths[0]
        for length in self.lengths[1:]:
            result[(*before, slice(length))] += values[(*before, slice(start, start + length))]
            start += length
        return result


@lru_cache(maxsize=32)
def slot_order(n_fine: int, n_coarse: int) -> SlotOrder:
    """`pooling_table` of the same arguments, by blocks."""
    table = pooling_table(n_fine, n_coarse)
    coarse = np.argsort(-table.counts, kind="stable")
    slots = [slot[slot < n_fine] for slot in table.members[coarse].T]
    fine = np.concatenate(slots)
    is_first = np.zeros(len(fine), np.float32)
    is_first[np.unique(fine, return_index=True)[1]] = 1
    return SlotOrder(coarse, fine, tuple(map(len, slots)), table.counts[coarse], is_first)


@lru_cache(maxsize=32)
def pooling_matrix(n_fine: int, n_coarse: int) -> ArrayF32:
    """`pooling_table` of the same arguments as (n_fine, n_coarse), 1 for each member: a product with it gives sums."""
    table = pooling_table(n_fine, n_coarse)
    matrix = np.zeros((n_fine + 1, n_coarse), np.float32)
    matrix[table.members, np.arange(n_coarse)[:, None]] = 1
    return matrix[:n_fine]


@lru_cache(maxsize=8)
def quadrature_matrix(n: int) -> ArrayF32:
    """(9, n) float32: coefficients from radiance in the directions of `AnchorLattice(n)`, by least squares.

    Exact for light of order 2, constant light included, however uneven the lattice. ValueError below 9 directions.
    """
    if n < N_SH:
        raise ValueError(f"quadrature: expected at least {N_SH} directions, got {n}")
    table = basis(AnchorLattice(n).directions, 2)
    return np.linalg.pinv(table).astype(np.float32)
