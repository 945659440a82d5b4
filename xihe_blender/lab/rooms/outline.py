"""What is the floor plan of a room, and what lies inside it?

A plan is a polygon of axis-aligned walls that turns anticlockwise, so the inside is on the left of every wall: boxes,
L-shapes and alcoves are all the same thing. Rejected: free angles, which would need mitred walls and turned furniture
for little variety in the light. Slanted ceilings are wedges on top of the plan.

Frames: metres, +Z up. Along a wall the position runs from its start to its end; outwards is to its right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

Point = tuple[float, float]


@dataclass(frozen=True)
class Rect:
    """An axis-aligned rectangle on the floor."""

    x0: float
    y0: float
    x1: float
    y1: float

    @classmethod
    def around(cls, centre: Point, size: Point) -> Rect:
        """The rectangle of full extents `size` around `centre`."""
        (x, y), (w, d) = centre, size
        return cls(x - w / 2, y - d / 2, x + w / 2, y + d / 2)

    @property
    def centre(self) -> Point:
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    def grown(self, margin: float) -> Rect:
        """The same, larger by `margin` on each side."""
        return Rect(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def overlaps(self, other: Rect) -> bool:
        """Whether the two share more than an edge."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1


@dataclass(frozen=True)
class Wall:
    """One edge of the plan; `starts_convex` and `ends_convex` say whether the room's corner there is less than 180°."""

    start: Point
    end: Point
    starts_convex: bool
    ends_convex: bool

    @property
    def length(self) -> float:
        return abs(self.end[0] - self.start[0]) + abs(self.end[1] - self.start[1])

    @property
    def along(self) -> Point:
        """Unit vector from start to end."""
        n = self.length
        return (self.end[0] - self.start[0]) / n, (self.end[1] - self.start[1]) / n

    @property
    def outward(self) -> Point:
        """Unit vector out of the room."""
        x, y = self.along
        return y, -x

    @property
    def turn_deg(self) -> float:
        """Turn about +Z that puts a piece's back, +Y before the turn, to this wall."""
        x, y = self.outward
        return {(0, 1): 0.0, (-1, 0): 90.0, (0, -1): 180.0, (1, 0): 270.0}[round(x), round(y)]

    def point(self, along: float, inwards: float) -> Point:
        """A point at a distance along the wall and into the room."""
        (ax, ay), (ox, oy) = self.along, self.outward
        return self.start[0] + ax * along - ox * inwards, self.start[1] + ay * along - oy * inwards

    def rect(self, along: tuple[float, float], inwards: tuple[float, float]) -> Rect:
        """The rectangle between two distances along the wall and two into the room."""
        a, b = self.point(along[0], inwards[0]), self.point(along[1], inwards[1])
        return Rect(min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1]))


@dataclass(frozen=True)
class Outline:
    """A floor plan; corners anticlockwise, each wall along x or y. ValueError for anything else."""

    corners: tuple[Point, ...]

    def __post_init__(self) -> None:
        n = len(self.corners)
        steps = [
            (b[0] - a[0], b[1] - a[1]) for a, b in zip(self.corners, self.corners[1:] + self.corners[:1], strict=True)
        ]
        if n < 4 or any((dx == 0) == (dy == 0) for dx, dy in steps):
            raise ValueError(f"Outline: expected four or more walls along x or y, got the corners {self.corners}")
        if self.area <= 0:
            raise ValueError("Outline: expected corners in anticlockwise order, got clockwise")

    @property
    def area(self) -> float:
        """Square metres; negative for a clockwise order."""
        pairs = zip(self.corners, self.corners[1:] + self.corners[:1], strict=True)
        return sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs) / 2

    @cached_property
    def walls(self) -> tuple[Wall, ...]:
        n, c = len(self.corners), self.corners
        return tuple(Wall(c[i], c[(i + 1) % n], self._is_convex(i), self._is_convex((i + 1) % n)) for i in range(n))

    def _is_convex(self, i: int) -> bool:
        a, b, c = self.corners[i - 1], self.corners[i], self.corners[(i + 1) % len(self.corners)]
        return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) > 0

    @property
    def bounds(self) -> Rect:
        """The smallest rectangle that holds the plan."""
        xs, ys = zip(*self.corners, strict=True)
        return Rect(min(xs), min(ys), max(xs), max(ys))

    def holds(self, point: Point) -> bool:
        """Whether a point lies inside (by the parity of walls crossed towards +x)."""
        x, y = point
        crossings = 0
        for wall in self.walls:
            (x0, y0), (_, y1) = wall.start, wall.end
            crossings += (y0 > y) != (y1 > y) and x0 > x
        return crossings % 2 == 1

    def holds_rect(self, rect: Rect) -> bool:
        """Whether a rectangle lies inside as a whole: its middle does, and no wall passes through it."""
        return self.holds(rect.centre) and not any(_passes_through(wall, rect) for wall in self.walls)


def _passes_through(wall: Wall, rect: Rect) -> bool:
    """Whether a wall's edge runs through the inside of a rectangle."""
    xs, ys = sorted((wall.start[0], wall.end[0])), sorted((wall.start[1], wall.end[1]))
    return xs[0] < rect.x1 and xs[1] > rect.x0 and ys[0] < rect.y1 and ys[1] > rect.y0


def box_plan(width: float, length: float) -> Outline:
    """A rectangle around the origin."""
    x, y = width / 2, length / 2
    return Outline(((-x, -y), (x, -y), (x, y), (-x, y)))


def l_plan(width: float, length: float, cut: Point) -> Outline:
    """A rectangle whose corner at +x, +y is cut out by `cut` metres along x and y."""
    x, y = width / 2, length / 2
    return Outline(((-x, -y), (x, -y), (x, y - cut[1]), (x - cut[0], y - cut[1]), (x - cut[0], y), (-x, y)))


def alcove_plan(width: float, length: float, span: tuple[float, float], reach: float) -> Outline:
    """A rectangle with an alcove in its +y wall: between two x, `reach` metres out."""
    x, y = width / 2, length / 2
    low, high = span
    return Outline(((-x, -y), (x, -y), (x, y), (high, y), (high, y + reach), (low, y + reach), (low, y), (-x, y)))


def turned(outline: Outline, quarters: int) -> Outline:
    """The plan turned anticlockwise by quarter turns, so that no direction is favoured."""
    corners: Sequence[Point] = outline.corners
    for _ in range(quarters % 4):
        corners = [(-y, x) for x, y in corners]
    return Outline(tuple(corners))
