"""The light of a room: daylight behind the windows, a sun, lamps; five regimes from full sun to one lamp at night.

Levels are in scene units in which a sky of radiance 8 is a bright day and a lamp of 40 W lights a room in the evening;
only ratios matter, since the phone meters each room. Panoramas are those that Blender ships (CC0); their mean radiance
is divided out, so that a room's daylight is what its regime says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from xihe_blender.lab.rooms.arrange import Floor
from xihe_blender.lab.rooms.draws import Rng, draw_point, log_span, one_of, span
from xihe_blender.lab.rooms.outline import Point, Rect
from xihe_blender.lab.rooms.room_data import LAMP_KINDS, Daylight, Lamp, Sun

MEAN_RADIANCE = {"city": 0.93, "courtyard": 0.77, "forest": 0.77, "night": 0.16, "sunrise": 0.64, "sunset": 0.51}
"""Over the whole sphere, measured on the files that Blender 4.5 ships."""

ROOM_KELVIN = (6800.0, 1300.0)
"""Mean and spread. A phone's white balance takes out most of a lamp's warmth; this is what is left of it, so that the
mean colour of the light is near that of the real data."""

POWER = {"panel": 1.5, "spot": 0.8, "pendant": 1.0, "globe": 1.0, "table": 0.3, "floor": 0.6}
"""Of a lamp of each kind, relative to a ceiling lamp."""


@dataclass(frozen=True)
class Regime:
    """How light a kind of hour is: sky radiance (log-uniform range), chance of a sun, chance that a lamp is lit."""

    share: float
    sky: tuple[float, float]
    panoramas: tuple[str, ...]
    sun_chance: float
    lit_chance: float


REGIMES = {
    "day": Regime(0.43, (3.0, 14.0), ("city", "city", "courtyard", "forest", "forest", "sunset"), 0.1, 0.6),
    "sunny": Regime(0.1, (3.0, 10.0), ("city", "forest", "courtyard"), 1.0, 0.5),
    "mixed": Regime(0.27, (0.8, 4.0), ("city", "city", "courtyard", "forest", "forest", "sunset"), 0.05, 0.85),
    "evening": Regime(0.13, (0.02, 0.4), ("sunset", "night", "sunrise"), 0.0, 0.95),
    "night": Regime(0.07, (0.001, 0.01), ("night",), 0.0, 0.0),
}

DARK = ("evening", "night")

SUN_OVER_SKY = (0.5, 40.0)
"""Irradiance of the sun over the radiance of the sky, log-uniform: from haze to a clear day, on which the sun gives
some 800 W/m² and the whole sky, pi times its radiance, some 80."""

SUN_BY_DAY = 0.5
"""Least chance of a sun in rooms that have no other light but what comes through their windows."""


def sample_regime(rng: Rng, *, has_window: bool) -> str:
    """A regime by its share; a room without a window has its lamps on."""
    if not has_window:
        return "evening"
    return list(REGIMES)[int(rng.choice(len(REGIMES), p=[regime.share for regime in REGIMES.values()]))]


def sample_daylight(rng: Rng, floor: Floor, regime: Regime, *, by_day: bool = False) -> Daylight:
    """A panorama, turned and scaled, and perhaps a sun that shines through a window."""
    sun_chance = max(regime.sun_chance, SUN_BY_DAY) if by_day else regime.sun_chance
    panorama = str(rng.choice(regime.panoramas))
    radiance = log_span(rng, *regime.sky)
    sun, windows = None, floor.windows
    if windows and rng.random() < sun_chance:
        x, y = floor.outline.walls[one_of(rng, windows).wall].outward
        azimuth = float(np.degrees(np.arctan2(y, x)) + rng.uniform(-55, 55))
        warm = span(rng, 0, 1)
        tint = (1.0, 0.97 - 0.12 * warm, 0.93 - 0.3 * warm)
        elevation, over_sky = span(rng, 12, 58), log_span(rng, *SUN_OVER_SKY)
        sun = Sun(azimuth, elevation, radiance * over_sky, tint)
    return Daylight(panorama, span(rng, 0, 360), radiance / MEAN_RADIANCE[panorama], sun)


def sample_lamps(rng: Rng, floor: Floor, kind: str, regime: Regime, daylight_in: float) -> tuple[Lamp, ...]:
    """Every lamp of the room; unlit ones have 0 W. `daylight_in` scales ceiling lamps: they hold against the day."""
    kelvin = float(np.clip(rng.normal(*ROOM_KELVIN), 1500, 7500))
    fixed = _ceiling_lamps(rng, floor, kind)
    placed = [piece for piece in floor.pieces if piece.kind in LAMP_KINDS]
    lamps = [*fixed, *(Lamp(LAMP_KINDS[p.kind], p.x, p.y, p.z, p.size[2], 0.0, 0.0) for p in placed)]
    is_dark = regime.sky[1] < 1.0
    if not lamps and is_dark:
        lamps = [_hung(floor, "globe", draw_place(rng, floor), 0.25)]
    lit = [bool(rng.random() < regime.lit_chance) for _ in lamps]
    if is_dark and not any(lit):
        lit[int(rng.integers(len(lamps)))] = True
    return tuple(_lit(rng, lamp, kelvin, daylight_in) if on else lamp for lamp, on in zip(lamps, lit, strict=True))


def _lit(rng: Rng, lamp: Lamp, room_kelvin: float, daylight_in: float) -> Lamp:
    """The lamp switched on: most have the room's colour temperature, some their own."""
    kelvin = room_kelvin if rng.random() < 0.8 else span(rng, 1500, 7500)
    watts = log_span(rng, 12, 60) * POWER[lamp.kind]
    if lamp.kind not in ("table", "floor"):
        watts *= max(1.0, daylight_in)
    return replace(lamp, kelvin=kelvin * span(rng, 0.94, 1.06), watts=watts)


