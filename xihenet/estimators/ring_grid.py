"""The ring grid: which cells become each other when a room is turned by an eighth, or mirrored left to right?

Cells of equal area in rings about the vertical, of 8, 16 or 32 cells each. The sixteen `TURNS`, eighths of a turn with
and without a mirror, move every cell onto another; a network that looks at a room in all of them with the same weights
gives a turned room the turned light, by construction. Sizes are nested: 320 cells lie in 80, four each, and these in
24. Rejected: HEALPix, whose rings near the poles know quarters of a turn alone; the Fibonacci lattice of the anchors,
which no turn brings onto itself.

Frame: the world's, +Z up.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayF64, ArrayInt
from xihenet.sh_basis import basis

N_TURNS = 16
# From the top: cells of each ring, and the heights of z between which it lies where these do not follow from the area.
_RINGS = {320: (16, 16, *(32,) * 8, 16, 16), 80: (8, 16, 16, 16, 16, 8), 24: (8, 8, 8)}
_EDGES = {24: (1.0, 0.4, -0.4, -1.0)}
SIZES = tuple(_RINGS)


class RingGrid:
    """The grid of `n` cells, one of `SIZES`; ValueError for another size."""

    def __init__(self, n: int) -> None:
        if n not in _RINGS:
            raise ValueError(f"ring grid: expected {', '.join(map(str, SIZES))} cells, got {n}")
        self.n = n
        self._in_ring = np.array(_RINGS[n])
        self._first = np.concatenate([[0], np.cumsum(self._in_ring)])
        self._edges = np.array(_EDGES.get(n, 1 - 2 * self._first / n))

    @cached_property
    def directions(self) -> ArrayF64:
        """(n, 3) unit vectors to the cells' middles, ring by ring from the top, anticlockwise from +X in each."""
        ring = np.repeat(np.arange(len(self._in_ring)), self._in_ring)
        azimuth = (np.arange(self.n) - self._first[ring] + 0.5) * 2 * np.pi / self._in_ring[ring]
        z = ((self._edges[1:] + self._edges[:-1]) / 2)[ring]
        return np.stack([np.sqrt(1 - z**2) * np.cos(azimuth), np.sqrt(1 - z**2) * np.sin(azimuth), z], axis=1)

    def cell_of(self, directions: ArrayLike) -> ArrayInt:
        """(P,) the cells in which unit vectors (P, 3) lie."""
        x, y, z = np.asarray(directions, np.float64).T
        ring = np.clip(np.searchsorted(-self._edges, -z, side="right") - 1, 0, len(self._in_ring) - 1)
        cells = self._in_ring[ring]
        along = np.floor(np.arctan2(y, x) / (2 * np.pi) % 1 * cells).astype(np.intp)
        return self._first[ring] + np.minimum(along, cells - 1)

    @cached_property
    def turned(self) -> ArrayInt:
        """(16, n) where each cell of a turned room was before the turn."""
        return np.stack([self.cell_of(self.directions @ turn) for turn in TURNS])

    @cached_property
    def turned_back(self) -> ArrayInt:
        """(16, n) where each cell of a room is after the turn."""
        return np.stack([self.cell_of(self.directions @ turn.T) for turn in TURNS])


def _turns() -> ArrayF64:
    angles = np.arange(8) * np.pi / 4
    c, s, o = np.cos(angles), np.sin(angles), np.zeros(8)
    about_vertical = np.array([[c, -s, o], [s, c, o], [o, o, o + 1]]).transpose(2, 0, 1)
    return np.concatenate([about_vertical, about_vertical @ np.diag([-1.0, 1.0, 1.0])])


TURNS = _turns()
"""(16, 3, 3): where each turn takes a direction, the mirrored ones last."""


@lru_cache(maxsize=1)
def turns_of_light() -> ArrayF64:
    """(16, 9, 9): each turn for coefficients of order 2."""
    directions = RingGrid(80).directions
    fit = np.linalg.pinv(basis(directions, 2))
    return np.stack([fit @ basis(directions @ turn, 2) for turn in TURNS])


@lru_cache(maxsize=len(SIZES))
def ring_grid(n: int) -> RingGrid:
    """The grid of that size, with its tables; ValueError for another size."""
    return RingGrid(n)
