"""The free floor of a room, where a person with a phone can walk: as cells, and routes over it.

Found on the plan, not with rays: a table on legs leaves its floor open to a ray but not to a person. Chosen: cells of
10 cm, shortest routes over them, pulled smooth cell by cell; rejected: a navigation mesh, too much for one room.

Frames: world, metres. Whether the phone itself is clear of what hangs is the walk's to ask.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from xihe_blender.lab.rooms.arrange import FLAT_M
from xihe_blender.lab.rooms.outline import Rect
from xihe_blender.lab.rooms.room_data import Room
from xihenet.openings import joined
from xihenet.records import ArrayBool, ArrayF64, ArrayInt

Cell = tuple[int, int]
CELL_M = 0.1
HEAD_M = 1.9  # What is higher than this is no obstacle to a person, and under a lower ceiling nobody walks
FLOOR_LAMP_M = 0.45  # Across a floor lamp's shade, the widest part of it
N_SMOOTHINGS = 80
NEIGHBOURS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]


@dataclass(frozen=True, eq=False)
class FreeFloor:
    """Cells (rows along y, columns along x) of CELL_M from `corner_m`; `is_free` says where a person can stand."""

    corner_m: tuple[float, float]
    is_free: ArrayBool

    @classmethod
    def of(cls, room: Room, margin_m: float) -> FreeFloor:
        """The largest connected part of the floor that keeps `margin_m` from walls and from what stands on it."""
        bounds = room.outline.bounds
        n_columns, n_rows = (math.ceil(side / CELL_M) for side in (bounds.x1 - bounds.x0, bounds.y1 - bounds.y0))
        whole = cls((bounds.x0, bounds.y0), np.ones((n_rows, n_columns), bool))
        blocked = [rect.grown(margin_m) for rect in _standing(room)]
        free = [_is_walkable(room, (x, y), margin_m, blocked) for x, y in whole.places_m]
        return replace(whole, is_free=_largest_part(np.reshape(free, whole.is_free.shape)))

    @property
    def area_m2(self) -> float:
        return float(self.is_free.sum()) * CELL_M**2

    @property
    def places_m(self) -> ArrayF64:
        """(K, 2) middles of the free cells."""
        return self._middles(np.argwhere(self.is_free))

    def _middles(self, cells: ArrayInt) -> ArrayF64:
        return np.asarray(cells[:, ::-1] * CELL_M + np.array(self.corner_m) + CELL_M / 2)

    def cells(self, places_m: ArrayF64) -> ArrayInt:
        """(N, 2) row and column of places (N, 2), cut to what there is."""
        found = np.floor((places_m - np.array(self.corner_m)) / CELL_M)[:, ::-1].astype(int)
        return np.asarray(np.clip(found, 0, np.array(self.is_free.shape) - 1))

    def holds(self, places_m: ArrayF64) -> ArrayBool:
        """(N,) bool: which places (N, 2) lie in free cells."""
        return np.asarray(self.is_free[tuple(self.cells(places_m).T)])

    def without(self, places_m: ArrayF64, radius_m: float) -> FreeFloor:
        """The largest part that is left without what is nearer than `radius_m` to any of places (N, 2)."""
        every = self._middles(np.argwhere(np.ones_like(self.is_free)))
        gaps = np.linalg.norm(every[:, None] - places_m[None], axis=-1).min(axis=1)
        return replace(self, is_free=_largest_part(self.is_free & (gaps > radius_m).reshape(self.is_free.shape)))

    def route(self, stops_m: ArrayF64) -> Route:
        """A smooth way through places (N, 2) in free cells, in order; the ends are kept, the rest is cut short."""
        cells = [(int(row), int(column)) for row, column in self.cells(stops_m)]
        way = [cells[0]]
        for start, end in itertools.pairwise(cells):
            way += _shortest(self.is_free, start, end)[1:]
        return Route.through(self._smooth(self._middles(np.array(way))))

    def _smooth(self, places_m: ArrayF64) -> ArrayF64:
        """Pull each place towards the middle of its neighbours, as long as it stays on free floor."""
        places = places_m.copy()
        for _ in range(N_SMOOTHINGS if len(places) > 2 else 0):
            pulled = 0.5 * places[1:-1] + 0.25 * (places[:-2] + places[2:])
            places[1:-1] = np.where(self.holds(pulled)[:, None], pulled, places[1:-1])
        return places


@dataclass(frozen=True, eq=False)
class Route:
    """A way: places (N, 2) and the metres walked to each (N,)."""

    places_m: ArrayF64
    walked_m: ArrayF64

    @classmethod
    def through(cls, places_m: ArrayF64) -> Route:
        steps = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
        return cls(places_m, np.concatenate([[0.0], np.cumsum(steps)]))

    @property
    def length_m(self) -> float:
        return float(self.walked_m[-1])

    def at(self, walked_m: float) -> ArrayF64:
        """(2,) the place after so many metres; the ends beyond them."""
        return np.array([np.interp(walked_m, self.walked_m, self.places_m[:, axis]) for axis in (0, 1)])


def _standing(room: Room) -> list[Rect]:
    """What stands in a walker's way on the floor."""
    pieces = [piece.footprint for piece in room.pieces if piece.size[2] >= FLAT_M and piece.z < HEAD_M]
    lamps = [(lamp.x, lamp.y) for lamp in room.lamps if lamp.kind == "floor"]
    return pieces + [Rect.around(place, (FLOOR_LAMP_M, FLOOR_LAMP_M)) for place in lamps]


def _is_walkable(room: Room, place: tuple[float, float], margin_m: float, blocked: Sequence[Rect]) -> bool:
    around = Rect.around(place, (2 * margin_m, 2 * margin_m))
    is_blocked = any(rect.holds(place) for rect in blocked)
    return not is_blocked and room.outline.holds_rect(around) and room.ceiling_at(place) > HEAD_M


def _largest_part(is_free: ArrayBool) -> ArrayBool:
    """The largest set of free cells that touch at sides or corners; the first of equals."""
    n_free = np.count_nonzero(is_free)
    number = np.full(np.add(is_free.shape, 2), -1)  # With a rim, so that each cell has all neighbours.
    number[1:-1, 1:-1][is_free] = np.arange(n_free)
    beside = np.stack([np.roll(number, step, (0, 1))[1:-1, 1:-1][is_free] for step in NEIGHBOURS])
    near, cell = np.nonzero(beside >= 0)
    part = joined(n_free, np.stack([cell, beside[near, cell]]))
    kept = np.zeros_like(is_free)
    kept[is_free] = part == np.bincount(part, minlength=1).argmax()
    return kept


def _shortest(is_free: ArrayBool, start: Cell, end: Cell) -> list[Cell]:
    """The cells of a shortest way between two free cells of one part (Dijkstra), both ends included."""
    n_rows, n_columns = is_free.shape
    before: dict[Cell, Cell] = {}
    known = {start: 0.0}
    heap: list[tuple[float, Cell]] = [(0.0, start)]
    while heap:
        walked, cell = heapq.heappop(heap)
        if cell == end:
            break
        for dy, dx in NEIGHBOURS:
            row, column = cell[0] + dy, cell[1] + dx
            if not (0 <= row < n_rows and 0 <= column < n_columns and is_free[row, column]):
                continue
            so_far = walked + math.hypot(dy, dx)
            if so_far < known.get((row, column), math.inf):
                known[row, column], before[row, column] = so_far, cell
                heapq.heappush(heap, (so_far, (row, column)))
    way = [end]
    while way[-1] != start:
        way.append(before[way[-1]])
    return way[::-1]
