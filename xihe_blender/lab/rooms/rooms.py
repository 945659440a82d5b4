"""Rooms, drawn by `sample_room` from a generator: the same seed gives the same room.

Chosen: rules for plan, furniture, materials and light that are drawn independently where they can be, because what a
network lacks is distinct rooms. Rejected: a few hand-made rooms with jitter, which a network learns by heart.
An opening that does not fit is drawn again a few times and then left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xihe_blender.lab.rooms import palette
from xihe_blender.lab.rooms.arrange import Floor
from xihe_blender.lab.rooms.draws import Rng, span
from xihe_blender.lab.rooms.furnishing import furnish
from xihe_blender.lab.rooms.light_plan import DARK, REGIMES, sample_daylight, sample_lamps, sample_regime
from xihe_blender.lab.rooms.outline import Outline, Point, alcove_plan, box_plan, l_plan, turned
from xihe_blender.lab.rooms.room_data import Hole, Room, Shell, Slope
from xihenet.training.rooms import split_of

KINDS = {
    "living": (0.25, 3.2, 7.5), "bedroom": (0.18, 2.8, 5.0), "dining": (0.12, 3.0, 6.0), "study": (0.1, 2.4, 4.5),
    "kitchen": (0.12, 2.4, 5.0), "bathroom": (0.07, 2.0, 3.4), "office": (0.09, 3.5, 8.0), "hall": (0.07, 2.0, 6.0),
}  # fmt: skip
"""Of each kind its share of the rooms, and the least and the largest width and length."""

VARIED, BY_DAY = 2, 3
"""Keys of rooms that are varied, and of those that have no light but what comes through their windows."""

CORNER_M, DOOR_TOP_M = 0.12, 2.02
EXPOSURE_GAIN, EXPOSURE_SPREAD = 1.35, 0.12
"""Median of what a phone gives more light than our metering, which takes the low end of the meters' range, and the
standard deviation of its log."""


def room_generator(seed: int, index: int) -> Rng:
    """The generator of room `index` of a data set: rooms do not depend on how many there are or who makes them."""
    return np.random.default_rng(np.random.SeedSequence([seed, index]))


def walk_generator(seed: int, index: int) -> Rng:
    """A child of the room's generator for the walk through it, so that the room is the same with and without."""
    return np.random.default_rng(np.random.SeedSequence([seed, index], spawn_key=(1,)))


def is_chosen(seed: int, index: int, share: float, key: int) -> bool:
    """Whether a room is one of the `share` of that `key`, of the training rooms alone; a larger share adds some."""
    draw = np.random.default_rng(np.random.SeedSequence([seed, index], spawn_key=(key,))).random()
    return split_of((seed, index)) == "train" and bool(draw < share)


def sample_room(rng: Rng, *, by_day: bool = False) -> Room:
    """A room of a home or an office; `by_day` has its lamps off and no dark hour, if it has windows."""
    kind = str(rng.choice(list(KINDS), p=[share for share, _, _ in KINDS.values()]))
    shell = sample_shell(rng, kind)
    floor = Floor(**vars(shell))
    furnish(rng, floor, kind)
    regime_name = sample_regime(rng, has_window=bool(shell.windows))
    by_day = by_day and bool(shell.windows)
    if by_day and regime_name in DARK:
        regime_name = "mixed"
    regime = REGIMES[regime_name]
    daylight = sample_daylight(rng, floor, regime, by_day=by_day)
    glass_share = sum((w.high - w.low) * (w.top - w.bottom) for w in shell.windows) / shell.outline.area
    sky = float(np.sqrt(regime.sky[0] * regime.sky[1]))
    lamps = sample_lamps(rng, floor, kind, regime, sky * glass_share * 6.0)
    if by_day:
        lamps = tuple(replace(lamp, watts=0.0) for lamp in lamps)
    return Room(
        **vars(shell),
        kind=kind,
        regime=regime_name,
        pieces=tuple(floor.pieces),
        lamps=lamps,
        daylight=daylight,
        floor=palette.floor_finish(rng, kind),
        walls=palette.wall_finishes(rng, kind, len(shell.outline.walls)),
        ceiling=palette.ceiling_finish(rng),
        trim=palette.trim_finish(rng),
        exposure_gain=sample_exposure_gain(rng),
    )


def sample_exposure_gain(rng: Rng) -> float:
    return float(EXPOSURE_GAIN * np.exp(rng.normal(0.0, EXPOSURE_SPREAD)))


