"""How do rooms become clouds with the light they should give, once and not once per epoch?

Each pair of a view and a position in it becomes one cloud, unturned: those are what tables report on, as the paper
does. Training gets more of each: the raw points turned about the vertical by a random angle, the light turned alike,
and then sampled, so that a turned room meets the anchors as a real one would; and clouds merged from several views,
as after a walk. All of a split lies in memory-mapped arrays: an epoch reads, it does not sample.

Rejected: turning sampled clouds by moving anchors, which leaves holes, and sampling in the loop, which costs more than
the network.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from xihenet.buffers import merge
from xihenet.records import ArrayF64, PointCloud, UnitSphereCloud
from xihenet.sampling import sample_farthest, sample_uniform, sample_unit_sphere
from xihenet.sh import rotate
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import (
    SPLITS,
    Split,
    TrainingRoom,
    pairs_that_count,
    read_room,
    room_files,
    room_seed,
    split_of,
)

Sampling = Literal["sphere", "uniform", "farthest"]
SAMPLINGS: tuple[Sampling, ...] = ("sphere", "uniform", "farthest")
CACHE_VERSION = 1
_MAX_DISTANCE_M = 65504.0


@dataclass(frozen=True)
class CacheSettings:
    """What is derived from the rooms.

    Parameters
    ----------
    n_anchors : anchors, or points of the other samplings
    sampling : unit sphere, uniform random points (pointar) or farthest points
    turns_per_pair : training clouds of each pair, the first unturned
    merged_per_position : training clouds of each position merged from 1 to V views; elsewhere one of all views
    seed : of the angles, the choice of views and the random points
    """

    n_anchors: int = 1280
    sampling: Sampling = "sphere"
    turns_per_pair: int = 4
    merged_per_position: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise ValueError(f"sampling: expected one of {', '.join(SAMPLINGS)}, got {self.sampling!r}")
        if self.n_anchors < 1 or self.turns_per_pair < 1 or self.merged_per_position < 0:
            raise ValueError(f"cache settings: expected positive numbers, got {asdict(self)}")


@dataclass(frozen=True, eq=False)
class CloudSet:
    """M clouds and their truth; memory-mapped arrays of one split.

    Parameters
    ----------
    srgb_u8 : (M, N, 3) uint8
    points_m : (M, N, 3) float16, relative to the position
    is_set : (M, N) bool
    truth_ldr, truth_hdr : (M, 9, 3) float32
    ambient : (M, 3) float32, the sensor's at the session's exposure, the views' mean for merged clouds
    room : (M,) int64 number of the room within its data set
    n_views : (M,) int64 views that were merged
    """

    srgb_u8: NDArray[np.uint8]
    points_m: NDArray[np.float16]
    is_set: NDArray[np.bool_]
    truth_ldr: NDArray[np.float32]
    truth_hdr: NDArray[np.float32]
    ambient: NDArray[np.float32]
    room: NDArray[np.int64]
    n_views: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.room)

    def truth(self, target: str) -> NDArray[np.float32]:
        """(M, 9, 3) of "ldr" or "hdr"."""
        return self.truth_ldr if target == "ldr" else self.truth_hdr


@dataclass(frozen=True, eq=False)
class _Sample:
    """One row of a `CloudSet`."""

    cloud: PointCloud | UnitSphereCloud
    truth: tuple[ArrayF64, ArrayF64]
    ambient: ArrayF64
    n_views: int


def build_cache(
    data: Path, out: Path, settings: CacheSettings, progress: Callable[[str], None] = lambda line: None
) -> None:
    """Sample every room in `data` into `out`/<split>/*.npy; nothing is done if that is there with the same settings.

    ValueError if there are no rooms or one is broken.
    """
    files = room_files(data)
    seeds = {path: room_seed(path) for path in files}
    wanted = {"version": CACHE_VERSION, **asdict(settings), "rooms": sorted(map(list, seeds.values()))}
    done = out / "settings.json"
    if done.exists() and json.loads(done.read_text()) == wanted:
        return
    beside = out.with_name(f".{out.name}.part")
    shutil.rmtree(beside, ignore_errors=True)
    for split in SPLITS:
        members = [path for path in files if split_of(seeds[path]) == split]
        _build_split(members, seeds, beside / split, split, settings, progress)
    (beside / "settings.json").write_text(json.dumps(wanted))
    shutil.rmtree(out, ignore_errors=True)
    beside.rename(out)


def open_split(cache: Path, split: Split) -> CloudSet:
    """The clouds of one split, memory-mapped; ValueError if the cache is not there."""
    folder = cache / split
    if not (cache / "settings.json").exists():
        raise ValueError(
            f"{cache}: expected sampled clouds, got none; make them with `python -m xihenet.training cache`"
        )
    names = CloudSet.__dataclass_fields__
    return CloudSet(**{name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in names})


def clouds_of_room(
    room: TrainingRoom, settings: CacheSettings, split: Split, rng: np.random.Generator
) -> Iterator[Any]:
    """The rows that a room gives: pairs first, then merged clouds."""
    n_turns = settings.turns_per_pair if split == "train" else 1
    for view, position in np.argwhere(room.is_in_view):
        for turn in range(n_turns):
            angle = rng.uniform(0, 2 * np.pi) if turn else 0.0
            yield _sample(room, [view], position, angle, settings, rng)
    n_views = len(room.views)
    for position in range(len(room.positions_m)):
        if split != "train":
            yield _sample(room, range(n_views), position, 0.0, settings, rng)
            continue
        for _ in range(settings.merged_per_position):
            chosen = rng.permutation(n_views)[: rng.integers(1, n_views + 1)]
            yield _sample(room, chosen, position, rng.uniform(0, 2 * np.pi), settings, rng)


def rotation_about_vertical(angle: float) -> ArrayF64:
    """(3, 3), anticlockwise seen from above, radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def turned_cloud(cloud: PointCloud, position_m: ArrayF64, angle: float) -> PointCloud:
    """Points relative to the position, turned about the vertical through it."""
    relative = (cloud.points_m.astype(np.float64) - position_m) @ rotation_about_vertical(angle).T
    return PointCloud(relative.astype(np.float32), cloud.srgb)


def _sample(
    room: TrainingRoom, views: Any, position: int, angle: float, settings: CacheSettings, rng: np.random.Generator
) -> _Sample:
    turned = [turned_cloud(room.views[view], room.positions_m[position], angle) for view in views]
    rotation = rotation_about_vertical(angle)
    truth = (rotate(room.truth_ldr[position], rotation), rotate(room.truth_hdr[position], rotation))
    return _Sample(_sampled(turned, settings, rng), truth, room.ambient[list(views)].mean(axis=0), len(turned))


def _sampled(
    views: list[PointCloud], settings: CacheSettings, rng: np.random.Generator
) -> PointCloud | UnitSphereCloud:
    """The views, already relative to the position, as one cloud; a later view wins an anchor."""
    if settings.sampling == "sphere":
        lattice = AnchorLattice(settings.n_anchors)
        merged = UnitSphereCloud.empty(settings.n_anchors)
        for view in views:
            merged = merge(merged, sample_unit_sphere(view, np.zeros(3), lattice))
        return merged
    together = PointCloud(np.concatenate([v.points_m for v in views]), np.concatenate([v.srgb for v in views]))
    sample = sample_uniform if settings.sampling == "uniform" else sample_farthest
    return sample(together, settings.n_anchors, rng)


def _build_split(
    files: list[Path], seeds: dict[Path, tuple[int, int]], folder: Path, split: Split, settings: CacheSettings,
    progress: Callable[[str], None],
) -> None:  # fmt: skip
    arrays = _open_arrays(folder, sum(_n_clouds(pairs_that_count(path), split, settings) for path in files), settings)
    row = 0
    for i, path in enumerate(files):
        # A generator per room: the same room gives the same clouds whatever other rooms there are.
        rng = np.random.default_rng([settings.seed, *seeds[path]])
        for sample in clouds_of_room(read_room(path), settings, split, rng):
            _store(arrays, row, sample, settings)
            arrays["room"][row] = seeds[path][1]
            row += 1
        progress(f"{split}: room {i + 1} of {len(files)}, {row} clouds")
    for array in arrays.values():
        if isinstance(array, np.memmap):
            array.flush()


def _n_clouds(is_in_view: NDArray[np.bool_], split: Split, settings: CacheSettings) -> int:
    n_pairs, n_positions = int(is_in_view.sum()), is_in_view.shape[1]
    if split == "train":
        return n_pairs * settings.turns_per_pair + n_positions * settings.merged_per_position
    return n_pairs + n_positions


def _open_arrays(folder: Path, n: int, settings: CacheSettings) -> dict[str, NDArray[Any]]:
    folder.mkdir(parents=True)
    size = settings.n_anchors
    layouts: dict[str, tuple[Any, tuple[int, ...]]] = {
        "srgb_u8": (np.uint8, (size, 3)),
        "points_m": (np.float16, (size, 3)),
        "is_set": (np.bool_, (size,)),
        "truth_ldr": (np.float32, (9, 3)),
        "truth_hdr": (np.float32, (9, 3)),
        "ambient": (np.float32, (3,)),
        "room": (np.int64, ()),
        "n_views": (np.int64, ()),
    }
    arrays: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in layouts.items():
        path = folder / f"{name}.npy"
        if n == 0:  # a file cannot be mapped without content
            arrays[name] = np.zeros((0, *shape), dtype)
            np.save(path, arrays[name])
        else:
            arrays[name] = np.lib.format.open_memmap(path, "w+", dtype, (n, *shape))  # type: ignore[no-untyped-call]
    return arrays


def _store(arrays: dict[str, NDArray[Any]], row: int, sample: _Sample, settings: CacheSettings) -> None:
    cloud, size = sample.cloud, settings.n_anchors
    if isinstance(cloud, UnitSphereCloud):
        n, is_set = size, cloud.is_set
        points = AnchorLattice(size).directions * np.minimum(cloud.distance_m, _MAX_DISTANCE_M)[:, None]
    else:
        n, is_set, points = len(cloud.points_m), np.ones(len(cloud.points_m), bool), cloud.points_m
    arrays["srgb_u8"][row, :n] = np.rint(cloud.srgb * 255)
    arrays["points_m"][row, :n] = np.clip(points, -_MAX_DISTANCE_M, _MAX_DISTANCE_M)
    arrays["is_set"][row, :n] = is_set
    arrays["truth_ldr"][row], arrays["truth_hdr"][row] = sample.truth
    arrays["ambient"][row], arrays["n_views"][row] = sample.ambient, sample.n_views
