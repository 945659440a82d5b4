"""Predictions of each predictor, with each of its seeds, for the groups of clouds that the report's tables speak of.

A group is one set of cases (the same rooms, views and positions) with their clouds as each kind of network wants them:
sampled on the sphere, at random, or by farthest points, with some number of anchors. A folder of sampled clouds says
itself what it holds, so folders are given without further words, and those of one group must speak of the same cases.

Folders made for tests alone (`CacheSettings.is_test_only`) are read whatever split is asked for. Where their rooms are
those of the data set, as in walks, only the rooms of that split count: a walk through a training room would flatter,
and one through a test room is not to be looked at while developing. Scenes of others count whole.

A network stands in a report as a name with one file per seed, and is fed with the clouds it was made for: those of its
sampling and, where a table has several numbers of anchors, of the number named. Where a group lacks such clouds the
network is not in its table, rather than there with figures of something else. Baselines have one seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from torch import nn

from xihenet.estimators.base import Target
from xihenet.estimators.calibration import raw_error
from xihenet.estimators.lattice import given_light
from xihenet.records import ArrayF32, ArrayF64, ArrayInt
from xihenet.training.baselines import Baselines
from xihenet.training.dataset import CloudSet, open_split, read_cache
from xihenet.training.networks import KINDS, load_network, predict
from xihenet.training.rooms import Split, room_number, split_of
from xihenet.training.scores import Scores, rmse_of_each

Views = Literal["one", "merged"]
VIEWS: tuple[Views, ...] = get_args(Views)


@dataclass(frozen=True, eq=False)
class Prediction:
    """What one seed says of M cases, sampled on the sphere: light (M, 9, 3) and, where the network says it, its raw
    expected error (M,).
    """

    cases: CloudSet
    target: Target
    light: ArrayF64
    raw_error: ArrayF64 | None = None

    @property
    def truth(self) -> ArrayF32:
        """(M, 9, 3)."""
        return self.cases.truth(self.target)

    @cached_property
    def made(self) -> ArrayF64:
        """(M,) SHC RMSE of each light; raises as `checked_lights`."""
        return rmse_of_each(self.light, self.truth)

    @cached_property
    def scores(self) -> Scores:
        return Scores.of(self.light, self.truth, self.cases.coverage)


Predictions = Mapping[str, Sequence[Prediction]]
"""By predictor, one for each seed."""


@dataclass(frozen=True, eq=False)
class Group:
    """M cases, in memory, under the name of their table, and what predictors say of them once they were asked.

    `clouds` are by sampling and number of anchors, such as "sphere_1280", all of the same cases in the same order;
    `cases` are those that baselines see and that coverage is counted on, sampled on the sphere.
    """

    name: str
    cases: CloudSet
    clouds: Mapping[str, CloudSet]
    predicted: Predictions = field(default_factory=dict)


def open_group(
    name: str, folders: Sequence[Path], split: Split, views: Views, *, is_of_strangers: bool = False
) -> Group:
    """The cases of one view, or of merged views, of a split; of all rooms if `is_of_strangers` (scenes of others).

    ValueError if no folder is of the sphere or the folders do not hold the same cases.
    """
    clouds: dict[str, CloudSet] = {}
    for folder in folders:
        cache = read_cache(folder)
        opened = open_split(folder, "test" if cache.is_test_only else split)
        counts = np.asarray(opened.n_views) > 1 if views == "merged" else np.asarray(opened.n_views) == 1
        if cache.is_test_only and not is_of_strangers:
            counts &= np.isin(opened.room, [room_number(room) for room in cache.rooms if split_of(room) == split])
        clouds[f"{cache.sampling}_{cache.n_anchors}"] = _rows_of(opened, np.flatnonzero(counts))
    main = next((key for key in clouds if key.startswith("sphere")), None)
    if main is None:
        given = ", ".join(clouds) or "none"
        raise ValueError(f"{name}: expected a folder of clouds sampled on the sphere, got {given}")
    for key, other in clouds.items():
        if not np.array_equal(other.room, clouds[main].room):
            raise ValueError(f"{name}: expected the same cases in all folders, got others in {key} than in {main}")
    return Group(name, clouds[main], clouds)


def training_clouds(folders: Sequence[Path]) -> CloudSet:
    """What baselines are fitted to: the training pairs as they are, and the clouds merged of several views, of the
    first folder that is sampled on the sphere.

    Networks see changed copies of each pair as well. A linear fit gains nothing from these, and the mean light of the
    rooms is that of the rooms as they are.
    """
    folder = next(folder for folder in folders if read_cache(folder).sampling == "sphere")
    n_copies, clouds = read_cache(folder).changes_per_pair, open_split(folder, "train")
    room, is_merged = np.asarray(clouds.room), np.asarray(clouds.n_views) > 1
    # Pairs come first in each room, a block of copies each, the first of which is as it is.
    _, first, member = np.unique(room, return_index=True, return_inverse=True)
    index = np.arange(len(room)) - first[member]
    n_merged_before: ArrayInt = np.cumsum(is_merged)
    is_as_it_is = (index % n_copies == 0) & (n_merged_before == n_merged_before[first][member]) & ~is_merged
    return _rows_of(clouds, np.flatnonzero(is_as_it_is | is_merged))


def _rows_of(clouds: CloudSet, rows: ArrayInt) -> CloudSet:
    """Some clouds, read into memory."""
    return CloudSet(*(np.asarray(getattr(clouds, part.name)[rows]) for part in fields(CloudSet)))


@dataclass(frozen=True, eq=False)
class NetworkSeeds:
    """One row of the tables, with a network for each seed.

    `key` is that of the clouds it wants, see `Group`: only the sampling where no number of anchors was named.
    """

    name: str
    estimator: str
    key: str
    nets: tuple[nn.Module, ...]
    target: Target
    device: str = "cpu"

    def of_group(self, group: Group) -> list[Prediction]:
        """One for each seed; none if the group has no clouds for this network."""
        wanted = (c for k, c in group.clouds.items() if k == self.key or k.rpartition("_")[0] == self.key)
        clouds = next(wanted, None)
        return [] if clouds is None else self.of_clouds(clouds, group.cases)

    def of_clouds(self, clouds: CloudSet, cases: CloudSet) -> list[Prediction]:
        """One for each seed, from clouds of the `cases`, which are the same if the network sees the sphere."""
        predictions = []
        for net in self.nets:
            light, error = predict(net, clouds, self.target, self.device)
            if self.estimator == "lattice":
                light = given_light(light, clouds.coverage, self.target)
            raw = None if error is None else raw_error(error, light)
            predictions.append(Prediction(cases, self.target, light.astype(np.float64), raw))
        return predictions


def load_seeds(label: str, files: Sequence[Path], target: Target | None = None, device: str = "cpu") -> NetworkSeeds:
    """Networks of one kind; `label` is NAME or, to name clouds of one number of anchors, SAMPLING_ANCHORS:NAME.

    ValueError for a broken file, another target than `target` if one is given, different kinds, or clouds of another
    sampling.
    """
    key, _, name = label.rpartition(":")
    loaded = [load_network(file, device) for file in files]
    for file, trained in zip(files, loaded, strict=True):
        if target not in (None, trained.target):
            raise ValueError(f"{file}: expected a network trained for {target!r}, got {trained.target!r}")
        if trained.estimator != loaded[0].estimator:
            raise ValueError(f"{file}: expected {loaded[0].estimator} as the others of {name}, got {trained.estimator}")
    sampling = KINDS[loaded[0].estimator].sampling
    if key and key.split("_")[0] != sampling:
        raise ValueError(f"{label}: expected clouds of the sampling {sampling}, got {key}")
    nets = tuple(trained.net for trained in loaded)
    return NetworkSeeds(name, loaded[0].estimator, key or sampling, nets, loaded[0].target, device)


def predict_group(group: Group, baselines: Baselines, networks: Sequence[NetworkSeeds]) -> Group:
    """The group with what baselines, and then networks, say of it; those without clouds in it are left out."""
    lights = baselines.lights(group.cases).items()
    predicted = {name: [Prediction(group.cases, baselines.target, light)] for name, light in lights}
    of_networks = {network.name: said for network in networks if (said := network.of_group(group))}
    return replace(group, predicted=predicted | of_networks)


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
    mean = first if isinstance(first, int) and len(set(figures)) == 1 else float(np.mean(figures))
    return mean, float(np.std(figures, ddof=1)) if len(figures) > 1 else None
