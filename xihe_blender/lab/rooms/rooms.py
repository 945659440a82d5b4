"""What rooms are there? `sample_room` draws one from a generator: the same seed gives the same room.

Chosen: rules for plan, furniture, materials and light that are drawn independently where they can be, because what a
network lacks is distinct rooms. Rejected: a few hand-made rooms with jitter, which a network learns by heart.
"""

from __future__ import annotations

import numpy as np

from xihe_blender.lab.rooms import palette
from xihe_blender.lab.rooms.arrange import Floor, Rng
from xihe_blender.lab.rooms.furnishing import furnish
from xihe_blender.lab.rooms.light_plan import REGIMES, sample_daylight, sample_lamps, sample_regime
from xihe_blender.lab.rooms.room_data import Room
from xihe_blender.lab.rooms.shape import sample_holes, sample_outline, sample_slopes

KIND_SHARES = {
    "living": 0.25, "bedroom": 0.18, "dining": 0.12, "study": 0.1, "kitchen": 0.12, "bathroom": 0.07, "office": 0.09,
    "hall": 0.07,
}  # fmt: skip
EXPOSURE_GAIN, EXPOSURE_SPREAD = 1.35, 0.12
"""Median of what a phone gives more light than our metering, which takes the low end of the meters' range, and the
standard deviation of its log."""


def room_generator(seed: int, index: int) -> Rng:
    """The generator of room `index` of a data set: rooms do not depend on how many there are or who makes them."""
    return np.random.default_rng(np.random.SeedSequence([seed, index]))


def walk_generator(seed: int, index: int) -> Rng:
    """A child of the room's generator for the walk through it, so that the room is the same with and without."""
    return np.random.default_rng(np.random.SeedSequence([seed, index], spawn_key=(1,)))


def sample_room(rng: Rng) -> Room:
    """One room with all that is in it."""
    kind = str(rng.choice(list(KIND_SHARES), p=list(KIND_SHARES.values())))
    outline = sample_outline(rng, kind)
    tall = rng.random() < 0.15
    height = float(rng.uniform(2.8, 3.6)) if tall else float(rng.uniform(2.25, 2.8))
    slopes = sample_slopes(rng, outline, height)
    holes = sample_holes(rng, outline, height, slopes)
    floor = Floor(outline, height, slopes, holes)
    furnish(rng, floor, kind)
    windows = [hole for hole in holes if not hole.is_door]
    regime_name = sample_regime(rng, has_window=bool(windows))
    regime = REGIMES[regime_name]
    daylight = sample_daylight(rng, floor, regime)
    glass_share = sum((w.high - w.low) * (w.top - w.bottom) for w in windows) / outline.area
    sky = float(np.sqrt(regime.sky[0] * regime.sky[1]))
    lamps = sample_lamps(rng, floor, kind, regime, sky * glass_share * 6.0)
    return Room(
        kind, regime_name, outline, height, slopes, holes, tuple(floor.pieces), lamps, daylight,
        floor=palette.floor_finish(rng, kind),
        walls=palette.wall_finishes(rng, kind, len(outline.walls)),
        ceiling=palette.ceiling_finish(rng),
        trim=palette.trim_finish(rng),
        exposure_gain=float(EXPOSURE_GAIN * np.exp(rng.normal(0.0, EXPOSURE_SPREAD))),
    )  # fmt: skip
