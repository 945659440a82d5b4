"""Calibration of a network's word about its own error: how far it may be believed, and what makes it better.

A network's raw expected error (with the size of its light in it, `raw_error`) comes from training rooms, which it knows
better than others: it is too small, and says too much of what it learned by heart; and the less of the sphere it has
seen, the more so. On the validation rooms a power law, times an exponential of the coverage, maps it to the error that
was made: three numbers, positive and monotone for any raw value. They maximise the likelihood of exponential errors, as
in training, whose mean is the best guess; so expected errors average to those made. Multiples of the expected error
that hold a share of the validation clouds then make promises: of 90 % of the clouds the error is below so many times
the expected.

Rejected: a line a + b x raw, which may be negative for an odd raw value; isotonic regression, which is not smooth; the
power law alone, which kept its promise of 50 % for 45 % of clouds of one view and 62 % of merged ones (validation
rooms, each half judged by the other).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from xihenet.estimators.calibration import SHARES_ASKED, SMALLEST_RAW, STEEPEST, STEEPEST_IN_COVERAGE, Calibration
from xihenet.records import ArrayBool, ArrayF64
from xihenet.training.dataset import open_split
from xihenet.training.predictions import VIEWS, Group, NetworkSeeds, Prediction, load_seeds, open_group, over_seeds
from xihenet.training.scores import COVERAGE_EDGES, coverage_groups

N_BINS = 8
MOST_MEDIANS = 10.0  # of errors over the expected ones, each room alike
_N_STEPS = 40


@dataclass(frozen=True)
class KeptPromises:
    """Of some clouds: the mean of both errors, and the share of them that stayed below each promise; None without."""

    n_clouds: int
    expected: float | None
    made: float | None
    kept: tuple[float | None, ...]


@dataclass(frozen=True)
class ErrorBin:
    """The mean of both errors over clouds that are next to each other by the expected one."""

    expected: float
    made: float


@dataclass(frozen=True)
class CalibrationFigures:
    """How well promises are kept: by all clouds and by group, in bins of equal number, and the errors' correlation;
    `tables` are groups of more clouds than these.
    """

    all: KeptPromises
    groups: Mapping[str, KeptPromises]
    bins: tuple[ErrorBin, ...]
    correlation: float | None
    tables: Mapping[str, KeptPromises] = field(default_factory=dict)


@dataclass(frozen=True)
class CalibrationRow:
    """One network's calibration of each seed, and what came of them: the mean over seeds, and the deviation."""

    name: str
    n_seeds: int
    by_seed: tuple[Calibration, ...]
    figures: CalibrationFigures
    spread: CalibrationFigures


def fit_calibration(raw: ArrayLike, made: ArrayLike, coverage: ArrayLike) -> Calibration:
    """The three numbers and the quantiles of validation clouds; made / expected is then 1 in the mean.

    Parameters
    ----------
    raw, made : (M,) what the network expected and what came, M at least 2
    coverage : (M,) share of the sphere that was seen, 0 to 1

    ValueError for too few, other shapes, negative errors, NaN or infinity.
    """
    expected, errors, seen = _checked(raw, made, coverage)
    power, slope = _likeliest(np.log(np.maximum(expected, SMALLEST_RAW)), seen, errors)
    shape = np.maximum(expected, SMALLEST_RAW) ** power * np.exp(slope * seen)
    factor = float(np.mean(errors / shape))
    quantiles = np.quantile(errors / np.maximum(factor * shape, SMALLEST_RAW), SHARES_ASKED)
    return Calibration(factor, power, slope, tuple(map(float, quantiles)))


