"""Disturbances of clouds, which ask whether an estimator degrades gently: nearly nothing, or nothing true, is seen.

Each disturbance makes new clouds of test clouds and leaves their truth, the light of the undisturbed room, as it is.
What is asked is whether an estimator is then worse than what a phone gives without any: so each comes with what the
phone's sensor would say. A disturbed picture reaches the sensor too; a cloud of which only a part is left does not, as
the frame is still seen whole, and only its distances are missing.

Not here: other numbers of anchors and rolled cameras, which need the rooms and come as sampled clouds of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import srgb_to_linear
from xihenet.estimators.lattice import lean_on_sensor
from xihenet.records import ArrayF64
from xihenet.sphere import AnchorLattice
from xihenet.training.baselines import AMBIENT, PROJECTION, Baselines
from xihenet.training.calibration import SeedCalibrations
from xihenet.training.dataset import CloudSet
from xihenet.training.predictions import NetworkSeeds, Prediction, over_seeds
from xihenet.training.scores import pooled_rms, ratio

STRESS_LIMIT = 1.10
"""No group may be worse than `ambient` by more than a tenth."""

CAP_SHARE = 0.05
COLOUR_NOISE = 0.15
"""Standard deviation of encoded colour, as of a phone's picture in a dark room, pushed far."""

DISTANCE_NOISE = 0.1
"""Standard deviation relative to the distance: ten times a phone's sensor."""

Disturbance = Callable[[CloudSet, np.random.Generator], CloudSet]


def leave_cap(clouds: CloudSet, rng: np.random.Generator, share: float = CAP_SHARE) -> CloudSet:
    """Of each cloud, the anchors nearest to a set one drawn at random, `share` of the sphere and at least one.

    A cloud with less than that stays as it is, one without any set anchor too.
    """
    directions = AnchorLattice(clouds.is_set.shape[1]).directions
    n_left = max(1, round(share * len(directions)))
    is_set = np.zeros_like(clouds.is_set)
    for left, known in zip(is_set, clouds.is_set, strict=True):
        members = np.flatnonzero(known)
        if len(members):
            nearness = directions[members] @ directions[rng.choice(members)]
            left[members[np.argsort(-nearness, kind="stable")[:n_left]]] = True
    shown = is_set[..., None]
    srgb_u8, points_m, facing_i8 = clouds.srgb_u8 * shown, clouds.points_m * shown, clouds.facing_i8 * is_set
    # The sensor's reading stays the frame's own.
    return replace(clouds, srgb_u8=srgb_u8, points_m=points_m, facing_i8=facing_i8, is_set=is_set)


leave_one_anchor = partial(leave_cap, share=0.0)
"""Of each cloud, one set anchor drawn at random."""


def blacken(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Every anchor that is set is black: a covered lens."""
    return _coloured(clouds, np.zeros_like(clouds.srgb_u8))


def blow_out(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Every anchor that is set is at the end of the range: a frame exposed far too long."""
    return _coloured(clouds, np.full_like(clouds.srgb_u8, 255))


def add_noise(clouds: CloudSet, rng: np.random.Generator) -> CloudSet:
    """Noise on the encoded colour and the distance of every set anchor, then rounded and clipped as a camera does."""
    noise = rng.normal(0.0, 255 * COLOUR_NOISE, clouds.srgb_u8.shape)
    colours = np.clip(np.rint(clouds.srgb_u8 + noise), 0, 255).astype(np.uint8)
    stretch = np.maximum(rng.normal(1.0, DISTANCE_NOISE, (*clouds.is_set.shape, 1)), 0.1)
    return replace(_coloured(clouds, colours), points_m=(clouds.points_m * stretch).astype(np.float16))


DISTURBANCES: dict[str, Disturbance] = {
    "5 % coverage": leave_cap,
    "one set anchor": leave_one_anchor,
    "black frame": blacken,
    "blown-out frame": blow_out,
    "noise": add_noise,
}


def _coloured(clouds: CloudSet, srgb_u8: NDArray[np.uint8]) -> CloudSet:
    """The sensor's reading is the mean linear colour of what is seen now; of nothing, as it was."""
    colours = srgb_u8 * clouds.is_set[..., None]
    n_set = clouds.is_set.sum(axis=1)[:, None]
    total: ArrayF64 = np.einsum("mnc->mc", srgb_to_linear(colours / 255.0))
    sensed = np.where(n_set > 0, total / np.maximum(n_set, 1), clouds.ambient).astype(np.float32)
    return replace(clouds, srgb_u8=colours, ambient=sensed)


@dataclass(frozen=True)
class StressRow:
    """One predictor under one disturbance."""

    rmse: float | None  # None where any light is not finite
    ratio: float | None  # to that of `ambient`
    is_finite: bool  # all lights
    is_within: bool  # the ratio, at most `STRESS_LIMIT`
    expected_over_made: float | None  # mean errors; None where none is expected
    name: str
    n_seeds: int
    spread: float | None = None  # of the ratio over seeds


@dataclass(frozen=True)
class StressGroup:
    """One disturbance: how many clouds of how many anchors, what is seen, and the predictors."""

    name: str
    n_clouds: int
    n_anchors: int
    coverage: float | None
    rows: tuple[StressRow, ...]


def stress_group(
    name: str, clouds: CloudSet, networks: Sequence[NetworkSeeds], baselines: Baselines,
    calibrations: Mapping[str, SeedCalibrations],
) -> StressGroup:  # fmt: skip
    """RMSE of `projection` and the lattice networks over `ambient`'s, and whether all lights are finite."""
    basic, coverage = baselines.lights(clouds), clouds.coverage
    of_ambient = pooled_rms(basic[AMBIENT] - clouds.truth(baselines.target))
    projection = Prediction(clouds, baselines.target, basic[PROJECTION])
    rows = [_stress_row(PROJECTION, [projection], of_ambient, [])]
    for network in networks:
        said = network.of_clouds(clouds, clouds)
        # As the estimator does in a session, where the frame's sensor is at hand.
        leaning = [replace(one, light=lean_on_sensor(one.light, coverage, basic[AMBIENT])) for one in said]
        known = calibrations.get(network.name)
        expected = [] if known is None else [known.expected(i, [one])[0] for i, one in enumerate(said)]
        rows.append(_stress_row(network.name, leaning, of_ambient, expected))
    seen = float(coverage.mean()) if len(coverage) else None
    return StressGroup(name, len(clouds), clouds.is_set.shape[1], seen, tuple(rows))


def _stress_row(
    name: str, seeds: Sequence[Prediction], of_ambient: float | None, expected: Sequence[ArrayF64]
) -> StressRow:
    """`expected` are the errors (M,) of each seed; none of a predictor that knows no error."""
    if not all(np.isfinite(said.light).all() for said in seeds):
        return StressRow(None, None, False, False, None, name, len(seeds))
    rmses = [pooled_rms(said.light - said.truth) for said in seeds]
    over_ambient, spread = over_seeds([ratio(rmse, of_ambient) for rmse in rmses])
    is_within = over_ambient is None or over_ambient <= STRESS_LIMIT
    parts = zip(expected, seeds, strict=False) if len(seeds[0].cases) else ()
    kept = [ratio(float(errors.mean()), float(said.made.mean())) for errors, said in parts] or [None]
    return StressRow(over_seeds(rmses)[0], over_ambient, True, is_within, over_seeds(kept)[0], name, len(seeds), spread)
