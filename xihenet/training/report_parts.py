"""Parts of the report, made of clouds and of what predictors say of them.

Pure functions from predictions to plain figures (numbers, None, lists and dictionaries), of one seed first and then
their mean and spread, so that every number of a table has its spread. Where the clouds of a part are none, its figures
are None.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.estimators.base import Target
from xihenet.estimators.calibration import Calibration
from xihenet.estimators.lattice import lean_on_sensor
from xihenet.records import ArrayBool, ArrayF64, ArrayInt
from xihenet.training.baselines import AMBIENT, MEAN, PROJECTION, Baselines
from xihenet.training.calibration import calibration_figures, fit_calibration
from xihenet.training.dataset import CloudSet
from xihenet.training.groups import Group, coverage_of, open_group
from xihenet.training.networks import load_network
from xihenet.training.predictions import NetworkSeeds, Prediction, Predictions, load_seeds, over_seeds, predict_clouds
from xihenet.training.scores import (
    COVERAGE_EDGES,
    Scores,
    coverage_groups,
    pooled_rms,
    ratio,
    rmse_of_each,
    score_lights,
)
from xihenet.training.stress import STRESS_LIMIT

CURVE_EDGES = tuple(i / 20 for i in range(21))
FEWEST_IN_BIN = 10
WORST_SHARE = 0.05
N_WORST_ROOMS = 5


def group_table(group: Group, predicted: Predictions, target: Target) -> dict[str, Any]:
    """One table: what the clouds are, and a row for each predictor with mean and spread of its figures."""
    rows = []
    for name, seeds in predicted.items():
        mean, spread = over_seeds(prediction_figures(group, predicted, seeds, target))
        rows.append({"name": name, "n_seeds": len(seeds), "figures": mean, "spread": spread})
    quantiles = np.quantile(group.coverage, (0.05, 0.5, 0.95)).tolist() if len(group.cases) else [None] * 3
    return {
        "name": group.name,
        "n_clouds": len(group.cases),
        "n_rooms": len(np.unique(group.cases.room)),
        "coverage": dict(zip(("p5", "p50", "p95"), quantiles, strict=True)),
        "n_in_coverage": [int(mask.sum()) for mask in coverage_groups(group.coverage)],
        "rows": rows,
    }


def prediction_figures(
    group: Group, predicted: Predictions, seeds: Sequence[Prediction], target: Target
) -> list[dict[str, Any]]:
    """For each seed all its scores, and those of coefficients divided by the mean predictor's on the same clouds."""
    truth, coverage = group.cases.truth(target), group.coverage
    yardstick = score_lights(predicted[MEAN][0].light, truth, coverage)
    return [_beside(score_lights(seed.light, truth, coverage), yardstick) for seed in seeds]


def coverage_curve(groups: Sequence[Group], predicted: Predictions, target: Target) -> dict[str, Any]:
    """Ratio of every predictor in narrow bins of coverage, over all clouds of the groups; None where clouds are few."""
    truth = np.concatenate([group.cases.truth(target) for group in groups])
    coverage = np.concatenate([group.coverage for group in groups])
    bins = coverage_groups(coverage, CURVE_EDGES)
    yardstick = rmse_of_each(predicted[MEAN][0].light, truth)
    curves = {}
    for name, seeds in predicted.items():
        of_each = [rmse_of_each(seed.light, truth) for seed in seeds]
        mean, spread = over_seeds([[_ratio_in_bin(made, yardstick, b) for b in bins] for made in of_each])
        curves[name] = {"ratio": mean, "spread": spread}
    return {
        "edges": list(CURVE_EDGES),
        "coverage": [float(coverage[b].mean()) if b.any() else None for b in bins],
        "n_clouds": [int(b.sum()) for b in bins],
        "rows": curves,
    }


def room_figures(group: Group, name: str, seeds: Sequence[Prediction], target: Target) -> dict[str, Any]:
    """How unevenly the squared error, the mean over seeds, is spread over clouds and over rooms."""
    truth, room = group.cases.truth(target), group.cases.room
    squared = np.mean([rmse_of_each(seed.light, truth) ** 2 for seed in seeds], axis=0)
    names, index = np.unique(room, return_inverse=True)
    of_rooms, n_clouds = (
        np.bincount(index, squared, len(names)).astype(np.float64),
        np.bincount(index, minlength=len(names)),
    )
    total = float(squared.sum())
    worst = np.argsort(-of_rooms, kind="stable")[:N_WORST_ROOMS]
    return {
        "name": name,
        "worst_share": WORST_SHARE,
        "of_worst_clouds": _share_of_worst(squared),
        "of_worst_rooms": _share_of_worst(of_rooms),
        "worst_rooms": [
            {
                "room": int(names[i]),
                "n_clouds": int(n_clouds[i]),
                "share": ratio(float(of_rooms[i]), total),
                "rmse": float(np.sqrt(of_rooms[i] / n_clouds[i])),
            }
            for i in worst
        ],
    }