def calibration_elsewhere(raw: ArrayLike, made: ArrayLike, coverage: ArrayLike, room: ArrayLike) -> Calibration:
    """The calibration of rooms of another kind than the training's, each counted alike.

    The power is that of least squares of the logarithms, the slope that of the promised quantiles, by composite
    quantile regression (Zou and Yuan, 2008): a few large errors do not rule them, as they do a likelihood. Of n rooms,
    promises hold a share (n + 1) / n times the asked one, so that they hold in the next (conformal prediction).
    Parameters are those of `fit_calibration`; `room` (M,) is each cloud's. For the level, errors of more than
    `MOST_MEDIANS` over the median count as so many: one place before a lamp would set that of all.
    """
    expected, errors, seen = _checked(raw, made, coverage)
    _, number, n_clouds = np.unique(np.asarray(room), return_inverse=True, return_counts=True)
    weights = 1 / n_clouds[number]
    logs = np.log(np.maximum([errors, expected], SMALLEST_RAW))
    log_errors, *of = (row - np.average(row, weights=weights) for row in (*logs, seen))
    fitted = np.linalg.lstsq(np.transpose(of) * np.sqrt(weights)[:, None], log_errors * np.sqrt(weights), rcond=None)[0]
    power = float(np.clip(fitted[0], 0, STEEPEST))
    slope = _slope_by_quantiles(logs[0] - power * logs[1], seen, weights) if errors.any() else 0.0
    flat = Calibration(1.0, power, slope, (1.0,) * len(SHARES_ASKED))
    ratios = errors / np.maximum(flat.expected(expected, seen), SMALLEST_RAW)
    highest = MOST_MEDIANS * float(_quantiles(0.5, ratios, weights))
    level = max(float(np.average(np.minimum(ratios, highest), weights=weights)), SMALLEST_RAW)
    shares = [min(share * (len(n_clouds) + 1) / len(n_clouds), 1.0) for share in SHARES_ASKED]
    quantiles = tuple(map(float, _quantiles(shares, ratios, weights) / level))
    return replace(flat, factor=level, quantiles=quantiles)


def _quantiles(shares: float | Sequence[float], values: ArrayF64, weights: ArrayF64) -> ArrayF64:
    """What shares of the weights lie below; each value has half of its own below it."""
    order = np.argsort(values, kind="stable")
    below = (np.cumsum(weights[order]) - weights[order] / 2) / weights.sum()
    return np.asarray(np.interp(shares, below, values[order]))


def promises_left_out(
    raw: ArrayLike, made: ArrayLike, coverage: ArrayLike, room: ArrayLike, judged: ArrayBool
) -> tuple[float, ...]:
    """How well `calibration_elsewhere` keeps its promises in rooms it was not given: for each of `SHARES_ASKED` the
    share of a room's `judged` (M,) clouds below what the other rooms promise, the mean over rooms that have such; there
    are two rooms or more.
    """
    expected, errors, seen = _checked(raw, made, coverage)
    number, kept = np.asarray(room), []
    for left_out in np.unique(number[judged]):
        others, here = number != left_out, (number == left_out) & judged
        told = calibration_elsewhere(expected[others], errors[others], seen[others], number[others])
        limits = np.outer(told.quantiles, told.expected(expected[here], seen[here]))
        kept.append(np.mean(errors[here] <= limits, axis=1))
    return tuple(map(float, np.mean(kept, axis=0)))


def calibration_figures(
    expected: ArrayF64, promised: ArrayF64, made: ArrayF64, groups: Mapping[str, ArrayBool]
) -> CalibrationFigures:
    """How well promises are kept by clouds that nothing was fitted to.

    `expected` (M,) is calibrated; `promised` (S, M) has for each of `SHARES_ASKED` the error that so many clouds should
    stay below; `groups` are masks (M,) by name.
    """
    is_varied = len(made) > 1 and np.ptp(expected) > 0 and np.ptp(made) > 0
    parts = np.array_split(np.argsort(expected, kind="stable"), N_BINS)
    return CalibrationFigures(
        _kept(expected, promised, made, np.ones(len(made), bool)),
        {name: _kept(expected, promised, made, mask) for name, mask in groups.items()},
        tuple(ErrorBin(float(expected[p].mean()), float(made[p].mean())) for p in parts if len(p)),
        float(np.corrcoef(expected, made)[0, 1]) if is_varied else None,
    )


def _kept(expected: ArrayF64, promised: ArrayF64, made: ArrayF64, mask: ArrayBool) -> KeptPromises:
    n = int(np.count_nonzero(mask))
    if n == 0:
        return KeptPromises(0, None, None, (None,) * len(promised))
    kept = tuple(float(np.mean(made[mask] <= limit[mask])) for limit in promised)
    return KeptPromises(n, float(expected[mask].mean()), float(made[mask].mean()), kept)


