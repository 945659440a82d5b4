"""The shell of a room: floor, ceiling, walls with openings, windows, doors, skirting.

Walls have thickness and real openings, so that daylight enters as it does in a house: past a reveal and a frame. They
are put together from boxes around each opening instead of cut by Boolean modifiers, which are slow and fragile.
Windows carry no glass: clear glass costs Cycles its direct light and changes the picture by a few per cent.

Frames: a room's inside spans x in [-width/2, width/2], y in [-length/2, length/2], z in [0, height]. A wall is named
by the side it stands on: "+x", "-x", "+y", "-y". Along a wall, the position runs along +Y (x walls) or +X (y walls).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass

from xihe_blender.lab.props import Collection, Material
from xihe_blender.lab.props.shapes import Solid, add_solid, box_between, joined

Span = tuple[float, float]
SKIRTING_HEIGHT_M, SKIRTING_THICKNESS_M = 0.09, 0.015


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, in metres along the wall and above the floor; `is_door` leaves out the skirting there."""

    wall: str
    low: float
    high: float
    bottom: float
    top: float
    is_door: bool = False


class Walls(ABC):
    """Walls by name, with openings: `Room` here, other plans elsewhere."""

    height: float
    wall_m: float
    openings: tuple[Opening, ...]

    @abstractmethod
    def inner_ends(self, wall: str) -> Span:
        """From where to where the wall's inner face runs, along the wall."""

    @abstractmethod
    def outer_ends(self, wall: str) -> Span:
        """From where to where its masonry runs: past the inner face where it closes a corner."""

    @abstractmethod
    def wall_box(self, wall: str, along: Span, out: Span, up: Span) -> Solid:
        """A box on a wall: ranges along it, outwards from its inner face (negative is inside), and up."""


@dataclass(frozen=True)
class Room(Walls):
    """Inside measures in metres."""

    width: float
    length: float
    height: float
    wall_m: float = 0.25
    openings: tuple[Opening, ...] = ()

    def inner_ends(self, wall: str) -> Span:
        half = (self.length if wall[1] == "x" else self.width) / 2
        return -half, half

    def outer_ends(self, wall: str) -> Span:
        low, high = self.inner_ends(wall)
        extra = self.wall_m if wall[1] == "x" else 0.0
        return low - extra, high + extra

    def wall_box(self, wall: str, along: Span, out: Span, up: Span) -> Solid:
        sign = 1 if wall[0] == "+" else -1
        face = sign * (self.width if wall[1] == "x" else self.length) / 2
        across = sorted((face + sign * out[0], face + sign * out[1]))
        first, second = (across, along) if wall[1] == "x" else (along, across)
        return box_between((first[0], second[0], up[0]), (first[1], second[1], up[1]))


def add_shell(
    collection: Collection, room: Room, *, floor: Material, walls: dict[str, Material], ceiling: Material,
    trim: Material, handle: Material, n_casements: int = 2,
) -> None:  # fmt: skip
    """Floor slab, ceiling slab, the walls, and in `trim` their skirting, windows and doors."""
    half_x, half_y = room.width / 2 + room.wall_m, room.length / 2 + room.wall_m
    slab = box_between((-half_x, -half_y, -0.2), (half_x, half_y, 0.0))
    add_solid(collection, "Floor", slab, floor)
    lid = box_between((-half_x, -half_y, room.height), (half_x, half_y, room.height + 0.2))
    add_solid(collection, "Ceiling", lid, ceiling)
    for wall, material in walls.items():
        add_solid(collection, f"Wall {wall}", wall_solid(room, wall), material)
    add_skirting(collection, room, trim, walls)
    for opening in room.openings:
        if opening.is_door:
            add_door(collection, room, opening, trim, trim, handle)
        else:
            add_window(collection, room, opening, trim, trim, n_casements)


