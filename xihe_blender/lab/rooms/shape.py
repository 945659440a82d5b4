"""What form does a room have: its plan, height, slanted ceilings, door and windows?

Sampled by rejection: an opening that does not fit is drawn again a few times and then left out.
"""

from __future__ import annotations

import numpy as np

from xihe_blender.lab.rooms.outline import Outline, alcove_plan, box_plan, l_plan, turned
from xihe_blender.lab.rooms.room_data import Hole, Slope, ceiling_height

Rng = np.random.Generator
KIND_SIZES = {
    "living": (3.2, 7.5), "bedroom": (2.8, 5.0), "dining": (3.0, 6.0), "study": (2.4, 4.5),
    "kitchen": (2.4, 5.0), "bathroom": (2.0, 3.4), "office": (3.5, 8.0), "hall": (2.0, 6.0),
}  # fmt: skip
CORNER_M, DOOR_TOP_M = 0.12, 2.02


def sample_outline(rng: Rng, kind: str) -> Outline:
    """A box (half of the rooms), an L or a room with an alcove, turned at random."""
    low, high = KIND_SIZES[kind]
    width, length = (float(v) for v in rng.uniform(low, high, 2))
    draw = rng.random()
    if draw < 0.25 and min(width, length) > 3.2:
        cut = float(rng.uniform(0.25, 0.5)) * width, float(rng.uniform(0.25, 0.5)) * length
        plan = l_plan(width, length, cut)
    elif draw < 0.5 and width > 2.6:
        span = sorted(float(v) for v in rng.uniform(-width / 2 + 0.2, width / 2 - 0.2, 2))
        middle = (span[0] + span[1]) / 2
        half = min(max(0.5, (span[1] - span[0]) / 2), width / 2 - 0.2)
        middle = float(np.clip(middle, -width / 2 + 0.15 + half, width / 2 - 0.15 - half))
        plan = alcove_plan(width, length, (middle - half, middle + half), float(rng.uniform(0.4, 1.4)))
    else:
        plan = box_plan(width, length)
    return turned(plan, int(rng.integers(4)))


def sample_slopes(rng: Rng, outline: Outline, height: float) -> tuple[Slope, ...]:
    """None for most rooms; one slope or a gable of two for some boxes."""
    if len(outline.corners) != 4 or rng.random() > 0.3:
        return ()
    first = int(rng.integers(4))
    across = outline.walls[(first + 1) % 4].length
    knee = float(rng.uniform(0.8, 1.7))
    if rng.random() < 0.35:
        reach = across * float(rng.uniform(0.35, 0.5))
        return Slope(first, knee, reach), Slope((first + 2) % 4, knee, reach)
    return (Slope(first, knee, across * float(rng.uniform(0.3, 0.9))),)


def sample_holes(rng: Rng, outline: Outline, height: float, slopes: tuple[Slope, ...]) -> tuple[Hole, ...]:
    """One door, and none to five windows (none is rare)."""
    holes: list[Hole] = []
    sloped = {slope.wall for slope in slopes}
    n_windows = int(rng.choice(6, p=[0.05, 0.35, 0.3, 0.17, 0.09, 0.04]))
    favourite = int(rng.integers(len(outline.walls)))
    for i in range(1 + n_windows):
        for _ in range(12):
            same_wall = i > 1 and rng.random() < 0.5
            wall = favourite if same_wall else int(rng.integers(len(outline.walls)))
            hole = _door(rng, outline, wall) if i == 0 else _window(rng, outline, wall, height)
            if hole is not None and wall not in sloped and _fits(hole, holes, outline, height, slopes):
                holes.append(hole)
                favourite = wall if i == 1 else favourite
                break
    return tuple(holes)


def _door(rng: Rng, outline: Outline, wall: int) -> Hole | None:
    width, room = float(rng.uniform(0.75, 0.95)), outline.walls[wall].length - 2 * CORNER_M
    if room < width:
        return None
    low = CORNER_M + float(rng.uniform(0, room - width))
    return Hole(wall, low, low + width, 0.0, DOOR_TOP_M, is_door=True)


def _window(rng: Rng, outline: Outline, wall: int, height: float) -> Hole | None:
    room = outline.walls[wall].length - 2 * CORNER_M
    width = min(float(rng.choice([0.6, 0.9, 1.2, 1.6, 2.2, 3.2])) * float(rng.uniform(0.85, 1.2)), room)
    if width < 0.5:
        return None
    low = CORNER_M + float(rng.uniform(0, room - width))
    bottom = 0.05 if rng.random() < 0.18 else float(rng.uniform(0.5, 1.15))
    top = min(height - 0.15, bottom + 2.3, max(bottom + 0.75, float(rng.uniform(1.9, 2.6))))
    covering = str(rng.choice(["none", "curtains", "sheer", "blind"], p=[0.5, 0.25, 0.12, 0.13]))
    return Hole(wall, low, low + width, bottom, top, False, covering, max(1, round(width / 0.75)))


def _fits(hole: Hole, others: list[Hole], outline: Outline, height: float, slopes: tuple[Slope, ...]) -> bool:
    """Whether a hole keeps clear of the others on its wall and stays below the ceiling."""
    wall = outline.walls[hole.wall]
    if any(o.wall == hole.wall and o.low < hole.high + 0.25 and hole.low < o.high + 0.25 for o in others):
        return False
    ends = (wall.point(hole.low, 0.0), wall.point(hole.high, 0.0))
    return hole.top > hole.bottom + 0.4 and all(
        ceiling_height(outline, height, slopes, end) > hole.top + 0.12 for end in ends
    )
