"""A room before Blender sees it: a tree of frozen records, numbers and names, nothing else.

A room as data can be sampled by the hundred thousand, checked without rendering, and compared. Frames: metres, +Z up;
a piece's front looks towards -Y before its turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from xihe_blender.lab.rooms.outline import Outline, Point, Rect

LAMP_KINDS = {"floor_lamp": "floor", "table_lamp": "table"}
"""Of pieces that only keep the place of a lamp: the lamp's kind."""

Size = tuple[float, float, float]
Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Finish:
    """What a surface looks like: a kind of material, two colours (linear Rec.709), a roughness and a scale."""

    kind: str
    colour: Colour
    second: Colour = (0.5, 0.5, 0.5)
    roughness: float = 0.5
    scale: float = 1.0


@dataclass(frozen=True)
class Hole:
    """An opening in a wall: metres along the wall (by its number) and above the floor. `covering`: curtain or none."""

    wall: int
    low: float
    high: float
    bottom: float
    top: float
    is_door: bool = False
    covering: str = "none"
    n_casements: int = 2


@dataclass(frozen=True)
class Slope:
    """A slanted ceiling: `knee_m` high at the wall, rising to the full height `reach_m` into the room."""

    wall: int
    knee_m: float
    reach_m: float


@dataclass(frozen=True)
class Piece:
    """A thing: its kind, the middle of its underside, its turn, its full extents before the turn, its own seed."""

    kind: str
    x: float
    y: float
    z: float
    turn_deg: float
    size: Size
    finishes: tuple[Finish, ...]
    seed: int

    @cached_property
    def footprint(self) -> Rect:
        """The axis-aligned rectangle that it covers on the floor."""
        c, s = abs(math.cos(math.radians(self.turn_deg))), abs(math.sin(math.radians(self.turn_deg)))
        w, d, _ = self.size
        return Rect.around((self.x, self.y), (w * c + d * s, w * s + d * c))

    @cached_property
    def top_m(self) -> float:
        return self.z + self.size[2]


@dataclass(frozen=True)
class Lamp:
    """A lamp: kind (a key of `LAMP_MAKERS`), place of its foot or fixing, size, colour, power, seen by cameras or not.

    `size_m` is the height of a lamp that stands, the drop of one that hangs, and else the width or radius of its light.
    """

    kind: str
    x: float
    y: float
    z: float
    size_m: float
    kelvin: float
    watts: float
    is_visible: bool = False


@dataclass(frozen=True)
class Sun:
    """Where the sun stands (azimuth anticlockwise from +X), its irradiance (W/m²) and its colour."""

    azimuth_deg: float
    elevation_deg: float
    irradiance: float
    tint: Colour

    @property
    def towards(self) -> tuple[float, float, float]:
        """Unit vector from anywhere to the sun."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        across = math.cos(elevation)
        return across * math.cos(azimuth), across * math.sin(azimuth), math.sin(elevation)


@dataclass(frozen=True)
class Daylight:
    """The panorama behind the windows, turned and scaled, and the sun."""

    panorama: str
    turn_deg: float
    strength: float
    sun: Sun | None


@dataclass(frozen=True)
class Shell:
    """A room with nothing in it."""

    outline: Outline
    height: float
    slopes: tuple[Slope, ...]
    holes: tuple[Hole, ...]

    @property
    def windows(self) -> list[Hole]:
        return [hole for hole in self.holes if not hole.is_door]

    def ceiling_at(self, point: Point) -> float:
        """Metres from the floor to the ceiling over a point, slopes included."""
        lowest = self.height
        for slope in self.slopes:
            wall = self.outline.walls[slope.wall]
            (ox, oy), (sx, sy) = wall.outward, wall.start
            inwards = -((point[0] - sx) * ox + (point[1] - sy) * oy)
            if inwards < slope.reach_m:
                lowest = min(lowest, slope.knee_m + (self.height - slope.knee_m) * max(inwards, 0.0) / slope.reach_m)
        return lowest

    def ceiling_over(self, rect: Rect) -> float:
        """The lowest ceiling over a rectangle: slopes fall towards walls, so it is over a corner."""
        return min(self.ceiling_at(corner) for corner in rect.corners)


@dataclass(frozen=True)
class Room(Shell):
    """All that a room is made of. `exposure_gain` is the phone's error in metering."""

    kind: str
    regime: str
    pieces: tuple[Piece, ...]
    lamps: tuple[Lamp, ...]
    daylight: Daylight
    floor: Finish
    walls: tuple[Finish, ...]
    ceiling: Finish
    trim: Finish
    exposure_gain: float