def wall_solid(room: Walls, wall: str) -> Solid:
    """One wall: full-height pieces between its openings, and the pieces under and over each of them."""
    edge, end = room.outer_ends(wall)
    out, pieces = (0.0, room.wall_m), []
    for hole in sorted((o for o in room.openings if o.wall == wall), key=lambda o: o.low):
        width = (hole.low, hole.high)
        pieces.append(room.wall_box(wall, (edge, hole.low), out, (0.0, room.height)))
        if hole.bottom > 0:
            pieces.append(room.wall_box(wall, width, out, (0.0, hole.bottom)))
        pieces.append(room.wall_box(wall, width, out, (hole.top, room.height)))
        edge = hole.high
    return joined([*pieces, room.wall_box(wall, (edge, end), out, (0.0, room.height))])


def add_skirting(collection: Collection, room: Walls, material: Material, walls: Iterable[str]) -> None:
    """Skirting boards along the walls, interrupted at doors."""
    boards, out, up = [], (-SKIRTING_THICKNESS_M, 0.0), (0.0, SKIRTING_HEIGHT_M)
    for wall in walls:
        edge, end = room.inner_ends(wall)
        for door in sorted((o for o in room.openings if o.wall == wall and o.is_door), key=lambda o: o.low):
            boards.append(room.wall_box(wall, (edge, door.low - 0.07), out, up))
            edge = door.high + 0.07
        boards.append(room.wall_box(wall, (edge, end), out, up))
    add_solid(collection, "Skirting", joined(boards), material, bevel_m=0.004)


def add_window(
    collection: Collection, room: Walls, opening: Opening, frame: Material, sill: Material, n_casements: int = 2
) -> None:
    """A frame with upright bars and one crossbar, set into the reveal, and an inner sill."""
    out = (0.1, 0.16)
    low, high, bottom, top = opening.low, opening.high, opening.bottom, opening.top
    heights = ((bottom, bottom + 0.06), (top - 0.06, top), (top - 0.5, top - 0.45))
    bars = [room.wall_box(opening.wall, (low, high), out, up) for up in heights]
    for i in range(n_casements + 1):
        middle = low + 0.03 + (high - low - 0.06) * i / n_casements
        bars.append(room.wall_box(opening.wall, (middle - 0.03, middle + 0.03), out, (bottom, top)))
    add_solid(collection, f"Window frame {opening.wall}", joined(bars), frame)
    ledge = room.wall_box(opening.wall, (low - 0.05, high + 0.05), (-0.12, 0.1), (bottom - 0.03, bottom))
    add_solid(collection, f"Window sill {opening.wall}", ledge, sill, bevel_m=0.006)


def add_door(
    collection: Collection, room: Walls, opening: Opening, leaf: Material, frame: Material, handle: Material
) -> None:
    """A closed door with two panels."""
    wall, low, high, top = opening.wall, opening.low, opening.high, opening.top
    slabs = [room.wall_box(wall, (low, high), (0.03, 0.07), (0.0, top))]
    for bottom_z, top_z in ((0.2, 0.95), (1.08, top - 0.2)):
        slabs.append(room.wall_box(wall, (low + 0.14, high - 0.14), (0.015, 0.04), (bottom_z, top_z)))
    add_solid(collection, f"Door {wall}", joined(slabs), leaf, bevel_m=0.008)
    posts = [room.wall_box(wall, (x - 0.07, x), (-0.015, 0.05), (0.0, top + 0.07)) for x in (low, high + 0.07)]
    lintel = room.wall_box(wall, (low, high), (-0.015, 0.05), (top, top + 0.07))
    add_solid(collection, f"Door frame {wall}", joined([*posts, lintel]), frame, bevel_m=0.004)
    grip = room.wall_box(wall, (high - 0.16, high - 0.04), (-0.04, -0.02), (1.02, 1.04))
    stem = room.wall_box(wall, (high - 0.06, high - 0.04), (-0.03, 0.03), (1.02, 1.04))
    add_solid(collection, f"Door handle {wall}", joined([grip, stem]), handle, bevel_m=0.005)
