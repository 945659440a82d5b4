"""Parts of the report, made of clouds and of what predictors say of them.

Pure functions from predictions to records of figures, of one seed first and then their mean and spread, so that every
number of a table has its spread. Where the clouds of a part are none, its figures are None.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.estimators.base import Target
from xihenet.estimators.calibration import Calibration
from xihenet.estimators.lattice import lean_on_sensor
from xihenet.records import ArrayBool, ArrayF64
from xihenet.training.baselines import AMBIENT, MEAN, PROJECTION, Baselines
from xihenet.training.calibration import (
    CalibrationFigures,
    calibration_elsewhere,
    calibration_figures,
    fit_calibration,
    promises_left_out,
)
from xihenet.training.dataset import CloudSet, open_split
from xihenet.training.predictions import (
    VIEWS,
    Group,
    NetworkSeeds,
    Prediction,
    Predictions,
    load_alone,
    open_group,
    over_seeds,
)
from xihenet.training.scores import COVERAGE_EDGES, Scores, coverage_groups, pooled_rms, ratio, rmse_of_each
from xihenet.training.stress import STRESS_LIMIT

CURVE_EDGES = tuple(i / 20 for i in range(21))
FEWEST_IN_BIN = 10
WORST_SHARE = 0.05
N_WORST_ROOMS = 5

Known = float | None


@dataclass(frozen=True)
class Figures(Scores):
    """All scores of a predictor, and those of coefficients over the mean predictor's on the same clouds."""

    ratio: Known
    ratio_by_band: tuple[Known, ...]
    ratio_by_coverage: tuple[Known, ...]


@dataclass(frozen=True)
class TableRow:
    """One predictor: the mean of its seeds' figures, and their standard deviation."""

    name: str
    n_seeds: int
    figures: Figures
    spread: Figures


@dataclass(frozen=True)
class Table:
    """What the clouds of a group are (`coverage` by percentile, `n_in_coverage` between edges), and all predictors."""

    name: str
    n_clouds: int
    n_rooms: int
    coverage: Mapping[str, Known]
    n_in_coverage: tuple[int, ...]
    rows: tuple[TableRow, ...]


@dataclass(frozen=True)
class Ratios:
    """Of one predictor by bin, over the mean predictor's, and the deviation over seeds; None where clouds are few."""

    ratio: tuple[Known, ...]
    spread: tuple[Known, ...]


@dataclass(frozen=True)
class CoverageCurve:
    """Between each two of the `edges`: the clouds' mean coverage and number, and the ratios by predictor."""

    edges: tuple[float, ...]
    coverage: tuple[Known, ...]
    n_clouds: tuple[int, ...]
    rows: Mapping[str, Ratios]


@dataclass(frozen=True)
class WorstRoom:
    """A room's number, clouds, share of the squared error of all, and SHC RMSE."""

    room: int
    n_clouds: int
    share: Known
    rmse: float


@dataclass(frozen=True)
class RoomFigures:
    """Of one predictor: what share of the squared error the worst `worst_share` of clouds and of rooms have."""

    name: str
    worst_share: float
    of_worst_clouds: Known
    of_worst_rooms: Known
    worst_rooms: tuple[WorstRoom, ...]


@dataclass(frozen=True)
class CalibrationRow:
    """One network's calibration of each seed, and what came of them: the mean over seeds, and the deviation."""

    name: str
    n_seeds: int
    by_seed: tuple[Calibration, ...]
    figures: CalibrationFigures
    spread: CalibrationFigures


@dataclass(frozen=True)
class StressRow:
    """One predictor under one disturbance.

    Parameters
    ----------
    rmse, ratio : and over that of `ambient`; None where any light is not finite
    is_finite, is_within : all lights; at most `STRESS_LIMIT`
    expected_over_made : mean errors; None where none is expected
    spread : of the ratio over seeds
    """

    rmse: Known
    ratio: Known
    is_finite: bool
    is_within: bool
    expected_over_made: Known
    name: str
    n_seeds: int
    spread: Known = None


@dataclass(frozen=True)
class StressGroup:
    """One disturbance: how many clouds of how many anchors, what is seen, and the predictors."""

    name: str
    n_clouds: int
    n_anchors: int
    coverage: Known
    rows: tuple[StressRow, ...]