def _hung(floor: Floor, kind: str, place: Point, size_m: float) -> Lamp:
    """A lamp, not lit yet, fixed to the ceiling over a point of the floor."""
    return Lamp(kind, *place, floor.ceiling_at(place), size_m, 0.0, 0.0)


def _ceiling_lamps(rng: Rng, floor: Floor, kind: str) -> list[Lamp]:
    """A pendant over the table or the middle, panels in offices, spots in rows, or nothing."""
    table = next((p for p in floor.pieces if p.kind == "table"), None)
    draw = rng.random()
    places = _ceiling_places(floor)
    if not places:
        return []
    if kind == "office" or draw < 0.2:
        return [_hung(floor, "panel", place, span(rng, 0.4, 0.9)) for place in places[:4]]
    if draw < 0.42:
        return [_hung(floor, "spot", place, 0.09) for place in places[:6]]
    if draw < 0.93:
        place = (table.x, table.y) if table is not None else one_of(rng, places)
        drop = span(rng, 0.35, 0.8) if table is not None and floor.height > 2.3 else 0.25
        return [_hung(floor, str(rng.choice(["pendant", "globe"])), place, drop)]
    return []


def _ceiling_places(floor: Floor) -> list[Point]:
    """Points of a regular grid, some 1.8 m apart, over which the ceiling is flat and nothing reaches up to it."""
    b = floor.outline.bounds
    columns, rows = max(1, round((b.x1 - b.x0) / 1.8)), max(1, round((b.y1 - b.y0) / 1.8))
    grid = [
        (b.x0 + (b.x1 - b.x0) * (i + 0.5) / columns, b.y0 + (b.y1 - b.y0) * (j + 0.5) / rows)
        for j in range(rows)
        for i in range(columns)
    ]
    return [place for place in grid if _is_free_above(floor, place)]


def draw_place(rng: Rng, floor: Floor) -> Point:
    """A point under the ceiling at its full height, if a few draws find one."""
    b = floor.outline.bounds.grown(-0.3)
    for _ in range(50):
        place = draw_point(rng, b)
        if _is_free_above(floor, place):
            return place
    return floor.outline.walls[0].point(floor.outline.walls[0].length / 2, 0.5)


def _is_free_above(floor: Floor, place: Point) -> bool:
    """Whether the ceiling over a point is flat and no piece reaches up to where a lamp would hang."""
    around = Rect.around(place, (1.0, 1.0))
    if floor.ceiling_over(around) <= floor.height - 1e-6 or not floor.outline.holds_rect(around):
        return False
    return not any(p.footprint.grown(0.3).holds(place) for p in floor.pieces if p.top_m > floor.height - 0.9)
