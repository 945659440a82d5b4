"""The format of the lattice network: its sizes, and what depends on the anchors alone and is therefore a table.

The anchors never move. In which cell of a coarser grid each lies, what the spherical harmonics are in their directions
and how radiance in the cells becomes coefficients is computed once per number of anchors. NumPy inference
and torch training read the same tables, so the two cannot drift apart.

Any number of anchors is pooled to the first level, so one set of weights serves them all.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from xihenet.estimators.ring_grid import ring_grid
from xihenet.estimators.weights_format import NetworkWeights, read_weights
from xihenet.records import ArrayF32, ArrayF64, ArrayInt
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_SH = 9
LEVELS = (320, 80, 24)  # cells of the coarser grids; radiance is predicted on the second
N_ANCHOR_FEATURES = 10  # relative colour, clipped or not, log distance, facing, projection there, height
N_LEVEL_FEATURES = 5  # share set, projection there, height
N_GLOBAL_FEATURES = 28  # projection's 27 coefficients, coverage
N_ERROR_HIDDEN = 32

GATE_OF = np.array([0, 1, 2, 1, 3, 4, 5, 4, 3])
"""Which of the six gates each coefficient has: those that a turn about the vertical mixes share one."""
N_GATES = 6


@dataclass(frozen=True)
class LatticeArchitecture:
    """Sizes of the network; the defaults make 165,138 parameters."""

    stem: int = 24  # features per anchor of the input, and then of the three levels
    fine: int = 48
    middle: int = 96
    coarse: int = 96
    narrow: int = 24  # features of each of the coarsest cells that go into the dense layers, which know their places
    hidden: int = 128  # of the first dense layer, for each turn of the room
    code: int = 64  # of the second
    spread: int = 8  # features that the code gives to each direction of the output, each by weights of its own
    decoder: int = 72  # features per direction before the radiance
    # Light is added where anchors are clipped as well, and not only where nothing was seen: of all of the light, white
    # is the least that a clipped anchor says.
    opens_clipped: bool = False

    def __post_init__(self) -> None:
        sizes = {name: size for name, size in asdict(self).items() if name != "opens_clipped"}
        if any(type(size) is not int or not 1 <= size <= 65_536 for size in sizes.values()):
            raise ValueError(f"architecture: expected sizes of 1 to 65536, got {sizes}")
        if type(self.opens_clipped) is not bool:
            raise ValueError(f"architecture: expected opens_clipped as true or false, got {self.opens_clipped!r:.80}")

    def layer_sizes(self) -> dict[str, tuple[int, int]]:
        """Inputs and outputs of each layer, by name."""
        return {
            "stem": (N_ANCHOR_FEATURES, self.stem),
            "fine": (self.stem + N_LEVEL_FEATURES, self.fine),
            "middle": (self.fine + N_LEVEL_FEATURES, self.middle),
            "coarse": (self.middle + N_LEVEL_FEATURES, self.coarse),
            "narrow": (self.coarse, self.narrow),
            "dense": (LEVELS[2] * self.narrow + N_GLOBAL_FEATURES, self.hidden),
            "code": (2 * self.hidden, self.code),
            "spread": (self.code, LEVELS[1] * self.spread),
            "decoder": (self.middle + self.spread + N_LEVEL_FEATURES, self.decoder),
            "radiance": (self.decoder, 3),
            "gate": (self.code, N_GATES),
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
    return read_weights(path, "lattice", lambda sizes: LatticeArchitecture(**sizes))


@dataclass(frozen=True, eq=False)
class PoolingTable:
    """Which anchors each cell stands for."""

    members: ArrayInt  # (n, k) numbers of anchors; the number of all, one past the last, fills rows with fewer
    counts: ArrayF32  # (n,) members of each row, at least 1


@dataclass(frozen=True, eq=False)
class PlaceTables:
    """What is known of n directions."""

    basis: ArrayF32  # (n, 9)
    height: ArrayF32  # (n,) z

    @classmethod
    def of(cls, directions: ArrayF64) -> PlaceTables:
        return cls(basis(directions, 2).astype(np.float32), directions[:, 2].astype(np.float32))


@lru_cache(maxsize=16)
def place_tables(n_anchors: int) -> tuple[PlaceTables, ...]:
    """Of the anchors of `AnchorLattice(n_anchors)`, and of the cells of the three `LEVELS`."""
    grids = [ring_grid(n).directions for n in LEVELS]
    return tuple(PlaceTables.of(directions) for directions in (AnchorLattice(n_anchors).directions, *grids))


@lru_cache(maxsize=16)
def basis_products(n_anchors: int) -> ArrayF32:
    """(n, 81) of each two at each anchor: their sum over the set anchors is the matrix of the least squares."""
    table = basis(AnchorLattice(n_anchors).directions, 2)
    return (table[:, :, None] * table[:, None, :]).reshape(n_anchors, N_SH * N_SH).astype(np.float32)


@lru_cache(maxsize=16)
def pooling_table(n_anchors: int) -> PoolingTable:
    """From the anchors to the cells of the first of the `LEVELS`.

    An anchor belongs to the cell in which it lies; a cell without any takes the one nearest to its middle.
    """
    anchors, cells = AnchorLattice(n_anchors), ring_grid(LEVELS[0])
    owner = cells.cell_of(anchors.directions)
    nearest = anchors.nearest(cells.directions, "brute")
    rows = [np.flatnonzero(owner == i) for i in range(cells.n)]
    rows = [row if len(row) else nearest[i : i + 1] for i, row in enumerate(rows)]
    members = np.full((cells.n, max(map(len, rows))), n_anchors, np.intp)
    for i, row in enumerate(rows):
        members[i, : len(row)] = row
    return PoolingTable(members, np.array([len(row) for row in rows], np.float32))


SMALLEST_WEIGHT = 1e-12


@lru_cache(maxsize=4)
def pooling_matrix(n_fine: int, n_coarse: int) -> ArrayF32:
    """(n_fine, n_coarse) how much each cell counts for a coarser one: columns have a sum of 1.

    Cells overlap, so that the light changes little where a turn brings what was seen from one cell into the next: a
    Gaussian of the angle between their middles, as wide as the coarser cells. Below `SMALLEST_WEIGHT` of a sum it is 0:
    products with numbers that float32 holds only as denormal ones take thirty times as long.
    """
    angle = np.arccos(np.clip(ring_grid(n_fine).directions @ ring_grid(n_coarse).directions.T, -1, 1))
    weight = np.exp(-((angle / np.sqrt(4 / n_coarse)) ** 2))
    share = weight / weight.sum(axis=0)
    return np.where(share < SMALLEST_WEIGHT, 0, share).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SlotOrder:
    """The same pooling by adding blocks: each cell's first member, then the second of those that have one.

    Cells are ordered by falling number of members, so that each further block lies on the first so many.
    """

    cells: ArrayInt  # (n,) numbers of the cells in that order
    anchors: ArrayInt  # (m,) their numbers, block by block; more than all where one stands in for several
    lengths: tuple[int, ...]  # of the blocks
    counts: ArrayF32  # (n,) float32, members of each cell, at least 1
    is_first: ArrayF32  # (m,) float32, 1 but for an anchor that came before

    def sums(self, values: ArrayF32) -> ArrayF32:
        """Sums over each cell's members along the last axis, which holds the m anchors in order."""
        result = values[..., : self.lengths[0]].copy()
        start = self.lengths[0]
        for length in self.lengths[1:]:
            result[..., :length] += values[..., start : start + length]
            start += length
        return result


@lru_cache(maxsize=16)
def slot_order(n_anchors: int) -> SlotOrder:
    """`pooling_table` by blocks."""
    table = pooling_table(n_anchors)
    cells = np.argsort(-table.counts, kind="stable")
    slots = [slot[slot < n_anchors] for slot in table.members[cells].T]
    anchors = np.concatenate(slots)
    is_first = np.zeros(len(anchors), np.float32)
    is_first[np.unique(anchors, return_index=True)[1]] = 1
    return SlotOrder(cells, anchors, tuple(map(len, slots)), table.counts[cells], is_first)


@lru_cache(maxsize=1)
def quadrature_matrix() -> ArrayF32:
    """(9, n) float32: coefficients from radiance in the cells of the second of the `LEVELS`, by least squares.

    Exact for light of order 2, constant light included.
    """
    return np.linalg.pinv(basis(ring_grid(LEVELS[1]).directions, 2)).astype(np.float32)
