"""Report of the training: how good the networks are beside what needs no training, where, and what bounds them.

All figures of the tables, for one target: errors of every predictor on clouds of one view, on clouds of all views of a
room, and on whatever other groups are given (walks, scenes of others, the whole sphere); by coverage; by number of
training rooms; by room; of the networks' own expectation; and under disturbances. Errors are divided by those of the
mean predictor, which always says the mean light of the training rooms, on the same clouds, so that figures of different
data can be compared. The test split is for this alone; to develop, ask for the validation split.

Figures are made of one seed first and then their mean and spread, so that every number of a table has its spread. Where
the clouds of a part are none, its figures are None. `report_text` and `plots` show them.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from xihenet.estimators.base import Target
from xihenet.estimators.calibration import SHARES_ASKED
from xihenet.records import ArrayF64
from xihenet.training import stress
from xihenet.training.baselines import MEAN, Baselines, fit_baselines
from xihenet.training.calibration import CalibrationRow, SeedCalibrations
from xihenet.training.predictions import (
    VIEWS,
    Group,
    NetworkSeeds,
    Prediction,
    load_seeds,
    open_group,
    over_seeds,
    predict_group,
    training_clouds,
)
from xihenet.training.rooms import Split
from xihenet.training.scores import COVERAGE_EDGES, DOMINANT_SHARE, Scores, coverage_groups, pooled_rms, ratio
from xihenet.training.stress import StressGroup, stress_group

REPORT_VERSION = 2
ONE_VIEW, ALL_VIEWS, WALK, WHOLE = "one view", "all views of a room", "walk", "whole sphere"
CURVE_EDGES = tuple(i / 20 for i in range(21))
FEWEST_IN_BIN = 10
WORST_SHARE = 0.05
N_WORST_ROOMS = 5

Known = float | None


@dataclass(frozen=True)
class ReportSettings:
    """What a report is made of. Folders hold sampled clouds; one per sampling and number of anchors."""

    clouds: Sequence[Path]  # of the rooms that were trained on; the first of the sphere is what baselines see
    # Files by label, one for each seed; see `predictions.load_seeds`.
    networks: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    split: Split = "test"  # or "validation" to develop
    target: Target = "ldr"
    walks: Sequence[Path] = ()  # of which the merged clouds count
    whole: Sequence[Path] = ()  # of positions of which every direction is known
    # By the scene's name: all of its clouds of one view, and the merged ones.
    scenes: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    # By name, for the groups that need the rooms, such as other numbers of anchors.
    stress: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    # Files of networks by the number of rooms they were trained on.
    learning: Mapping[int, Sequence[Path]] = field(default_factory=dict)
    device: str = "cpu"


@dataclass(frozen=True)
class ReportHead:
    """What was judged, what the baselines were fitted to, and the definitions that the figures rest on."""

    split: Split
    target: Target
    n_rooms_fitted: int
    n_clouds_fitted: int
    coverage_edges: tuple[float, ...] = COVERAGE_EDGES
    shares_promised: tuple[float, ...] = SHARES_ASKED
    dominant_share: float = DOMINANT_SHARE
    stress_limit: float = stress.STRESS_LIMIT
    cap_share: float = stress.CAP_SHARE
    colour_noise: float = stress.COLOUR_NOISE
    distance_noise: float = stress.DISTANCE_NOISE


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
class LearningPoint:
    """Networks of so many training rooms: by group the mean of their ratio over seeds, and its deviation."""

    n_rooms: int
    n_seeds: int
    estimator: str
    groups: Mapping[str, tuple[float | None, float | None]]


@dataclass(frozen=True)
class Report:
    """All figures: one table per group of clouds, `calibration` for each network that expects an error."""

    head: ReportHead
    tables: tuple[Table, ...]
    curve: CoverageCurve
    learning: tuple[LearningPoint, ...]
    rooms: tuple[RoomFigures, ...]
    calibration: tuple[CalibrationRow, ...]
    stress: tuple[StressGroup, ...]


def report_json(report: Report) -> str:
    """As a file has it: strict JSON, with the groups of a learning point beside its other fields."""
    content = {"version": REPORT_VERSION, **asdict(report)}
    for point in content["learning"]:
        ratios = point.pop("groups")
        point |= {name: {"ratio": mean, "spread": spread} for name, (mean, spread) in ratios.items()}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def make_report(settings: ReportSettings, progress: Callable[[str], None] = lambda line: None) -> Report:
    """Predict and judge. ValueError for a missing or broken folder or file, or networks of another kind or target."""
    target, device = settings.target, settings.device
    groups = _groups(settings)
    networks = [load_seeds(label, files, target, device) for label, files in settings.networks.items()]
    progress("fitting the baselines")
    baselines = fit_baselines(training_clouds(settings.clouds), target)
    for i, group in enumerate(groups):
        progress(f"predicting {group.name}: {len(group.cases)} clouds")
        groups[i] = predict_group(group, baselines, networks)
    progress("calibrating, and disturbing clouds")
    calibrations = _calibrations(settings, networks)
    return Report(
        ReportHead(settings.split, target, baselines.n_rooms, baselines.n_clouds),
        tuple(map(group_table, groups)),
        coverage_curve(groups[:2]),
        tuple(_learning(settings, groups[:2])),
        tuple(itertools.starmap(room_figures, groups[0].predicted.items())),
        tuple(one.figures(groups) for one in calibrations.values()),
        tuple(_stress(settings, groups[0], networks, baselines, calibrations)),
    )


def _groups(settings: ReportSettings) -> list[Group]:
    """One view and all views first; then what else is given."""
    clouds, split = settings.clouds, settings.split
    groups = [open_group(ONE_VIEW, clouds, split, "one"), open_group(ALL_VIEWS, clouds, split, "merged")]
    if settings.walks:
        groups.append(open_group(WALK, settings.walks, split, "merged"))
    for name, folders in settings.scenes.items():
        groups.append(open_group(f"{name}, {ONE_VIEW}", folders, split, "one", is_of_strangers=True))
        groups.append(open_group(f"{name}, all views", folders, split, "merged", is_of_strangers=True))
    if settings.whole:
        groups.append(open_group(WHOLE, settings.whole, split, "merged"))
    return groups


def _learning(settings: ReportSettings, groups: Sequence[Group]) -> list[LearningPoint]:
    points = []
    for n_rooms, files in sorted(settings.learning.items()):
        seeds = load_seeds(f"{n_rooms} rooms", files, settings.target, settings.device)
        ratios = {}
        for group in groups:
            figures = prediction_figures(group, seeds.of_group(group))
            ratios[group.name] = over_seeds([one.ratio for one in figures] or [None])
        points.append(LearningPoint(n_rooms, len(files), seeds.estimator, ratios))
    return points


def _calibrations(settings: ReportSettings, networks: Sequence[NetworkSeeds]) -> dict[str, SeedCalibrations]:
    """Of the networks that expect an error, fitted to the validation clouds of one view and of all views."""
    held_out = [open_group(views, settings.clouds, "validation", views) for views in VIEWS]
    is_crossed = settings.split == "validation"
    found = (SeedCalibrations.fitted(network, held_out, is_crossed=is_crossed) for network in networks)
    return {one.name: one for one in found if one is not None}


def _stress(
    settings: ReportSettings, group: Group, networks: Sequence[NetworkSeeds], baselines: Baselines,
    calibrations: Mapping[str, SeedCalibrations],
) -> list[StressGroup]:  # fmt: skip
    """Each disturbance of the clouds of one view, and each group of clouds that were sampled otherwise."""
    clouds = {"undisturbed": group.cases}
    for i, (name, disturb) in enumerate(stress.DISTURBANCES.items()):
        clouds[name] = disturb(group.cases, np.random.default_rng([0, i]))
    for name, folders in settings.stress.items():
        clouds[name] = open_group(name, folders, settings.split, "one").cases
    of_lattice = [network for network in networks if network.estimator == "lattice"]
    return [stress_group(name, some, of_lattice, baselines, calibrations) for name, some in clouds.items()]


def group_table(group: Group) -> Table:
    """What the clouds are, and a row for each predictor."""
    rows = [
        TableRow(name, len(seeds), *over_seeds(prediction_figures(group, seeds)))
        for name, seeds in group.predicted.items()
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


def prediction_figures(group: Group, seeds: Sequence[Prediction]) -> list[Figures]:
    """For each of the `seeds`, which say something of the group's cases."""
    yardstick, figures = group.predicted[MEAN][0].scores, []
    for own in (seed.scores for seed in seeds):
        by_band = tuple(map(ratio, own.by_band, yardstick.by_band))
        by_coverage = tuple(map(ratio, own.by_coverage, yardstick.by_coverage))
        whole = ratio(own.rmse, yardstick.rmse)
        figures.append(Figures(**vars(own), ratio=whole, ratio_by_band=by_band, ratio_by_coverage=by_coverage))
    return figures


