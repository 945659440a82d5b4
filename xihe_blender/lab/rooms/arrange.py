"""Arrangement of furniture by trial: draw a place, keep it if nothing stands in the way.

What stands in the way: walls, other pieces, the space a door needs, a window behind something tall, a slanted ceiling.
Chosen over an optimiser, which makes every room tidy in the same way. A piece that finds no place is left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from xihe_blender.lab.rooms.draws import Rng, draw_point, one_of, piece_seed, span
from xihe_blender.lab.rooms.outline import Outline, Point, Rect
from xihe_blender.lab.rooms.room_data import Finish, Hole, Piece, Shell, Size

TRIES = 20
DOOR_REACH_M, GAP_M, WALL_GAP_M = 0.9, 0.03, 0.02
FLAT_M = 0.02  # Lower than this is a rug or a mat: other things stand on it


@dataclass(frozen=True)
class Floor(Shell):
    """A room being furnished. `pieces` grows; nothing else changes."""

    pieces: list[Piece] = field(default_factory=list)

    def add(self, piece: Piece, gap_m: float = GAP_M) -> Piece | None:
        """Keep `piece` if it fits; None if not."""
        if not self._is_free(piece, gap_m):
            return None
        self.pieces.append(piece)
        return piece

    def _is_free(self, piece: Piece, gap_m: float) -> bool:
        rect = piece.footprint
        if not self.outline.holds_rect(rect) or self.ceiling_over(rect) < piece.top_m + 0.04:
            return False
        if piece.size[2] < FLAT_M:
            return True
        return not (blocks_hole(piece, self._kept_free) or any(collide(piece, p, gap_m) for p in self.pieces))

    @cached_property
    def _kept_free(self) -> list[tuple[Rect, Hole]]:
        return zones(self.outline, self.holes)

    def against_wall(
        self, rng: Rng, kind: str, size: Size, finishes: tuple[Finish, ...], *, z: float = 0.0, tries: int = TRIES
    ) -> Piece | None:
        """A piece with its back to a wall, anywhere along it."""
        # As `rng.choice` with a share for each wall draws it, which works all of this out anew for each try.
        lengths = np.array([wall.length for wall in self.outline.walls])
        up_to = np.cumsum(lengths / lengths.sum())
        up_to /= up_to[-1]
        for _ in range(tries):
            wall = self.outline.walls[int(up_to.searchsorted(rng.random(), side="right"))]
            room = wall.length - size[0] - 0.06
            if room < 0:
                continue
            draw = one_of(rng, (0.0, 0.5, 1.0)) if rng.random() < 0.35 else float(rng.random())
            x, y = wall.point(0.03 + size[0] / 2 + draw * room, size[1] / 2 + WALL_GAP_M)
            if piece := self.add(Piece(kind, x, y, z, wall.turn_deg, size, finishes, piece_seed(rng))):
                return piece
        return None

    def anywhere(
        self, rng: Rng, kind: str, size: Size, finishes: tuple[Finish, ...], *, margin_m: float = 0.1,
        free_turn: bool = False, gap_m: float = 0.15,
    ) -> Piece | None:  # fmt: skip
        """A piece that stands free in the room."""
        bounds = self.outline.bounds.grown(-margin_m)
        for _ in range(TRIES):
            x, y = draw_point(rng, bounds)
            turn = span(rng, 0, 360) if free_turn else 90.0 * float(rng.integers(4))
            if piece := self.add(Piece(kind, x, y, 0.0, turn, size, finishes, piece_seed(rng)), gap_m):
                return piece
        return None

    def beside(
        self, rng: Rng, other: Piece, offset: Point, kind: str, size: Size, finishes: tuple[Finish, ...],
        *, turn_deg: float = 0.0,
    ) -> Piece | None:  # fmt: skip
        """A piece at an offset in another's own frame, turned relative to it."""
        x, y = local_point(other, offset)
        turn = (other.turn_deg + turn_deg) % 360
        return self.add(Piece(kind, x, y, 0.0, turn, size, finishes, piece_seed(rng)), 0.01)

    def on_top(
        self, rng: Rng, support: Piece, kind: str, size: Size, finishes: tuple[Finish, ...], *, free_turn: bool = True
    ) -> None:
        """A small thing on the flat top of another, away from its edge; nothing where it finds no place."""
        turn = span(rng, 0, 360) if free_turn else 0.0
        half = (math.hypot(*size[:2]) if free_turn else max(size[:2])) / 2
        across, along = (side / 2 - 0.03 for side in support.size[:2])
        if min(across, along) <= half:
            return
        for _ in range(6):
            offset = span(rng, -across + half, across - half), span(rng, -along + half, along - half)
            x, y = local_point(support, offset)
            turned = (support.turn_deg + turn) % 360
            if self.add(Piece(kind, x, y, support.top_m, turned, size, finishes, piece_seed(rng)), 0.01):
                return


def local_point(piece: Piece, offset: Point) -> Point:
    """A point given in the piece's own frame, in the room's."""
    c, s = math.cos(math.radians(piece.turn_deg)), math.sin(math.radians(piece.turn_deg))
    return piece.x + c * offset[0] - s * offset[1], piece.y + s * offset[0] + c * offset[1]


def collide(one: Piece, other: Piece, gap_m: float = 0.0) -> bool:
    """Whether two pieces' boxes overlap with less than `gap_m` between them sideways; flat ones never do."""
    if one.size[2] < FLAT_M or other.size[2] < FLAT_M:
        return False
    is_same_height = one.z < other.top_m - 1e-6 and other.z < one.top_m - 1e-6
    return is_same_height and one.footprint.overlaps(other.footprint, gap_m)


def zones(outline: Outline, holes: tuple[Hole, ...]) -> list[tuple[Rect, Hole]]:
    """What of the floor each hole needs."""
    reach_m = {True: DOOR_REACH_M, False: 0.3}
    rects = (outline.walls[h.wall].rect((h.low - 0.08, h.high + 0.08), (0.0, reach_m[h.is_door])) for h in holes)
    return list(zip(rects, holes, strict=True))


def blocks_hole(piece: Piece, kept_free: list[tuple[Rect, Hole]]) -> bool:
    """Whether a piece stands where a door opens, or before a window that begins below its top, among `zones`."""
    return any(
        piece.footprint.overlaps(zone) and piece.top_m > hole.bottom - 0.02 and piece.z < hole.top
        for zone, hole in kept_free
    )