def sample_shell(rng: Rng, kind: str) -> Shell:
    """Plan and height, then slopes, then openings."""
    _, least, largest = KINDS[kind]
    outline = sample_outline(rng, (least, least), (largest, largest))
    is_tall = rng.random() < 0.15
    height = span(rng, 2.8, 3.6) if is_tall else span(rng, 2.25, 2.8)
    bare = Shell(outline, height, sample_slopes(rng, outline), ())
    return replace(bare, holes=sample_holes(rng, bare, int(rng.choice(6, p=[0.05, 0.35, 0.3, 0.17, 0.09, 0.04]))))


def sample_outline(rng: Rng, least: Point, largest: Point) -> Outline:
    """A box (half of the rooms), an L or a room with an alcove, turned at random; metres before the turn."""
    width, length = (float(v) for v in rng.uniform(least, largest))
    draw = rng.random()
    if draw < 0.25 and min(width, length) > 3.2:
        cut = span(rng, 0.25, 0.5) * width, span(rng, 0.25, 0.5) * length
        plan = l_plan(width, length, cut)
    elif draw < 0.5 and width > 2.6:
        low, high = sorted(float(v) for v in rng.uniform(-width / 2 + 0.2, width / 2 - 0.2, 2))
        middle = (low + high) / 2
        half = min(max(0.5, (high - low) / 2), width / 2 - 0.2)
        middle = float(np.clip(middle, -width / 2 + 0.15 + half, width / 2 - 0.15 - half))
        plan = alcove_plan(width, length, (middle - half, middle + half), span(rng, 0.4, 1.4))
    else:
        plan = box_plan(width, length)
    return turned(plan, int(rng.integers(4)))


def sample_slopes(rng: Rng, outline: Outline) -> tuple[Slope, ...]:
    """None for most rooms; one slope or a gable of two for some boxes."""
    if len(outline.corners) != 4 or rng.random() > 0.3:
        return ()
    first = int(rng.integers(4))
    across = outline.walls[(first + 1) % 4].length
    knee = span(rng, 0.8, 1.7)
    if rng.random() < 0.35:
        reach = across * span(rng, 0.35, 0.5)
        return Slope(first, knee, reach), Slope((first + 2) % 4, knee, reach)
    return (Slope(first, knee, across * span(rng, 0.3, 0.9)),)


def sample_holes(rng: Rng, bare: Shell, n_windows: int) -> tuple[Hole, ...]:
    """One door, and up to `n_windows` windows."""
    holes: list[Hole] = []
    walls, sloped = bare.outline.walls, {slope.wall for slope in bare.slopes}
    favourite = int(rng.integers(len(walls)))
    for i in range(1 + n_windows):
        for _ in range(12):
            same_wall = i > 1 and rng.random() < 0.5
            wall = favourite if same_wall else int(rng.integers(len(walls)))
            room = walls[wall].length - 2 * CORNER_M
            hole = _door(rng, wall, room) if i == 0 else _window(rng, wall, room, bare.height)
            if hole is not None and wall not in sloped and _fits(hole, holes, bare):
                holes.append(hole)
                favourite = wall if i == 1 else favourite
                break
    return tuple(holes)


def _door(rng: Rng, wall: int, room: float) -> Hole | None:
    """Within the `room` that a wall has along it."""
    width = span(rng, 0.75, 0.95)
    if room < width:
        return None
    low = CORNER_M + span(rng, 0, room - width)
    return Hole(wall, low, low + width, 0.0, DOOR_TOP_M, is_door=True)


def _window(rng: Rng, wall: int, room: float, height: float) -> Hole | None:
    width = min(float(rng.choice([0.6, 0.9, 1.2, 1.6, 2.2, 3.2])) * span(rng, 0.85, 1.2), room)
    if width < 0.5:
        return None
    low = CORNER_M + span(rng, 0, room - width)
    bottom = 0.05 if rng.random() < 0.18 else span(rng, 0.5, 1.15)
    top = min(height - 0.15, bottom + 2.3, max(bottom + 0.75, span(rng, 1.9, 2.6)))
    covering = str(rng.choice(["none", "curtains", "sheer", "blind"], p=[0.5, 0.25, 0.12, 0.13]))
    return Hole(wall, low, low + width, bottom, top, False, covering, max(1, round(width / 0.75)))


def _fits(hole: Hole, others: list[Hole], bare: Shell) -> bool:
    """Whether a hole keeps clear of the others on its wall and stays below the ceiling."""
    wall = bare.outline.walls[hole.wall]
    if any(o.wall == hole.wall and o.low < hole.high + 0.25 and hole.low < o.high + 0.25 for o in others):
        return False
    ends = (wall.point(hole.low, 0.0), wall.point(hole.high, 0.0))
    return hole.top > hole.bottom + 0.4 and min(map(bare.ceiling_at, ends)) > hole.top + 0.12