def _likeliest(log_raw: ArrayF64, coverage: ArrayF64, made: ArrayF64) -> tuple[float, float]:
    """Power and slope of the highest likelihood, 0 for what does not vary: with the factor put in, it is convex."""
    if not made.any():
        return 0.0, 0.0
    x, alike = log_raw - log_raw.mean(), np.ones(len(made))

    def best_slope(power: float) -> tuple[float, float]:
        return _likeliest_slope(made * np.exp(-power * x), coverage, alike)

    power = _lowest(lambda power: best_slope(power)[1], 0.0, STEEPEST if np.ptp(x) else 0.0)
    return power, best_slope(power)[0]


def _likeliest_slope(ratios: ArrayF64, coverage: ArrayF64, weights: ArrayF64) -> tuple[float, float]:
    """The slope alone of errors over what the power expects, and how unlikely they still are."""
    c = coverage - np.average(coverage, weights=weights)
    steepest = STEEPEST_IN_COVERAGE if np.ptp(c) else 0.0

    def unlikeliness(slope: float) -> float:
        return float(np.log(np.average(ratios * np.exp(-slope * c), weights=weights)))

    slope = _lowest(unlikeliness, -steepest, steepest)
    return slope, unlikeliness(slope)


def _slope_by_quantiles(log_ratios: ArrayF64, coverage: ArrayF64, weights: ArrayF64) -> float:
    """How logarithms fall with coverage, by all the quantiles that are promised at once."""
    c, shares = coverage - np.average(coverage, weights=weights), np.asarray(SHARES_ASKED)[:, None]
    steepest = STEEPEST_IN_COVERAGE if np.ptp(c) else 0.0

    def loss(slope: float) -> float:
        left = log_ratios - slope * c
        off = left - _quantiles(SHARES_ASKED, left, weights)[:, None]
        return float(np.average(np.maximum(shares * off, (shares - 1) * off).sum(axis=0), weights=weights))

    return _lowest(loss, -steepest, steepest)


def _lowest(of: Callable[[float], float], low: float, high: float) -> float:
    """Where a convex function is lowest, by golden section."""
    golden = (np.sqrt(5) - 1) / 2
    a, b = high - golden * (high - low), low + golden * (high - low)
    of_a, of_b = of(a), of(b)
    for _ in range(_N_STEPS):
        # Of the two places within, one is also within what is left: it is not asked again.
        if of_a < of_b:
            high, b, of_b = b, a, of_a
            a = high - golden * (high - low)
            of_a = of(a)
        else:
            low, a, of_a = a, b, of_b
            b = low + golden * (high - low)
            of_b = of(b)
    return float((low + high) / 2)


def _checked(raw: ArrayLike, made: ArrayLike, coverage: ArrayLike) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    expected, errors, seen = (np.asarray(part, np.float64) for part in (raw, made, coverage))
    if expected.ndim != 1 or not expected.shape == errors.shape == seen.shape or len(errors) < 2:
        shapes = f"{expected.shape}, {errors.shape}, {seen.shape}"
        raise ValueError(f"calibration: expected three arrays (M,) of 2 or more, got {shapes}")
    everything = np.concatenate([expected, errors, seen])
    if not (np.isfinite(everything).all() and everything.min() >= 0 and seen.max() <= 1):
        raise ValueError("calibration: expected finite errors >= 0 and coverages of at most 1, got others or NaN")
    return expected, errors, seen


