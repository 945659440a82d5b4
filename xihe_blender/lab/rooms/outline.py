"""The outline of a room: what is its floor plan, and what lies inside it?

A plan is a polygon of axis-aligned walls that turns anticlockwise, so the inside is on the left of every wall: boxes,
L-shapes and alcoves are all the same thing. Rejected: free angles, which would need mitred walls and turned furniture
for little variety in the light. Slanted ceilings are wedges on top of the plan.

Frames: metres, +Z up. Along a wall the position runs from its start to its end; outwards is to its right.
"""

from __future__ import annotations

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

    @classmethod
    def between(cls, one: Point, other: Point) -> Rect:
        """The rectangle with two points at opposite corners."""
        return cls(*map(min, one, other), *map(max, one, other))

    @property
    def centre(self) -> Point:
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    @property
    def corners(self) -> list[Point]:
        return [(x, y) for x in (self.x0, self.x1) for y in (self.y0, self.y1)]

    def holds(self, point: Point) -> bool:
        """Whether a point lies inside, and not on an edge."""
        return self.x0 < point[0] < self.x1 and self.y0 < point[1] < self.y1

    def grown(self, margin: float) -> Rect:
        return Rect(self.x0 - margin, self.y0 - margin, self.x1 + margin, self.y1 + margin)

    def overlaps(self, other: Rect, gap_m: float = 0.0) -> bool:
        """Whether the two share more than an edge, or are less than `gap_m` apart along both axes."""
        return (
            self.x0 - gap_m < other.x1
            and other.x0 < self.x1 + gap_m
            and self.y0 - gap_m < other.y1
            and other.y0 < self.y1 + gap_m
        )


@dataclass(frozen=True)
class Wall:
    """One edge of the plan; `starts_convex` and `ends_convex` say whether the room's corner there is less than 180°."""

    start: Point
    end: Point
    starts_convex: bool
    ends_convex: bool

    @cached_property
    def length(self) -> float:
        return abs(self.end[0] - self.start[0]) + abs(self.end[1] - self.start[1])

    @cached_property
    def along(self) -> Point:
        """Unit vector from start to end."""
        n = self.length
        return (self.end[0] - self.start[0]) / n, (self.end[1] - self.start[1]) / n

    @cached_property
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

    def rect(self, along: Point, inwards: Point) -> Rect:
        """The rectangle between two distances along the wall and two into the room."""
        return Rect.between(self.point(along[0], inwards[0]), self.point(along[1], inwards[1]))


@dataclass(frozen=True)
class Outline:
    """A floor plan; corners anticlockwise, each wall along x or y. ValueError for anything else."""

    corners: tuple[Point, ...]

    def __post_init__(self) -> None:
        if len(self.corners) < 4 or any((a[0] == b[0]) == (a[1] == b[1]) for a, b in self._edges):
            raise ValueError(f"Outline: expected four or more walls along x or y, got the corners {self.corners}")
        if self.area <= 0:
            raise ValueError("Outline: expected corners in anticlockwise order, got clockwise")

    @cached_property
    def _edges(self) -> list[tuple[Point, Point]]:
        return list(zip(self.corners, self.corners[1:] + self.corners[:1], strict=True))

    @cached_property
    def _flat_edges(self) -> list[Rect]:
        return [Rect.between(*edge) for edge in self._edges]

    @property
    def area(self) -> float:
        """Square metres; negative for a clockwise order."""
        return sum(a[0] * b[1] - b[0] * a[1] for a, b in self._edges) / 2

    @cached_property
    def walls(self) -> tuple[Wall, ...]:
        convex = [self._is_convex(i) for i in range(len(self._edges))]
        return tuple(Wall(*edge, convex[i - 1], convex[i]) for i, edge in enumerate(self._edges))

    def _is_convex(self, i: int) -> bool:
        """At the end of edge `i`."""
        (a, b), (_, c) = self._edges[i], self._edges[(i + 1) % len(self._edges)]
        return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) > 0

    @property
    def bounds(self) -> Rect:
        """The smallest rectangle that holds the plan."""
        xs, ys = zip(*self.corners, strict=True)
        return Rect(min(xs), min(ys), max(xs), max(ys))

    def holds(self, point: Point) -> bool:
        """Whether a point lies inside (by the parity of walls crossed towards +x)."""
        x, y = point
        return sum((y0 > y) != (y1 > y) and x0 > x for (x0, y0), (_, y1) in self._edges) % 2 == 1

    def holds_rect(self, rect: Rect) -> bool:
        """Whether a rectangle lies inside as a whole: its middle does, and no wall passes through it."""
        return self.holds(rect.centre) and not any(edge.overlaps(rect) for edge in self._flat_edges)


def box_plan(width: float, length: float) -> Outline:
    """A rectangle around the origin."""
    x, y = width / 2, length / 2
    return Outline(((-x, -y), (x, -y), (x, y), (-x, y)))


def l_plan(width: float, length: float, cut: Point) -> Outline:
    """A rectangle whose corner at +x, +y is cut out by `cut` metres along x and y."""
    x, y = width / 2, length / 2
    return Outline(((-x, -y), (x, -y), (x, y - cut[1]), (x - cut[0], y - cut[1]), (x - cut[0], y), (-x, y)))


def alcove_plan(width: float, length: float, span: Point, reach: float) -> Outline:
    """A rectangle with an alcove in its +y wall: between two x, `reach` metres out."""
    x, y = width / 2, length / 2
    low, high = span
    return Outline(((-x, -y), (x, -y), (x, y), (high, y), (high, y + reach), (low, y + reach), (low, y), (-x, y)))


def turned(outline: Outline, quarters: int) -> Outline:
    """The plan turned anticlockwise by quarter turns, so that no direction is favoured."""
    corners = outline.corners
    for _ in range(quarters % 4):
        corners = tuple((-y, x) for x, y in corners)
    return Outline(corners)
