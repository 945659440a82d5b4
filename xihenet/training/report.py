"""How good are the networks beside what needs no training, and where?

One table: SHC RMSE divided by the mean predictor's (which always says the mean light of the training rooms), so that
figures of different data can be compared. The baselines are fitted like the networks, on the training rooms: a scale
and an offset for the ambient light, and a regularised linear fit on top of the projection, which is a serious baseline.
Rows are pooled over all coefficients of all clouds, as the paper's figures are. The test split is for this alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.estimators.ambient import constant_light
from xihenet.estimators.base import Target
from xihenet.records import ArrayBool, ArrayF64, UnitSphereCloud
from xihenet.sh import project_anchors
from xihenet.sh_basis import band_slice
from xihenet.sphere import AnchorLattice
from xihenet.training.dataset import CloudSet, open_split
from xihenet.training.networks import load_network, predict
from xihenet.training.rooms import Split

COVERAGE_EDGES = (0.0, 0.25, 0.4, 0.55, 0.7, 1.0)
RIDGE = 3.0
"""Penalty of the linear fits in clouds: that many clouds' worth of belief in the mean."""

SHARES_ASKED = (0.5, 0.68, 0.9)


@dataclass(frozen=True, eq=False)
class Row:
    """One predictor's errors, each divided by the mean predictor's on the same clouds; None where there are no clouds.

    Parameters
    ----------
    ratio : over all clouds
    by_band : of l = 0, 1, 2
    by_coverage : of clouds between the `COVERAGE_EDGES`
    calibration : for each of `SHARES_ASKED`, the share of clouds whose error is within the multiple of the expected
        error that held that share of the validation clouds; empty where no error is expected
    """

    name: str
    ratio: float | None
    by_band: tuple[float | None, ...]
    by_coverage: tuple[float | None, ...]
    calibration: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Report:
    """A table for one split and kind of cloud, and what it was made of."""

    split: Split
    target: Target
    n_clouds: int
    n_rooms: int
    mean_predictor_rmse: float | None
    rows: list[Row] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """For JSON: numbers, strings and None."""
        head = {name: getattr(self, name) for name in ("split", "target", "n_clouds", "n_rooms", "mean_predictor_rmse")}
        return {**head, "coverage_edges": list(COVERAGE_EDGES), "rows": [vars(row) for row in self.rows]}

    def as_markdown(self) -> str:
        """The table as text."""
        edges = itertools.pairwise(COVERAGE_EDGES)
        columns = ["predictor", "all", "l = 0", "l = 1", "l = 2", *(f"{a:.0%} to {b:.0%} seen" for a, b in edges)]
        lines = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
        for row in self.rows:
            cells = [_cell(value) for value in (row.ratio, *row.by_band, *row.by_coverage)]
            lines.append(f"| {row.name} | {' | '.join(cells)} |")
        notes = [f"{r.name}: of errors promised for {_percent(SHARES_ASKED)} came {_percent(r.calibration)}"
                 for r in self.rows if r.calibration]  # fmt: skip
        head = (
            f"{self.split}, {self.target}: {self.n_clouds} clouds of {self.n_rooms} rooms, SHC RMSE / mean predictor's"
        )
        return "\n".join([head, "", *lines, "", *notes])


def make_report(
    caches: Mapping[str, Path], networks: Mapping[str, Path], *, split: Split = "test", target: Target = "ldr",
    is_merged: bool = False, device: str = "cpu",
) -> Report:  # fmt: skip
    """The table for clouds of one view, or of all views of a room if `is_merged`.

    Parameters
    ----------
    caches : folder of sampled clouds by sampling; "sphere" must be there, "uniform" and "farthest" for their networks
    networks : file of a trained network by the name of its row, `<sampling>:<name>` where that is not "sphere"

    Raises
    ------
    ValueError : for a missing cache, a file that is no network, or one that was trained for the other target
    """
    fitted_on, all_clouds = open_split(caches["sphere"], "train"), open_split(caches["sphere"], split)
    chosen = (all_clouds.n_views > 1) if is_merged else (all_clouds.n_views == 1)
    truth = all_clouds.truth(target)[chosen].astype(np.float64)
    coverage = all_clouds.is_set[chosen].mean(axis=1) if chosen.any() else np.zeros(0)
    mean_light = np.broadcast_to(fitted_on.truth(target).mean(axis=0, dtype=np.float64), truth.shape)
    yardstick = mean_light - truth
    n_rooms = len(np.unique(all_clouds.room[chosen]))
    report = Report(split, target, len(truth), n_rooms, _rms(yardstick))
    for name, light in _baselines(fitted_on, all_clouds, target).items():
        report.rows.append(_row(name, light[chosen] - truth, yardstick, coverage))
    for label, path in networks.items():
        sampling, _, name = label.rpartition(":")
        trained = load_network(path, device)
        if trained.target != target:
            raise ValueError(f"{path}: expected a network trained for {target!r}, got {trained.target!r}")
        clouds = open_split(caches[sampling or "sphere"], split)
        light, expected = predict(trained.net, clouds, target, device)
        row = _row(name, light[chosen] - truth, yardstick, coverage)
        if expected is not None and len(truth):
            limits = error_quantiles(path, caches[sampling or "sphere"], device)
            made = _per_cloud(light[chosen] - truth) / expected[chosen]
            row = replace(row, calibration=tuple(float(np.mean(made <= limit)) for limit in limits))
        report.rows.append(row)
    return report