@dataclass(frozen=True, eq=False)
class SeedCalibrations:
    """What makes a network's expected errors believable, for each of its seeds.

    Parameters
    ----------
    name : of the network
    by_seed : fitted to all validation clouds
    halves : by seed, fitted to the validation rooms of even and of odd numbers; None where the report is of another
        split. A validation cloud is judged by the half that its room was not in.
    """

    name: str
    by_seed: tuple[Calibration, ...]
    halves: tuple[tuple[Calibration, Calibration], ...] | None

    @classmethod
    def fitted(
        cls, network: NetworkSeeds, held_out: Sequence[Group], target: Target, device: str, is_crossed: bool
    ) -> SeedCalibrations | None:
        """Fitted to validation clouds; None for a network that expects no error or has too few clouds here."""
        parts = [network.predictions(group, target, device) for group in held_out]
        truth = np.concatenate([group.cases.truth(target) for group in held_out])
        parity = _parity(np.concatenate([group.cases.room for group in held_out]))
        coverage = np.concatenate([group.coverage for group in held_out])
        by_seed, halves = [], []
        for i in range(len(network.nets)):
            of_seed = [part[i] for part in parts if part is not None]
            raw = [one.raw_error for one in of_seed if one.raw_error is not None]
            if len(raw) != len(held_out) or min(np.bincount(parity, minlength=2)) < 2:
                return None
            raw_error = np.concatenate(raw)
            made = rmse_of_each(np.concatenate([one.light for one in of_seed]), truth)
            by_seed.append(fit_calibration(raw_error, made, coverage))
            even, odd = (fit_calibration(*(part[parity == p] for part in (raw_error, made, coverage))) for p in (0, 1))
            halves.append((even, odd))
        return cls(network.name, tuple(by_seed), tuple(halves) if is_crossed else None)

    def expected(self, seed: int, raw: ArrayF64, coverage: ArrayF64, room: ArrayInt) -> tuple[ArrayF64, ArrayF64]:
        """(M,) expected errors, and (S, M) the errors promised for each share asked."""
        if self.halves is None:
            errors = self.by_seed[seed].expected(raw, coverage)
            return errors, np.outer(self.by_seed[seed].quantiles, errors)
        parity = _parity(room)
        by_other_half = [self.halves[seed][1 - p] for p in (0, 1)]
        errors = np.choose(parity, [one.expected(raw, coverage) for one in by_other_half])
        multiples = np.array([one.quantiles for one in by_other_half])[parity].T
        return errors, multiples * errors

    def figures(self, groups: Sequence[Group], predicted: Sequence[Predictions], target: Target) -> dict[str, Any]:
        """Over the clouds of one view and all views together, by coverage and by table; mean and spread over seeds."""
        known = [(group, part[self.name]) for group, part in zip(groups, predicted, strict=True) if self.name in part]
        by_seed = [self._seed_figures(i, [(g, part[i]) for g, part in known], target) for i in range(len(self.by_seed))]
        mean, spread = over_seeds(by_seed)
        weights = [asdict(one) | {"quantiles": list(one.quantiles)} for one in self.by_seed]
        return {"name": self.name, "n_seeds": len(by_seed), "by_seed": weights, "figures": mean, "spread": spread}

    def _seed_figures(self, seed: int, known: list[tuple[Group, Prediction]], target: Target) -> dict[str, Any]:
        expected, promised, made, coverage, table = [], [], [], [], []
        for i, (group, predicted) in enumerate(known):
            raw = predicted.raw_error if predicted.raw_error is not None else np.zeros(len(group.cases))
            one, limits = self.expected(seed, raw, group.coverage, group.cases.room)
            expected.append(one)
            promised.append(limits)
            made.append(rmse_of_each(predicted.light, group.cases.truth(target)))
            coverage.append(group.coverage)
            table.append(np.full(len(group.cases), i))
        # The first two tables are of the rooms that were split; what coverage does is asked of them alone.
        n_main = sum(len(part) for part in made[:2])
        of_table, seen = np.concatenate(table), np.concatenate(coverage)[:n_main]
        edges = [f"{a:.0%} to {b:.0%} seen" for a, b in itertools.pairwise(COVERAGE_EDGES)]
        errors, limits, came = np.concatenate(expected), np.concatenate(promised, axis=1), np.concatenate(made)
        by_coverage = dict(zip(edges, coverage_groups(seen), strict=True))
        figures = calibration_figures(errors[:n_main], limits[:, :n_main], came[:n_main], by_coverage)
        by_table = {group.name: of_table == i for i, (group, _) in enumerate(known)}
        figures["tables"] = calibration_figures(errors, limits, came, by_table)["groups"]
        return figures


