"""Predictions of each predictor, with each of its seeds, for a group of clouds.

A network stands in a report as a name with one file per seed, and is fed with the clouds it was made for: those of its
sampling and, where a table has several numbers of anchors, of the number named. Where a group lacks such clouds the
network is not in its table, rather than there with figures of something else. Baselines have one seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from xihenet.estimators.base import Target
from xihenet.records import ArrayF64
from xihenet.training.baselines import Baselines
from xihenet.training.dataset import CloudSet
from xihenet.training.groups import Group
from xihenet.training.networks import SAMPLING_OF, load_network, predict


@dataclass(frozen=True, eq=False)
class Prediction:
    """Of M clouds by one seed: light (M, 9, 3) and, where the network says it, its raw expected error (M,)."""

    light: ArrayF64
    raw_error: ArrayF64 | None = None


Predictions = Mapping[str, Sequence[Prediction]]
"""By predictor, one for each seed."""


@dataclass(frozen=True, eq=False)
class NetworkSeeds:
    """One row of the tables.

    Parameters
    ----------
    name : of the row
    estimator : lattice, xihenet, pointar or farthest
    key : of the clouds it wants, see `Group`; only the sampling where no number of anchors was named
    nets : one for each seed
    """

    name: str
    estimator: str
    key: str
    nets: tuple[nn.Module, ...]

    def predictions(self, group: Group, target: Target, device: str = "cpu") -> list[Prediction] | None:
        """One for each seed; None if the group has no clouds for this network."""
        wanted = (c for k, c in group.clouds.items() if k == self.key or k.rpartition("_")[0] == self.key)
        clouds = next(wanted, None)
        return None if clouds is None else [predict_clouds(net, clouds, target, device) for net in self.nets]


def load_seeds(label: str, files: Sequence[Path], target: Target, device: str) -> NetworkSeeds:
    """Networks of one kind; `label` is NAME or, to name clouds of one number of anchors, SAMPLING_ANCHORS:NAME.

    ValueError for a broken file, another target than `target`, different kinds, or clouds of another sampling.
    """
    key, _, name = label.rpartition(":")
    loaded = [load_network(file, device) for file in files]
    for file, trained in zip(files, loaded, strict=True):
        if trained.target != target:
            raise ValueError(f"{file}: expected a network trained for {target!r}, got {trained.target!r}")
        if trained.estimator != loaded[0].estimator:
            raise ValueError(f"{file}: expected {loaded[0].estimator} as the others of {name}, got {trained.estimator}")
    sampling = SAMPLING_OF[loaded[0].estimator]
    if key and key.split("_")[0] != sampling:
        raise ValueError(f"{label}: expected clouds of the sampling {sampling}, got {key}")
    return NetworkSeeds(name, loaded[0].estimator, key or sampling, tuple(trained.net for trained in loaded))


def predict_group(
    group: Group, baselines: Baselines, networks: Sequence[NetworkSeeds], target: Target, device: str = "cpu"
) -> dict[str, list[Prediction]]:
    """By predictor, baselines first, one prediction per seed; networks without clouds in the group are left out."""
    predicted = {name: [Prediction(light)] for name, light in baselines.lights(group.cases).items()}
    for seeds in networks:
        of_network = seeds.predictions(group, target, device)
        if of_network is not None:
            predicted[seeds.name] = of_network
    return predicted


def predict_clouds(net: nn.Module, clouds: CloudSet, target: Target, device: str = "cpu") -> Prediction:
    """What one network says of clouds."""
    light, raw_error = predict(net, clouds, target, device)
    return Prediction(light.astype(np.float64), None if raw_error is None else raw_error.astype(np.float64))


def joined(parts: Sequence[Predictions]) -> dict[str, list[Prediction]]:
    """Predictions of several groups, one after the other, of the predictors that are in all of them."""
    names = [name for name in parts[0] if all(name in part for part in parts)]
    return {name: [_joined_seed(seeds) for seeds in zip(*(p[name] for p in parts), strict=True)] for name in names}


def over_seeds(figures: Sequence[Any]) -> tuple[Any, Any]:
    """Mean and standard deviation of each number in nested figures of several seeds, as figures of the same shape.

    Records, dictionaries and tuples. Words and truth values stay as the first seed has them. The deviation is that of a
    sample: None for one seed. What is None in any seed is None in both.
    """
    first = figures[0]
    if is_dataclass(first) and not isinstance(first, type):
        mean, spread = over_seeds([vars(one) for one in figures])
        return replace(first, **mean), replace(first, **spread)
    if isinstance(first, dict):
        parts = {key: over_seeds([one[key] for one in figures]) for key in first}
        return {key: part[0] for key, part in parts.items()}, {key: part[1] for key, part in parts.items()}
    if isinstance(first, tuple):
        pairs = [over_seeds(values) for values in zip(*figures, strict=True)]
        return tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)
    if isinstance(first, (str, bool)):
        return first, None
    if any(one is None for one in figures):
        return None, None
    if len(set(figures)) == 1 and isinstance(first, int):
        return first, None if len(figures) == 1 else 0.0
    return float(np.mean(figures)), float(np.std(figures, ddof=1)) if len(figures) > 1 else None


def _joined_seed(parts: Sequence[Prediction]) -> Prediction:
    errors = [part.raw_error for part in parts if part.raw_error is not None]
    light = np.concatenate([part.light for part in parts])
    return Prediction(light, np.concatenate(errors) if len(errors) == len(parts) else None)
