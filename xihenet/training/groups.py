"""Groups of clouds that the report's tables speak of, and the folders they lie in.

A group is one set of cases (the same rooms, views and positions) with their clouds as each kind of network wants them:
sampled on the sphere, at random, or by farthest points, with some number of anchors. A folder of sampled clouds says
itself what it holds, so folders are given without further words, and those of one group must speak of the same cases.

Folders made for tests alone (`CacheSettings.is_test_only`) are read whatever split is asked for. Where their rooms are
those of the data set, as in walks, only the rooms of that split count: a walk through a training room would flatter,
and one through a test room is not to be looked at while developing. Scenes of others count whole.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import numpy as np

from xihenet.records import ArrayF64, ArrayInt
from xihenet.training.dataset import CloudSet, open_split, read_cache
from xihenet.training.rooms import Split, split_of

Views = Literal["one", "merged"]


@dataclass(frozen=True, eq=False)
class Group:
    """M cases, in memory.

    Parameters
    ----------
    name : of the table
    main : key of the clouds that baselines see and that coverage is counted on, sampled on the sphere
    clouds : by sampling and number of anchors, such as "sphere_1280"; all of the same cases in the same order
    """

    name: str
    main: str
    clouds: Mapping[str, CloudSet]

    @property
    def cases(self) -> CloudSet:
        """The clouds of `main`."""
        return self.clouds[self.main]

    @property
    def coverage(self) -> ArrayF64:
        """(M,) share of the anchors that are set."""
        return self.cases.coverage


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
            counts &= np.isin(opened.room, [room[1] for room in cache.rooms if split_of(room) == split])
        clouds[f"{cache.sampling}_{cache.n_anchors}"] = _rows_of(opened, np.flatnonzero(counts))
    main = next((key for key in clouds if key.startswith("sphere")), None)
    if main is None:
        raise ValueError(
            f"{name}: expected a folder of clouds sampled on the sphere, got {', '.join(clouds) or 'none'}"
        )
    for key, other in clouds.items():
        if not np.array_equal(other.room, clouds[main].room):
            raise ValueError(f"{name}: expected the same cases in all folders, got others in {key} than in {main}")
    return Group(name, main, clouds)


def main_folder(folders: Sequence[Path]) -> Path:
    """The first folder that is sampled on the sphere: what baselines are fitted to and see. ValueError without one."""
    found = next((folder for folder in folders if read_cache(folder).sampling == "sphere"), None)
    if found is None:
        raise ValueError(f"expected a folder of clouds sampled on the sphere, got {', '.join(map(str, folders))}")
    return found


def training_clouds(folder: Path) -> CloudSet:
    """What baselines are fitted to: the training pairs as they are, and the clouds merged of several views.

    Networks see changed copies of each pair as well. A linear fit gains nothing from these, and the mean light of the
    rooms is that of the rooms as they are.
    """
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
    return CloudSet(**{part.name: np.asarray(getattr(clouds, part.name)[rows]) for part in fields(CloudSet)})
