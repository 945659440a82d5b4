"""Rooms far more varied than homes and offices: for training alone, so that a network relies on nothing they share.

A varied room has the size of a closet or of a hall, the furniture of one to three kinds of rooms, up to a hundred
pieces of clutter, any colour or pattern on any surface, up to thirty lamps of any strength, or windows and no lamp.
Chosen over more rooms of the same kind: four times as many of those changed nothing in rooms made by others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xihe_blender.lab.rooms import palette
from xihe_blender.lab.rooms.arrange import Floor
from xihe_blender.lab.rooms.draws import Rng, log_span, one_of, span
from xihe_blender.lab.rooms.furnishing import FURNITURE, MIRROR_GLASS, SUPPORTS, furnish
from xihe_blender.lab.rooms.light_plan import Regime, draw_place, sample_daylight, sample_lamps
from xihe_blender.lab.rooms.outline import Point
from xihe_blender.lab.rooms.room_data import Colour, Finish, Lamp, Piece, Room, Shell
from xihe_blender.lab.rooms.rooms import sample_exposure_gain, sample_holes, sample_outline, sample_slopes

SIZES: dict[str, tuple[Point, Point, Point]] = {
    "closet": ((1.8, 2.0), (2.8, 3.2), (2.1, 2.8)),
    "corridor": ((1.4, 6.0), (2.4, 14.0), (2.2, 3.2)),
    "flat": ((3.0, 3.0), (7.0, 8.0), (2.3, 3.0)),
    "open plan": ((6.0, 8.0), (11.0, 16.0), (2.4, 3.6)),
    "great hall": ((8.0, 10.0), (14.0, 18.0), (3.6, 7.0)),
}
"""Least width and length, largest width and length, least and largest height, in metres."""

PANORAMAS = ("city", "courtyard", "forest", "sunset", "sunrise", "night")
COVERINGS = ("none", "none", "curtains", "sheer", "blind", "slats")
CLUTTER = ("box", "box", "crate", "ball", "vase", "bowl", "book_pile", "pouf", "plant", "post", "partition", "stairs")
PATTERNS = (
    "paint", "plain", "patches", "patches", "wood", "planks", "tiles", "wall tiles", "brick", "fabric", "metal",
)  # fmt: skip
TONES = {"white": (0.55, 0.85), "dark": (0.02, 0.15), "any": (0.02, 0.85)}
"""Darkest and brightest mean reflectance of what is painted anew in a room."""

SOFT_SHARE = 0.4
"""Of the rooms, lit by what is large and dim alone. In nearly all others something is many times brighter than white,
so that a network guesses a lamp where it has seen none, and is far too bright where there is none."""

SOFT_EXPOSURE = (0.4, 1.0)
"""Of such a room, relative to what the phone would choose."""

GLASS = Finish("glass", (0.9, 0.95, 0.92), roughness=0.02)


def sample_varied_room(rng: Rng) -> Room:
    kind = str(rng.choice(list(SIZES)))
    shell = _sample_shell(rng, kind)
    floor, tones = Floor(**vars(shell)), TONES[str(rng.choice(list(TONES), p=[0.25, 0.15, 0.6]))]
    for furnished_as in rng.choice(list(FURNITURE), int(rng.integers(1, 4)), replace=False).tolist():
        furnish(rng, floor, furnished_as)
    add_clutter(rng, floor, tones)
    is_soft = rng.random() < SOFT_SHARE
    regime = _soft_regime(rng) if is_soft else _sample_regime(rng, has_window=bool(shell.windows))
    daylight = sample_daylight(rng, floor, regime)
    lamps = sample_lamps(rng, floor, "hall", regime, 1.0)
    if is_soft:
        lamps = (*(replace(lamp, watts=0.0) for lamp in lamps), *_sample_soft_lights(rng, floor))
    else:
        lamps = (*lamps, *_sample_lights(rng, floor, regime))
    newly_painted = float(rng.random())
    return Room(
        **vars(shell),
        kind=f"varied {kind}",
        regime="varied",
        pieces=tuple(_painted(rng, piece, newly_painted, tones) for piece in floor.pieces),
        lamps=tuple(replace(lamp, is_visible=bool(rng.random() < 0.5)) for lamp in lamps),
        daylight=daylight,
        floor=any_finish(rng, tones),
        walls=_wall_finishes(rng, len(shell.outline.walls), tones),
        ceiling=any_finish(rng, tones) if rng.random() < 0.4 else palette.ceiling_finish(rng),
        trim=any_finish(rng, tones) if rng.random() < 0.4 else palette.trim_finish(rng),
        exposure_gain=sample_exposure_gain(rng) * (span(rng, *SOFT_EXPOSURE) if is_soft else 1.0),
    )


def _sample_shell(rng: Rng, kind: str) -> Shell:
    least, largest, heights = SIZES[kind]
    outline = sample_outline(rng, least, largest)
    bare = Shell(outline, span(rng, *heights), sample_slopes(rng, outline), ())
    holes = sample_holes(rng, bare, int(rng.integers(0, 10)))
    covered = [hole if hole.is_door else replace(hole, covering=str(rng.choice(COVERINGS))) for hole in holes]
    return replace(bare, holes=tuple(covered))


def _sample_regime(rng: Rng, *, has_window: bool) -> Regime:
    """A sky from night to noon. By day lamps are off in half of the rooms, as where windows light the room alone."""
    sky = log_span(rng, 0.02, 16.0) if has_window else 0.002
    lit_chance = 0.9 if sky < 0.5 else float(rng.choice([0.0, 0.0, 0.3, 0.9]))
    return Regime(0.0, (0.8 * sky, sky), PANORAMAS, 0.35 if sky > 1.0 else 0.0, lit_chance)


def _soft_regime(rng: Rng) -> Regime:
    """A sky that is as bright as the room or darker."""
    sky = log_span(rng, 0.02, 2.0)
    return Regime(0.0, (0.8 * sky, sky), PANORAMAS, 0.0, 0.0)


def _sample_soft_lights(rng: Rng, floor: Floor) -> list[Lamp]:
    """One to four luminous ceilings of 1 to 16 m², or lights that shine up at the ceiling, or windows alone."""
    if floor.windows and rng.random() < 1 / 3:
        return []
    kind = str(rng.choice(["panel", "uplight"]))
    watts, kelvin = np.exp(rng.uniform(np.log((10.0, 2000.0)), np.log((150.0, 12000.0)))).tolist()
    lights = []
    for _ in range(int(rng.integers(1, 5))):
        x, y = draw_place(rng, floor)
        below, size = (0.0, span(rng, 1.0, 4.0)) if kind == "panel" else (span(rng, 0.1, 0.5), span(rng, 0.2, 1.0))
        lights.append(Lamp(kind, x, y, (1 - below) * floor.ceiling_at((x, y)), size, kelvin, watts))
    return lights


def _sample_lights(rng: Rng, floor: Floor, regime: Regime) -> list[Lamp]:
    """Spots by the dozen, strips, bare bulbs at any height and candles; none where lamps are off."""
    if rng.random() > regime.lit_chance:
        return []
    watts = log_span(rng, 2.0, 150.0)
    kind = str(rng.choice(["spot", "strip", "bulb", "candle"]))
    lights = []
    for _ in range(int(rng.choice([1, 2, 4, 8, 16, 30]))):
        x, y = draw_place(rng, floor)
        ceiling = floor.ceiling_at((x, y))
        height = {"bulb": span(rng, 0.3, 1.0) * ceiling, "candle": span(rng, 0.02, 0.5) * ceiling}.get(kind, ceiling)
        size = {"strip": span(rng, 0.3, 0.5), "spot": 0.09, "bulb": span(rng, 0.02, 0.2), "candle": 0.01}[kind]
        kelvin = 1900.0 if kind == "candle" else log_span(rng, 1500.0, 15000.0)
        share = span(rng, 0.5, 2.0) * (0.1 if kind == "candle" else 1.0)
        lights.append(Lamp(kind, x, y, height, size, kelvin, watts * share))
    return lights


def add_clutter(rng: Rng, floor: Floor, tones: Point) -> None:
    """One to a hundred pieces of 5 cm to 2 m, on the floor and on what has a flat top."""
    for _ in range(int(log_span(rng, 1.0, 100.0))):
        kind = str(rng.choice(CLUTTER))
        w, d, h = np.exp(rng.uniform(np.log(0.06), np.log(0.6), 3)).tolist()
        look = _clutter_look(rng, tones)
        if kind in ("post", "partition", "stairs"):
            size = {
                "post": (0.5 * w, 0.5 * w, 4 * h),
                "partition": (4 * w, 0.06, 4 * h),
                "stairs": (2 * w, 3 * d, 3 * h),
            }
            floor.anywhere(rng, kind, size[kind], (look,), free_turn=True)
            continue
        size_m = {"ball": (w, w, w), "box": (w, d, h), "crate": (w, d, h)}.get(kind, (w, w, 2 * h))
        looks = (Finish("foliage", (0.02, 0.07, 0.02), (0.08, 0.2, 0.05)), look) if kind == "plant" else (look,)
        supports = [piece for piece in floor.pieces if piece.kind in SUPPORTS]
        if supports and rng.random() < 0.5:
            floor.on_top(rng, one_of(rng, supports), kind, size_m, looks)
        else:
            floor.anywhere(rng, kind, size_m, looks, free_turn=True)


def _clutter_look(rng: Rng, tones: Point) -> Finish:
    draw = rng.random()
    return MIRROR_GLASS if draw < 0.06 else GLASS if draw < 0.12 else any_finish(rng, tones)


def _painted(rng: Rng, piece: Piece, share: float, tones: Point) -> Piece:
    """The piece with a `share` of its finishes drawn anew."""
    return replace(piece, finishes=tuple(any_finish(rng, tones) if rng.random() < share else f for f in piece.finishes))


def _wall_finishes(rng: Rng, n_walls: int, tones: Point) -> tuple[Finish, ...]:
    if rng.random() < 0.4:
        return palette.wall_finishes(rng, "hall", n_walls)
    looks = [any_finish(rng, tones) for _ in range(int(rng.integers(1, 4)))]
    return tuple(one_of(rng, looks) for _ in range(n_walls))


def any_finish(rng: Rng, tones: Point) -> Finish:
    """Any pattern in any two colours whose mean reflectance lies between `tones`."""
    scale = log_span(rng, 0.08, 0.8)
    colours = any_colour(rng, tones), any_colour(rng, tones)
    return Finish(str(rng.choice(PATTERNS)), *colours, roughness=span(rng, 0.02, 1.0), scale=scale)


def any_colour(rng: Rng, tones: Point) -> Colour:
    """Grey to strongly coloured, its mean reflectance log-uniform between `tones`."""
    hue = np.exp(rng.normal(0.0, 0.8 * rng.random() ** 2, 3))
    r, g, b = np.clip(log_span(rng, *tones) * hue / hue.mean(), 0.01, 0.85).tolist()
    return r, g, b