def group_table(group: Group, predicted: Predictions, target: Target) -> Table:
    """What the clouds are, and a row for each predictor."""
    rows = [
        TableRow(name, len(seeds), *over_seeds(prediction_figures(group, predicted, seeds, target)))
        for name, seeds in predicted.items()
    ]
    n_clouds, coverage = len(group.cases), group.cases.coverage
    quantiles = np.quantile(coverage, (0.05, 0.5, 0.95)).tolist() if n_clouds else [None] * 3
    return Table(
        group.name,
        n_clouds,
        len(np.unique(group.cases.room)),
        dict(zip(("p5", "p50", "p95"), quantiles, strict=True)),
        tuple(int(mask.sum()) for mask in coverage_groups(coverage)),
        tuple(rows),
    )


def prediction_figures(
    group: Group, predicted: Predictions, seeds: Sequence[Prediction], target: Target
) -> list[Figures]:
    """For each seed; `predicted` has the mean predictor."""
    known = group.cases.truth(target), group.cases.coverage
    yardstick = Scores.of(predicted[MEAN][0].light, *known)
    figures = []
    for seed in seeds:
        own = Scores.of(seed.light, *known)
        by_band = tuple(map(ratio, own.by_band, yardstick.by_band))
        by_coverage = tuple(map(ratio, own.by_coverage, yardstick.by_coverage))
        whole = ratio(own.rmse, yardstick.rmse)
        figures.append(Figures(**vars(own), ratio=whole, ratio_by_band=by_band, ratio_by_coverage=by_coverage))
    return figures


def coverage_curve(groups: Sequence[Group], predicted: Sequence[Predictions], target: Target) -> CoverageCurve:
    """Ratio in narrow bins of coverage, over all clouds of the groups, of the predictors that all groups have."""
    truths = [group.cases.truth(target) for group in groups]
    coverage = np.concatenate([group.cases.coverage for group in groups])
    bins = coverage_groups(coverage, CURVE_EDGES)

    def errors(name: str) -> list[ArrayF64]:
        """(M,) of each seed."""
        seeds = zip(*(of_group[name] for of_group in predicted), strict=True)
        return [np.concatenate([rmse_of_each(p.light, t) for p, t in zip(s, truths, strict=True)]) for s in seeds]

    def in_bin(made: ArrayF64, mask: ArrayBool) -> float | None:
        is_enough = np.count_nonzero(mask) >= FEWEST_IN_BIN
        return ratio(pooled_rms(made[mask]), pooled_rms(yardstick[mask])) if is_enough else None

    yardstick, rows = errors(MEAN)[0], {}
    for name in predicted[0]:
        if all(name in of_group for of_group in predicted):
            by_bin = [tuple(in_bin(made, mask) for mask in bins) for made in errors(name)]
            rows[name] = Ratios(*over_seeds(by_bin))
    seen = tuple(float(coverage[b].mean()) if b.any() else None for b in bins)
    return CoverageCurve(CURVE_EDGES, seen, tuple(int(b.sum()) for b in bins), rows)


def room_figures(group: Group, name: str, seeds: Sequence[Prediction], target: Target) -> RoomFigures:
    """How unevenly the squared error, the mean over seeds, is spread over clouds and over rooms."""
    truth = group.cases.truth(target)
    squared = np.mean([rmse_of_each(seed.light, truth) ** 2 for seed in seeds], axis=0)
    rooms, index, n_clouds = np.unique(group.cases.room, return_inverse=True, return_counts=True)
    of_rooms = np.bincount(index, squared, len(rooms)).astype(np.float64)
    rmse, total = np.sqrt(of_rooms / n_clouds), float(squared.sum())
    worst = [
        WorstRoom(int(rooms[i]), int(n_clouds[i]), ratio(float(of_rooms[i]), total), float(rmse[i]))
        for i in np.argsort(-of_rooms, kind="stable")[:N_WORST_ROOMS]
    ]
    return RoomFigures(name, WORST_SHARE, _share_of_worst(squared), _share_of_worst(of_rooms), tuple(worst))