def calibrate_network(network: Path, folders: Sequence[Path], device: str = "cpu") -> Calibration:
    """The calibration of one trained network by the validation clouds of one view and of all views, for its weights.

    ValueError if the file or the folders are broken, the network expects no error, or there are too few clouds.
    """
    target = load_network(network, device).target
    seeds = load_seeds(network.stem, [network], target, device)
    held_out = [open_group(views, folders, "validation", views) for views in ("one", "merged")]
    found = SeedCalibrations.fitted(seeds, held_out, target, device, is_crossed=False)
    if found is None:
        raise ValueError(f"{network}: expected a network that knows its error, and validation clouds of several rooms")
    return found.by_seed[0]


def stress_group(
    name: str, clouds: CloudSet, networks: Sequence[NetworkSeeds], baselines: Baselines,
    calibrations: Mapping[str, SeedCalibrations], device: str,
) -> dict[str, Any]:  # fmt: skip
    """RMSE of `projection` and the lattice networks over `ambient`'s, and whether all lights are finite."""
    truth, basic, coverage = clouds.truth(baselines.target), baselines.lights(clouds), coverage_of(clouds)
    of_ambient = pooled_rms(basic[AMBIENT] - truth)
    rows = [{"name": PROJECTION, "n_seeds": 1, **_stress_row(Prediction(basic[PROJECTION]), truth, of_ambient, None)}]
    for network in networks:
        figures = []
        for i, net in enumerate(network.nets):
            predicted = predict_clouds(net, clouds, baselines.target, device)
            # As the estimator does in a session, where the frame's sensor is at hand.
            predicted = replace(predicted, light=lean_on_sensor(predicted.light, coverage, basic[AMBIENT]))
            expected = None
            if network.name in calibrations and predicted.raw_error is not None:
                expected = calibrations[network.name].expected(i, predicted.raw_error, coverage, clouds.room)[0]
            figures.append(_stress_row(predicted, truth, of_ambient, expected))
        mean, spread = over_seeds(figures)
        is_finite = all(one["is_finite"] for one in figures)
        is_within = is_finite and (mean["ratio"] is None or mean["ratio"] <= STRESS_LIMIT)
        row = {**mean, "spread": spread["ratio"], "is_finite": is_finite, "is_within": is_within}
        rows.append({"name": network.name, "n_seeds": len(network.nets), **row})
    seen = float(coverage.mean()) if len(coverage) else None
    return {"name": name, "n_clouds": len(clouds), "n_anchors": clouds.is_set.shape[1], "coverage": seen, "rows": rows}


def _stress_row(
    predicted: Prediction, truth: Any, of_ambient: float | None, expected: ArrayF64 | None
) -> dict[str, Any]:
    """`ratio` to ambient's RMSE, None if any light is not finite; expected over made errors where one is expected."""
    is_finite = bool(np.isfinite(predicted.light).all())
    rmse = pooled_rms(predicted.light - truth) if is_finite else None
    kept = None
    if expected is not None and is_finite and len(truth):
        kept = ratio(float(expected.mean()), float(rmse_of_each(predicted.light, truth).mean()))
    within = ratio(rmse, of_ambient)
    is_within = is_finite and (within is None or within <= STRESS_LIMIT)
    return {"rmse": rmse, "ratio": within, "is_finite": is_finite, "is_within": is_within, "expected_over_made": kept}


def _beside(scores: Scores, yardstick: Scores) -> dict[str, Any]:
    def ratios(above: Sequence[float | None], below: Sequence[float | None]) -> list[float | None]:
        return [ratio(a, b) for a, b in zip(above, below, strict=True)]

    return {
        "ratio": ratio(scores.rmse, yardstick.rmse),
        "ratio_by_band": ratios(scores.by_band, yardstick.by_band),
        "ratio_by_coverage": ratios(scores.by_coverage, yardstick.by_coverage),
        **scores.as_dict(),
    }


def _ratio_in_bin(made: ArrayF64, yardstick: ArrayF64, mask: ArrayBool) -> float | None:
    if np.count_nonzero(mask) < FEWEST_IN_BIN:
        return None
    return ratio(pooled_rms(made[mask]), pooled_rms(yardstick[mask]))


def _share_of_worst(squared: ArrayF64) -> float | None:
    """What the worst `WORST_SHARE`, at least one, have of the sum."""
    n_worst = max(1, round(WORST_SHARE * len(squared)))
    return ratio(float(np.sort(squared)[::-1][:n_worst].sum()), float(squared.sum()))


def _parity(room: ArrayInt) -> ArrayInt:
    """(M,) 0 for rooms of even, 1 for rooms of odd numbers."""
    parity: ArrayInt = np.asarray(room % 2, np.intp)
    return parity