@dataclass(frozen=True, eq=False)
class SeedCalibrations:
    """What makes a network's expected errors believable, for each of its seeds."""

    name: str  # of the network
    by_seed: tuple[Calibration, ...]  # fitted to all validation clouds
    # By seed, for the rooms of even and of odd numbers. Where the report is of the validation split, each was fitted to
    # the other half of its rooms: no cloud is judged by what saw its room.
    judges: tuple[tuple[Calibration, Calibration], ...]

    @classmethod
    def fitted(
        cls, network: NetworkSeeds, held_out: Sequence[Group], *, is_crossed: bool = False
    ) -> SeedCalibrations | None:
        """Fitted to validation clouds; None for a network that expects no error or has too few clouds here."""
        said = [network.of_group(group) for group in held_out]
        parity = np.concatenate([group.cases.room for group in held_out]) % 2
        expects_error = all(said) and all(one.raw_error is not None for of_group in said for one in of_group)
        if not expects_error or min(np.bincount(parity, minlength=2)) < 2:
            return None
        by_seed, judges = [], []
        for of_seed in zip(*said, strict=True):
            known = _together(of_seed)
            by_seed.append(fit_calibration(*known))
            even, odd = (fit_calibration(*(part[parity == p] for part in known)) for p in (0, 1))
            judges.append((odd, even) if is_crossed else (by_seed[-1], by_seed[-1]))
        return cls(network.name, tuple(by_seed), tuple(judges))

    def expected(self, seed: int, said: Sequence[Prediction]) -> tuple[ArrayF64, ArrayF64]:
        """(M,) expected errors of all that one seed said, and (S, M) those promised for each share asked."""
        parity, judges = np.concatenate([one.cases.room for one in said]) % 2, self.judges[seed]
        raw, _, coverage = _together(said)
        errors = np.choose(parity, [one.expected(raw, coverage) for one in judges])
        multiples = np.array([one.quantiles for one in judges])[parity].T
        return errors, multiples * errors

    def figures(self, groups: Sequence[Group]) -> CalibrationRow:
        """Over the clouds of one view and all views together, by coverage and by table; mean and spread over seeds."""
        known = {group.name: group.predicted[self.name] for group in groups if self.name in group.predicted}
        by_seed = [self._seed_figures(i, {k: seeds[i] for k, seeds in known.items()}) for i in range(len(self.by_seed))]
        return CalibrationRow(self.name, len(by_seed), self.by_seed, *over_seeds(by_seed))

    def _seed_figures(self, seed: int, of_tables: Mapping[str, Prediction]) -> CalibrationFigures:
        said = list(of_tables.values())
        errors, limits = self.expected(seed, said)
        _, made, coverage = _together(said)
        # The first two tables are of the rooms that were split; what coverage does is asked of them alone.
        main = slice(sum(len(one.cases) for one in said[:2]))
        edges = [f"{a:.0%} to {b:.0%} seen" for a, b in itertools.pairwise(COVERAGE_EDGES)]
        by_coverage = dict(zip(edges, coverage_groups(coverage[main]), strict=True))
        figures = calibration_figures(errors[main], limits[:, main], made[main], by_coverage)
        of_table = np.repeat(np.arange(len(said)), [len(one.cases) for one in said])
        by_table = {name: of_table == i for i, name in enumerate(of_tables)}
        return replace(figures, tables=calibration_figures(errors, limits, made, by_table).groups)


def _together(said: Sequence[Prediction]) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    """(M,) raw expected errors of a network that knows them, errors made, coverages: of all predictions, in a row."""
    raw = np.concatenate([one.raw_error for one in said if one.raw_error is not None])
    return raw, np.concatenate([one.made for one in said]), np.concatenate([one.cases.coverage for one in said])


def calibrate_network(network: Path, folders: Sequence[Path]) -> Calibration:
    """The calibration of one trained network by the validation clouds of one view and of all views, for its weights.

    ValueError if the file or the folders are broken, the network expects no error, or there are too few clouds.
    """
    seeds = load_seeds("", [network])
    found = SeedCalibrations.fitted(seeds, [open_group(views, folders, "validation", views) for views in VIEWS])
    if found is None:
        raise ValueError(f"{network}: expected a network that knows its error, and validation clouds of several rooms")
    return found.by_seed[0]


def calibrate_elsewhere(network: Path, folders: Sequence[Path]) -> tuple[Calibration, dict[str, tuple[float, ...]]]:
    """The calibration of rooms of another kind, a folder of sampled clouds each, and how well its promises are kept in
    each of them by that of the others, for clouds of one view and merged ones.

    ValueError for fewer than two folders, for broken ones, and for a network that expects no error.
    """
    if len(folders) < 2:
        raise ValueError(f"--elsewhere: expected the sampled clouds of two rooms or more, got {len(folders)}")
    seeds, errors = load_seeds("", [network]), []
    for number, folder in enumerate(folders):
        clouds = open_split(folder, "test")
        said = seeds.of_clouds(clouds, clouds)
        if said[0].raw_error is None or not len(clouds):
            raise ValueError(f"{folder}: expected clouds, and a network that knows its error")
        room, is_merged = np.full(len(clouds), number), np.asarray(clouds.n_views) > 1
        errors.append(np.stack([said[0].raw_error, said[0].made, clouds.coverage, room, is_merged]))
    raw, made, coverage, room, merged = np.concatenate(errors, axis=1)
    kept = {
        views: promises_left_out(raw, made, coverage, room, judged)
        for views, judged in (("one view", merged == 0), ("merged", merged == 1))
        if judged.any()
    }
    return calibration_elsewhere(raw, made, coverage, room), kept