def error_quantiles(network: Path, cache: Path, device: str = "cpu") -> tuple[float, ...]:
    """How many times the expected error holds each of `SHARES_ASKED` of the validation clouds, merged ones included.

    ValueError if the network expects no error or there are no validation clouds.
    """
    trained, clouds = load_network(network, device), open_split(cache, "validation")
    light, expected = predict(trained.net, clouds, trained.target, device)
    if expected is None or not len(clouds):
        raise ValueError(f"{network}: expected a network that knows its error, and validation clouds")
    made = _per_cloud(light - clouds.truth(trained.target).astype(np.float64)) / expected
    return tuple(float(np.quantile(made, share)) for share in SHARES_ASKED)


def projected(clouds: CloudSet) -> ArrayF64:
    """(M, 9, 3) what `projection` says of every cloud."""
    lattice = AnchorLattice(clouds.is_set.shape[1])
    lights = [
        project_anchors(UnitSphereCloud(srgb / np.float32(255), np.zeros(len(known), np.float32), known), lattice)
        for srgb, known in zip(clouds.srgb_u8, clouds.is_set, strict=True)
    ]
    return np.array(lights).reshape(-1, 9, 3)


def fit_linear(features: ArrayF64, truth: NDArray[Any]) -> ArrayF64:
    """(F + 1, 27) ridge regression from features (M, F) to coefficients (M, 9, 3), the offset unpenalised and last."""
    means, answers = features.mean(axis=0), truth.reshape(len(truth), -1).astype(np.float64)
    spread = features.std(axis=0) + 1e-9
    centred = (features - means) / spread
    gram = centred.T @ centred + RIDGE * np.eye(len(means))
    slopes = np.linalg.solve(gram, centred.T @ (answers - answers.mean(axis=0))) / spread[:, None]
    return np.vstack([slopes, answers.mean(axis=0) - means @ slopes])


def _baselines(fitted_on: CloudSet, clouds: CloudSet, target: Target) -> dict[str, ArrayF64]:
    """(M, 9, 3) of each predictor that is no network."""
    projection, of_training = projected(clouds), projected(fitted_on)
    truth = fitted_on.truth(target)
    return {
        "ambient": np.array([constant_light(a) for a in clouds.ambient.astype(np.float64)]).reshape(-1, 9, 3),
        "ambient, fitted": _apply_linear(fit_linear(fitted_on.ambient.astype(float), truth), clouds.ambient),
        "projection": projection,
        "projection, linear fit": _apply_linear(
            fit_linear(_projection_features(of_training, fitted_on), truth), _projection_features(projection, clouds)
        ),
    }


def _projection_features(projection: ArrayF64, clouds: CloudSet) -> ArrayF64:
    """(M, 55): the coefficients, and again times the share not seen, and that share."""
    unseen = 1 - clouds.is_set.mean(axis=1, keepdims=True)
    flat = projection.reshape(len(projection), 27)
    return np.concatenate([flat, flat * unseen, unseen], axis=1)


def _apply_linear(fit: ArrayF64, features: NDArray[Any]) -> ArrayF64:
    light: ArrayF64 = (features @ fit[:-1] + fit[-1]).reshape(-1, 9, 3)
    return light


def _row(name: str, error: ArrayF64, yardstick: ArrayF64, coverage: ArrayF64) -> Row:
    groups = [(coverage >= a) & ((coverage < b) | (b == 1)) for a, b in itertools.pairwise(COVERAGE_EDGES)]
    bands = [band_slice(band) for band in range(3)]
    return Row(
        name,
        _ratio(error, yardstick),
        tuple(_ratio(error[:, band], yardstick[:, band]) for band in bands),
        tuple(_ratio(error[group], yardstick[group]) for group in groups),
    )


def _per_cloud(error: ArrayF64) -> ArrayF64:
    """(M,) SHC RMSE of each cloud."""
    made: ArrayF64 = np.sqrt(np.mean(error**2, axis=(1, 2)))
    return made


def _ratio(error: ArrayF64, yardstick: ArrayF64) -> float | None:
    above, below = _rms(error), _rms(yardstick)
    return above / below if above is not None and below else None


def _rms(values: ArrayF64 | ArrayBool) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else None


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _percent(shares: Sequence[float]) -> str:
    return ", ".join(f"{share:.0%}" for share in shares)
