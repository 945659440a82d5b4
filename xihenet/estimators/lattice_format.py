"""What sizes does the lattice network have, and what of it depends on the anchors alone, and is therefore a table?

The anchors never move. Which of them a coarser anchor stands for, what the spherical harmonics are in their directions
and how radiance in the coarse directions becomes coefficients is computed once per number of anchors. NumPy inference
and torch training read the same tables, so the two cannot drift apart.

Any number of anchors is pooled to the first level, so one set of weights serves them all.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.estimators.weights_format import NetworkWeights, read_weights
from xihenet.records import ArrayF32, ArrayInt
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_SH = 9
N_ANCHOR_FEATURES = 14  # relative and encoded colour, clipped or not, log distance, projection there, direction
N_LEVEL_FEATURES = 7  # share set, direction, projection there
N_GLOBAL_FEATURES = 29  # projection's 27 coefficients, coverage, log of the mean
N_ERROR_HIDDEN = 32


@dataclass(frozen=True)
class LatticeArchitecture:
    """Sizes of the network; the defaults make 265,077 parameters."""

    levels: tuple[int, int, int] = (320, 80, 20)  # anchors of the coarser lattices; radiance is predicted on the second
    stem: int = 16  # features per anchor of the input, and then of the three levels
    fine: int = 32
    middle: int = 64
    coarse: int = 64
    narrow: int = 24  # features of each of the coarsest anchors that go into the dense layers, which know their places
    hidden: int = 256  # of the first dense layer
    code: int = 128  # of the second
    spread: int = 8  # features that the code gives to each direction of the output, each by weights of its own
    decoder: int = 48  # features per direction before the radiance
    is_exposure_normalised: bool = True  # colours are relative to the mean of the set anchors, the light scaled back
    knows_facing: bool = True  # how surfaces face the position weighs the projection and is told to the network

    def __post_init__(self) -> None:
        switches = {"is_exposure_normalised": self.is_exposure_normalised, "knows_facing": self.knows_facing}
        sizes = [*self.levels, *(v for k, v in asdict(self).items() if k not in ("levels", *switches))]
        if len(self.levels) != 3 or any(type(size) is not int or not 1 <= size <= 65_536 for size in sizes):
            raise ValueError(f"architecture: expected three levels and sizes of 1 to 65536, got {asdict(self)}")
        for name, switch in switches.items():
            if type(switch) is not bool:
                raise ValueError(f"architecture: {name} is true or false, not {switch}")

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of each layer, by name."""
        return {
            "stem": (N_ANCHOR_FEATURES + self.knows_facing, self.stem),
            "fine": (self.stem + N_LEVEL_FEATURES, self.fine),
            "middle": (self.fine + N_LEVEL_FEATURES, self.middle),
            "coarse": (self.middle + N_LEVEL_FEATURES, self.coarse),
            "narrow": (self.coarse, self.narrow),
            "dense": (self.levels[2] * self.narrow + N_GLOBAL_FEATURES, self.hidden),
            "code": (self.hidden, self.code),
            "spread": (self.code, self.levels[1] * self.spread),
            "decoder": (self.middle + self.spread + N_LEVEL_FEATURES, self.decoder),
            "radiance": (self.decoder, 3),
            "gate": (self.code, 9),
            "error_hidden": (self.code, N_ERROR_HIDDEN),
            "error": (N_ERROR_HIDDEN, 1),
        }

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of a weights file: `<layer>.weight` (outputs, inputs) and `<layer>.bias` (outputs,)."""
        shapes: dict[str, tuple[int, ...]] = {}
        for name, (n_in, n_out) in self.layer_sizes().items():
            shapes[f"{name}.weight"], shapes[f"{name}.bias"] = (n_out, n_in), (n_out,)
        return shapes


LatticeWeights = NetworkWeights[LatticeArchitecture]


def load_weights(path: Path) -> LatticeWeights:
    """Read and check lattice weights. ValueError naming the file and what was expected, also if it is missing."""
    return read_weights(path, "lattice", _lattice_architecture)


def _lattice_architecture(sizes: dict[str, Any]) -> LatticeArchitecture:
    # Files of before 2026-11-23 do not say, and their networks know nothing of it.
    return LatticeArchitecture(**{"knows_facing": False, **sizes, "levels": tuple(sizes["levels"])})


@dataclass(frozen=True, eq=False)
class PoolingTable:
    """Which fine anchors each coarse anchor stands for."""

    members: ArrayInt  # (n_coarse, k) numbers of fine anchors; `n_fine`, one past the last, fills rows with fewer
    counts: ArrayF32  # (n_coarse,) members of each row, at least 1


@dataclass(frozen=True, eq=False)
class AnchorTables:
    """What is known of a lattice of n anchors."""

    directions: ArrayF32  # (n, 3)
    basis: ArrayF32  # (n, 9)
    basis_products: ArrayF32  # (n, 81) of each two: their sum over the set anchors is the matrix of the least squares


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