def coverage_curve(groups: Sequence[Group]) -> CoverageCurve:
    """Ratio in narrow bins of coverage, over all clouds of the groups, of the predictors that all groups have."""
    coverage = np.concatenate([group.cases.coverage for group in groups])
    bins = coverage_groups(coverage, CURVE_EDGES)

    def errors(name: str) -> list[list[float | None]]:
        """Of each seed by bin, None where clouds are few."""
        seeds = zip(*(group.predicted[name] for group in groups), strict=True)
        by_seed = [np.concatenate([of_group.made for of_group in seed]) for seed in seeds]
        return [[pooled_rms(made[b]) if b.sum() >= FEWEST_IN_BIN else None for b in bins] for made in by_seed]

    yardstick, rows = errors(MEAN)[0], {}
    for name in groups[0].predicted:
        if all(name in group.predicted for group in groups):
            rows[name] = Ratios(*over_seeds([tuple(map(ratio, made, yardstick)) for made in errors(name)]))
    seen = tuple(float(coverage[b].mean()) if b.any() else None for b in bins)
    return CoverageCurve(CURVE_EDGES, seen, tuple(int(b.sum()) for b in bins), rows)


def room_figures(name: str, seeds: Sequence[Prediction]) -> RoomFigures:
    """How unevenly the squared error, the mean over seeds, is spread over clouds and over rooms."""
    squared = np.mean([seed.made**2 for seed in seeds], axis=0)
    rooms, index, n_clouds = np.unique(seeds[0].cases.room, return_inverse=True, return_counts=True)
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