def _share_of_worst(squared: ArrayF64) -> float | None:
    """What the worst `WORST_SHARE`, at least one, have of the sum."""
    n_worst = max(1, round(WORST_SHARE * len(squared)))
    return ratio(float(np.sort(squared)[::-1][:n_worst].sum()), float(squared.sum()))


@dataclass(frozen=True, eq=False)
class SeedCalibrations:
    """What makes a network's expected errors believable, for each of its seeds.

    Parameters
    ----------
    name : of the network
    by_seed : fitted to all validation clouds
    judges : by seed, for the rooms of even and of odd numbers. Where the report is of the validation split, each was
        fitted to the other half of its rooms: no cloud is judged by what saw its room.
    """

    name: str
    by_seed: tuple[Calibration, ...]
    judges: tuple[tuple[Calibration, Calibration], ...]

    @classmethod
    def fitted(
        cls, network: NetworkSeeds, held_out: Sequence[Group], *, is_crossed: bool = False
    ) -> SeedCalibrations | None:
        """Fitted to validation clouds; None for a network that expects no error or has too few clouds here."""
        cases, said = [group.cases for group in held_out], [network.of_group(group) for group in held_out]
        parity = np.concatenate([clouds.room for clouds in cases]) % 2
        expects_error = all(said) and all(one.raw_error is not None for of_group in said for one in of_group)
        if not expects_error or min(np.bincount(parity, minlength=2)) < 2:
            return None
        truth = np.concatenate([clouds.truth(network.target) for clouds in cases])
        coverage = np.concatenate([clouds.coverage for clouds in cases])
        by_seed, judges = [], []
        for of_seed in zip(*said, strict=True):
            made = rmse_of_each(np.concatenate([one.light for one in of_seed]), truth)
            raw = np.concatenate([one.raw_error for one in of_seed if one.raw_error is not None])
            known = raw, made, coverage
            by_seed.append(fit_calibration(*known))
            even, odd = (fit_calibration(*(part[parity == p] for part in known)) for p in (0, 1))
            judges.append((odd, even) if is_crossed else (by_seed[-1], by_seed[-1]))
        return cls(network.name, tuple(by_seed), tuple(judges))

    def expected(self, seed: int, raw: ArrayF64, clouds: CloudSet) -> tuple[ArrayF64, ArrayF64]:
        """(M,) expected errors, and (S, M) the errors promised for each share asked."""
        parity, judges = clouds.room % 2, self.judges[seed]
        errors = np.choose(parity, [one.expected(raw, clouds.coverage) for one in judges])
        multiples = np.array([one.quantiles for one in judges])[parity].T
        return errors, multiples * errors

    def figures(self, groups: Sequence[Group], predicted: Sequence[Predictions], target: Target) -> CalibrationRow:
        """Over the clouds of one view and all views together, by coverage and by table; mean and spread over seeds."""
        known = [(group, part[self.name]) for group, part in zip(groups, predicted, strict=True) if self.name in part]
        by_seed = [self._seed_figures(i, [(g, part[i]) for g, part in known], target) for i in range(len(self.by_seed))]
        return CalibrationRow(self.name, len(by_seed), self.by_seed, *over_seeds(by_seed))

    def _seed_figures(self, seed: int, known: list[tuple[Group, Prediction]], target: Target) -> CalibrationFigures:
        of_tables = []
        for group, predicted in known:
            raw = predicted.raw_error if predicted.raw_error is not None else np.zeros(len(group.cases))
            made = rmse_of_each(predicted.light, group.cases.truth(target))
            of_tables.append((*self.expected(seed, raw, group.cases), made))
        errors, limits, came = (np.concatenate(parts, axis=-1) for parts in zip(*of_tables, strict=True))
        # The first two tables are of the rooms that were split; what coverage does is asked of them alone.
        seen = np.concatenate([group.cases.coverage for group, _ in known[:2]])
        main = slice(len(seen))
        edges = [f"{a:.0%} to {b:.0%} seen" for a, b in itertools.pairwise(COVERAGE_EDGES)]
        by_coverage = dict(zip(edges, coverage_groups(seen), strict=True))
        figures = calibration_figures(errors[main], limits[:, main], came[main], by_coverage)
        of_table = np.repeat(np.arange(len(known)), [len(group.cases) for group, _ in known])
        by_table = {group.name: of_table == i for i, (group, _) in enumerate(known)}
        return replace(figures, tables=calibration_figures(errors, limits, came, by_table).groups)


