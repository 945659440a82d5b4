"""Report of the training: how good the networks are beside what needs no training, where, and what bounds them.

All figures of the tables, for one target: errors of every predictor on clouds of one view, on clouds of all views of a
room, and on whatever other groups are given (walks, scenes of others, the whole sphere); by coverage; by number of
training rooms; by room; of the networks' own expectation; and under disturbances. Errors are divided by those of the
mean predictor, which always says the mean light of the training rooms, on the same clouds, so that figures of different
data can be compared. The test split is for this alone; to develop, ask for the validation split.

Here it is predicted what a report is made of; `report_parts` makes the figures, `report_text` and `plots` show them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from xihenet.estimators.base import Target
from xihenet.estimators.calibration import SHARES_ASKED
from xihenet.training import report_parts as parts
from xihenet.training.baselines import Baselines, fit_baselines
from xihenet.training.predictions import (
    VIEWS,
    Group,
    NetworkSeeds,
    Predictions,
    load_seeds,
    open_group,
    over_seeds,
    predict_group,
    training_clouds,
)
from xihenet.training.rooms import Split
from xihenet.training.scores import COVERAGE_EDGES, DOMINANT_SHARE
from xihenet.training.stress import CAP_SHARE, COLOUR_NOISE, DISTANCE_NOISE, DISTURBANCES, STRESS_LIMIT

REPORT_VERSION = 2
ONE_VIEW, ALL_VIEWS, WALK, WHOLE = "one view", "all views of a room", "walk", "whole sphere"


@dataclass(frozen=True)
class ReportSettings:
    """What a report is made of. Folders hold sampled clouds; one per sampling and number of anchors.

    Parameters
    ----------
    clouds : of the rooms that were trained on; the first of the sphere is what baselines see
    networks : files by label, one for each seed; see `predictions.load_seeds`
    split : "test", or "validation" to develop
    walks, whole : clouds of walks, whose merged ones count, and of positions of which every direction is known
    scenes : folders by the scene's name; all of its clouds of one view, and the merged ones
    stress : folders by name, for the groups that need the rooms, such as other numbers of anchors
    learning : files of networks by the number of rooms they were trained on
    """

    clouds: Sequence[Path]
    networks: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    split: Split = "test"
    target: Target = "ldr"
    walks: Sequence[Path] = ()
    whole: Sequence[Path] = ()
    scenes: Mapping[str, Sequence[Path]] = field(default_factory=dict)
    stress: Mapping[str, Sequence[Path]] = field(default_factory=dict)
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
    stress_limit: float = STRESS_LIMIT
    cap_share: float = CAP_SHARE
    colour_noise: float = COLOUR_NOISE
    distance_noise: float = DISTANCE_NOISE


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
    tables: tuple[parts.Table, ...]
    curve: parts.CoverageCurve
    learning: tuple[LearningPoint, ...]
    rooms: tuple[parts.RoomFigures, ...]
    calibration: tuple[parts.CalibrationRow, ...]
    stress: tuple[parts.StressGroup, ...]


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
    baselines, predicted = fit_baselines(training_clouds(settings.clouds), target), []
    for group in groups:
        progress(f"predicting {group.name}: {len(group.cases)} clouds")
        predicted.append(predict_group(group, baselines, networks))
    progress("calibrating, and disturbing clouds")
    calibrations = _calibrations(settings, networks)
    return Report(
        ReportHead(settings.split, target, baselines.n_rooms, baselines.n_clouds),
        tuple(parts.group_table(group, one, target) for group, one in zip(groups, predicted, strict=True)),
        parts.coverage_curve(groups[:2], predicted[:2], target),
        tuple(_learning(settings, groups[:2], predicted[:2])),
        tuple(parts.room_figures(groups[0], name, seeds, target) for name, seeds in predicted[0].items()),
        tuple(one.figures(groups, predicted, target) for one in calibrations.values()),
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


def _learning(
    settings: ReportSettings, groups: Sequence[Group], predicted: Sequence[Predictions]
) -> list[LearningPoint]:
    points = []
    for n_rooms, files in sorted(settings.learning.items()):
        seeds = load_seeds(f"{n_rooms} rooms", files, settings.target, settings.device)
        ratios = {}
        for group, known in zip(groups, predicted, strict=True):
            figures = parts.prediction_figures(group, known, seeds.of_group(group), settings.target)
            ratios[group.name] = over_seeds([one.ratio for one in figures] or [None])
        points.append(LearningPoint(n_rooms, len(files), seeds.estimator, ratios))
    return points


def _calibrations(settings: ReportSettings, networks: Sequence[NetworkSeeds]) -> dict[str, parts.SeedCalibrations]:
    """Of the networks that expect an error, fitted to the validation clouds of one view and of all views."""
    held_out = [open_group(views, settings.clouds, "validation", views) for views in VIEWS]
    is_crossed = settings.split == "validation"
    found = (parts.SeedCalibrations.fitted(network, held_out, is_crossed=is_crossed) for network in networks)
    return {one.name: one for one in found if one is not None}


def _stress(
    settings: ReportSettings, group: Group, networks: Sequence[NetworkSeeds], baselines: Baselines,
    calibrations: Mapping[str, parts.SeedCalibrations],
) -> list[parts.StressGroup]:  # fmt: skip
    """Each disturbance of the clouds of one view, and each group of clouds that were sampled otherwise."""
    clouds = {"undisturbed": group.cases}
    for i, (name, disturb) in enumerate(DISTURBANCES.items()):
        clouds[name] = disturb(group.cases, np.random.default_rng([0, i]))
    for name, folders in settings.stress.items():
        clouds[name] = open_group(name, folders, settings.split, "one").cases
    of_lattice = [network for network in networks if network.estimator == "lattice"]
    return [parts.stress_group(name, some, of_lattice, baselines, calibrations) for name, some in clouds.items()]