def calibrate_network(network: Path, folders: Sequence[Path]) -> Calibration:
    """The calibration of one trained network by the validation clouds of one view and of all views, for its weights.

    ValueError if the file or the folders are broken, the network expects no error, or there are too few clouds.
    """
    seeds = load_alone(network)
    found = SeedCalibrations.fitted(seeds, [open_group(views, folders, "validation", views) for views in VIEWS])
    if found is None:
        raise ValueError(f"{network}: expected a network that knows its error, and validation clouds of several rooms")
    return found.by_seed[0]


def calibrate_elsewhere(
    network: Path, calibration: Calibration, folders: Sequence[Path]
) -> tuple[Calibration, tuple[float, ...]]:
    """`calibration` brought to the level of rooms of another kind, a folder of sampled clouds each, and how well its
    promises are kept in each of them by the level of the others.

    ValueError for fewer than two folders, for broken ones, and for a network that expects no error.
    """
    if len(folders) < 2:
        raise ValueError(f"--elsewhere: expected the sampled clouds of two rooms or more, got {len(folders)}")
    seeds, errors = load_alone(network), []
    for number, folder in enumerate(folders):
        clouds = open_split(folder, "test")
        (predicted,) = seeds.of_clouds(clouds)
        if predicted.raw_error is None or not len(clouds):
            raise ValueError(f"{folder}: expected clouds, and a network that knows its error")
        made = rmse_of_each(predicted.light, clouds.truth(seeds.target))
        errors.append(np.stack([predicted.raw_error, made, clouds.coverage, np.full(len(made), number)]))
    known = np.concatenate(errors, axis=1)
    return calibration_elsewhere(calibration, *known), promises_left_out(calibration, *known)


def stress_group(
    name: str, clouds: CloudSet, networks: Sequence[NetworkSeeds], baselines: Baselines,
    calibrations: Mapping[str, SeedCalibrations],
) -> StressGroup:  # fmt: skip
    """RMSE of `projection` and the lattice networks over `ambient`'s, and whether all lights are finite."""
    truth, basic, coverage = clouds.truth(baselines.target), baselines.lights(clouds), clouds.coverage
    of_ambient = pooled_rms(basic[AMBIENT] - truth)
    rows = [_stress_row(PROJECTION, 1, basic[PROJECTION], truth, of_ambient, None)]
    for network in networks:
        of_seeds = []
        for i, predicted in enumerate(network.of_clouds(clouds)):
            # As the estimator does in a session, where the frame's sensor is at hand.
            light = lean_on_sensor(predicted.light, coverage, basic[AMBIENT])
            expected = None
            if network.name in calibrations and predicted.raw_error is not None:
                expected = calibrations[network.name].expected(i, predicted.raw_error, clouds)[0]
            of_seeds.append(_stress_row(network.name, len(network.nets), light, truth, of_ambient, expected))
        mean, spread = over_seeds(of_seeds)
        is_finite = all(one.is_finite for one in of_seeds)
        is_within = is_finite and _is_within(mean.ratio)
        rows.append(replace(mean, is_finite=is_finite, is_within=is_within, spread=spread.ratio))
    seen = float(coverage.mean()) if len(coverage) else None
    return StressGroup(name, len(clouds), clouds.is_set.shape[1], seen, tuple(rows))


def _stress_row(
    name: str, n_seeds: int, light: ArrayF64, truth: NDArray[Any], of_ambient: float | None, expected: ArrayF64 | None
) -> StressRow:
    """Of one of the seeds."""
    is_finite = bool(np.isfinite(light).all())
    rmse = pooled_rms(light - truth) if is_finite else None
    kept = None
    if expected is not None and is_finite and len(truth):
        kept = ratio(float(expected.mean()), float(rmse_of_each(light, truth).mean()))
    over_ambient = ratio(rmse, of_ambient)
    return StressRow(rmse, over_ambient, is_finite, is_finite and _is_within(over_ambient), kept, name, n_seeds)


def _is_within(over_ambient: float | None) -> bool:
    return over_ambient is None or over_ambient <= STRESS_LIMIT
