"""The data set of training: rooms become clouds with the light they should give, once and not once per epoch.

Each pair of a view and a position in it becomes one cloud, as it is: those are what tables report on, as the paper
does. Training gets more of each, changed as `RoomChange` says: turned about the vertical and perhaps mirrored, exposed
otherwise and tinted before the picture is clipped, its light alike, and only then sampled, so that a changed room meets
the anchors and the end of the range as a real one would; and clouds merged from several views, as after a walk. All of
a split lies in memory-mapped arrays: an epoch reads, it does not sample.

Rejected: turning sampled clouds by moving anchors, which leaves holes, and sampling in the loop, which costs more than
the network.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import reduce
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from xihenet.buffers import in_sight, merge_views
from xihenet.camera import encode_exposed
from xihenet.codec import MAX_DISTANCE_M, facing_codes
from xihenet.colour import srgb_to_linear
from xihenet.light.platforms import MIRRORED_X
from xihenet.mirror_ball import seen_in_ball
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayU8, PointCloud, UnitSphereCloud
from xihenet.sampling import sample_farthest, sample_uniform, sample_unit_sphere
from xihenet.sh import rotate
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import (
    SPLITS,
    Split,
    TrainingRoom,
    pairs_that_count,
    read_room,
    room_digest,
    room_files,
    room_number,
    room_seed,
    split_of,
)

Sampling = Literal["sphere", "uniform", "farthest"]
SAMPLINGS: tuple[Sampling, ...] = get_args(Sampling)
AnyCloud = PointCloud | UnitSphereCloud
Content = dict[str, Any]
"""What sampled clouds were made of: their settings and rooms, as the cache's settings.json holds them."""
CACHE_VERSION = 9


@dataclass(frozen=True)
class CacheSettings:
    """What is derived from the rooms."""

    n_anchors: int = 1280  # or points of the other samplings
    sampling: Sampling = "sphere"  # or uniform random points (pointar), or farthest points
    changes_per_pair: int = 6  # training clouds of each pair, the first as it is
    merged_per_position: int = 8  # training clouds of each position, of 1 to V views; elsewhere one of all views
    exposure_spread: float = 0.45  # standard deviation of the log of the gain of all channels
    tint_spread: float = 0.06  # the same, of each channel
    warmth_spread: float = 0.15  # and of red; blue loses what red gains, as under another white balance
    is_test_only: bool = False  # every room counts as a test room: for walks, and for scenes that are of no data set
    # One cloud per position of which every anchor is set, coloured by the light probe: the floor that sampling and the
    # network leave; distances that no view knows are the others' median.
    is_whole_sphere: bool = False
    is_upright: bool = False  # pictures cut to the upright middle part that a phone turned by 90 degrees sees
    # Pixels are patches of surface and anchors know how these face; False samples points alone, as before 2026-11.
    has_patches: bool = True
    only: tuple[Split, ...] = SPLITS  # splits whose clouds are made; the others stay empty
    seed: int = 0  # of the changes, the choice of views and the random points

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise ValueError(f"sampling: expected one of {', '.join(SAMPLINGS)}, got {self.sampling!r}")
        if self.is_whole_sphere and self.sampling != "sphere":
            raise ValueError(f"is_whole_sphere: expected unit-sphere sampling, got {self.sampling!r}")
        numbers = (self.n_anchors - 1, self.changes_per_pair - 1, self.merged_per_position)
        if min(*numbers, self.exposure_spread, self.tint_spread, self.warmth_spread) < 0:
            raise ValueError(f"cache settings: expected positive numbers, got {asdict(self)}")


@dataclass(frozen=True, eq=False)
class RoomChange:
    """Another room made of one: mirrored left to right (x becomes -x), then turned; its light times `gains`.

    `angle` is about the vertical, anticlockwise seen from above, in radians; `gains` (3,) are of the linear light of
    each channel, before the picture is clipped.
    """

    angle: float = 0.0
    is_mirrored: bool = False
    gains: ArrayF64 = field(default_factory=lambda: np.ones(3))

    @classmethod
    def drawn(cls, settings: CacheSettings, rng: np.random.Generator) -> RoomChange:
        """Any angle, mirrored half of the time, gains as the settings say and no more than two stops."""
        log_gains = rng.normal(0.0, settings.exposure_spread) + rng.normal(0.0, settings.tint_spread, 3)
        log_gains += rng.normal(0.0, settings.warmth_spread) * np.array([1.0, 0.0, -1.0])
        gains = np.exp(np.clip(log_gains, -np.log(4), np.log(4)))
        return cls(float(rng.uniform(0, 2 * np.pi)), bool(rng.random() < 0.5), gains)

    def of_cloud(self, cloud: PointCloud, position_m: ArrayF64, radiance: NDArray[Any] | None) -> PointCloud:
        """Points and camera relative to the position; `radiance` (P, 3) of the same points is needed for other colours.

        ValueError without it.
        """
        points, grid = self._moved(cloud.points_m, position_m).astype(np.float32), cloud.grid
        if grid is not None:
            far = grid.far
            if far is not None:
                far = replace(far, rays=self._moved(far.rays.T, np.zeros(3)).T.astype(np.float32))
            grid = replace(grid, camera_m=self._moved(grid.camera_m[None], position_m)[0], far=far)
        if (self.gains == 1).all():
            return PointCloud(points, cloud.srgb, grid=grid)
        if radiance is None:
            raise ValueError("training rooms: expected linear colours of the views (`radiance`), got a room without")
        return PointCloud(points, _srgb(radiance * self.gains), grid=grid)

    def _moved(self, points_m: NDArray[Any], position_m: ArrayF64) -> ArrayF64:
        """(P, 3) relative to the position, mirrored and turned."""
        mirroring = [-1.0 if self.is_mirrored else 1.0, 1.0, 1.0]
        return (points_m - position_m) * mirroring @ rotation_about_vertical(self.angle).T

    def of_light(self, sh_radiance: ArrayF64) -> ArrayF64:
        """Coefficients (9, 3) mirrored and turned; the gains are in them already."""
        mirrored = sh_radiance * MIRRORED_X[:, None] if self.is_mirrored else sh_radiance
        return rotate(mirrored, rotation_about_vertical(self.angle))


@dataclass(frozen=True, eq=False)
class CloudSet:
    """M clouds and their truth; memory-mapped arrays of one split."""

    srgb_u8: ArrayU8  # (M, N, 3)
    points_m: NDArray[np.float16]  # (M, N, 3) relative to the position
    is_set: ArrayBool  # (M, N)
    truth_ldr: ArrayF32  # (M, 9, 3)
    truth_hdr: ArrayF32  # (M, 9, 3)
    ambient: ArrayF32  # (M, 3) the sensor's at the session's exposure, the views' mean for merged clouds
    room: NDArray[np.int64]  # (M,) `room_number`
    n_views: NDArray[np.int64]  # (M,) that were merged
    facing_i8: NDArray[np.int8]  # (M, N) `facing_codes` of `AnchorSurfaces`; 0 where that is unknown

    def __len__(self) -> int:
        return len(self.room)

    @property
    def coverage(self) -> ArrayF64:
        """(M,) share of the anchors that are set."""
        return self.is_set.mean(axis=1) if len(self) else np.zeros(0)

    def truth(self, target: str) -> ArrayF32:
        """(M, 9, 3) of "ldr" or "hdr"."""
        return self.truth_ldr if target == "ldr" else self.truth_hdr


class _Sample(NamedTuple):
    """One row of a `CloudSet`."""

    cloud: AnyCloud
    truth: tuple[ArrayF64, ArrayF64]
    ambient: ArrayF64
    n_views: int


def build_cache(
    data: Sequence[Path], out: Path, settings: CacheSettings, progress: Callable[[str], None] = lambda line: None,
    check: Callable[[Content], None] = lambda content: None,
) -> None:  # fmt: skip
    """Sample the rooms in the folders `data` into `out`/<split>/*.npy; nothing is done if that is there with the same
    settings and rooms.

    `check` is called with what the clouds will be made of, and may refuse it, before anything is made or removed.
    ValueError if a folder has no rooms, one is broken, or two are the same.
    """
    seeds = {path: room_seed(path) for folder in data for path in room_files(folder)}
    if len(set(seeds.values())) < len(seeds):
        raise ValueError(f"{', '.join(map(str, data))}: expected folders of different seeds, got the same room twice")
    splits: dict[Path, Split] = {path: "test" if settings.is_test_only else split_of(seeds[path]) for path in seeds}
    wanted = {"version": CACHE_VERSION, **asdict(settings), "only": list(settings.only)}
    wanted["rooms"] = sorted(map(list, seeds.values()))
    digests = [room_digest(path) for path in sorted(seeds, key=seeds.__getitem__)]
    wanted["rooms_digest"] = hashlib.sha256("".join(digests).encode()).hexdigest()
    check(wanted)
    done = out / "settings.json"
    if done.exists() and json.loads(done.read_text(encoding="utf-8")) == wanted:
        return
    for other in sorted(out.parent.glob(f".{glob.escape(out.name)}.*.part")):
        progress(f"{other} is of another build, or left by one that was killed: delete it if none is running")
    # Of this process alone: two trainings may sample the same clouds at once.
    beside = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        for split in SPLITS:
            members = {path: seeds[path] for path in seeds if splits[path] == split and split in settings.only}
            _build_split(members, beside / split, split, settings, progress)
        (beside / "settings.json").write_text(json.dumps(wanted), encoding="utf-8")
        shutil.rmtree(out, ignore_errors=True)
        beside.rename(out)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def open_split(cache: Path, split: Split) -> CloudSet:
    """The clouds of one split, memory-mapped; ValueError if the cache is not there, or of another version."""
    read_cache(cache)
    return CloudSet(*(np.load(cache / split / f"{part.name}.npy", mmap_mode="r") for part in fields(CloudSet)))


def read_content(cache: Path) -> Content:
    """What the clouds of a cache were made of; ValueError as of `read_cache`."""
    read_cache(cache)
    return json.loads((cache / "settings.json").read_text(encoding="utf-8"))


class Cache(NamedTuple):
    """What a folder of sampled clouds says of itself: parts of its settings, and its rooms (seed, number)."""

    sampling: Sampling
    n_anchors: int
    changes_per_pair: int
    is_test_only: bool
    rooms: list[tuple[int, int]]


def read_cache(folder: Path) -> Cache:
    """ValueError naming the folder if it is none, or of another version."""
    wanted, hint = "expected sampled clouds", "with `python -m xihenet.training cache`"
    try:
        found = json.loads((folder / "settings.json").read_text(encoding="utf-8"))
        if found["version"] == CACHE_VERSION:
            found["rooms"] = [(seed, number) for seed, number in found["rooms"]]
            return Cache(*(found[name] for name in Cache._fields))
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(f"{folder}: {wanted}, got none; make them {hint}") from None
    raise ValueError(f"{folder}: {wanted} of version {CACHE_VERSION}, got {found['version']}; make them again {hint}")


def clouds_of_room(
    room: TrainingRoom, settings: CacheSettings, split: Split, rng: np.random.Generator
) -> Iterator[Any]:
    """The `_Sample`s that a room gives: pairs first, then merged clouds."""
    n_views, n_positions = room.is_in_view.shape
    if settings.is_whole_sphere:
        yield from (_whole_sphere(room, position, settings, rng) for position in range(n_positions))
        return
    is_training = split == "train"
    for view, position in np.argwhere(room.is_in_view):
        for i in range(settings.changes_per_pair if is_training else 1):
            change = RoomChange.drawn(settings, rng) if i else RoomChange()
            yield _sample(room, [view], position, change, settings, rng)
    for position in range(n_positions):
        if not is_training:
            yield _sample(room, range(n_views), position, RoomChange(), settings, rng)
            continue
        for _ in range(settings.merged_per_position):
            chosen = rng.permutation(n_views)[: rng.integers(1, n_views + 1)]
            yield _sample(room, chosen, position, RoomChange.drawn(settings, rng), settings, rng)


def rotation_about_vertical(angle: float) -> ArrayF64:
    """(3, 3), anticlockwise seen from above, radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _sample(
    room: TrainingRoom, views: Any, position: int, change: RoomChange, settings: CacheSettings, rng: np.random.Generator
) -> _Sample:
    place, radiance = room.positions_m[position], room.radiance
    clouds = [change.of_cloud(room.views[i], place, None if radiance is None else radiance[i]) for i in views]
    if not settings.has_patches:
        clouds = [replace(cloud, grid=None) for cloud in clouds]
    ldr, hdr = room.truth(position, change.gains)
    # What the phone's sensor says: the mean of its pictures.
    ambient = np.mean([srgb_to_linear(cloud.srgb).mean(axis=0, dtype=np.float64) for cloud in clouds], axis=0)
    return _Sample(_sampled(clouds, settings, rng), (change.of_light(ldr), change.of_light(hdr)), ambient, len(clouds))


def _whole_sphere(room: TrainingRoom, position: int, settings: CacheSettings, rng: np.random.Generator) -> _Sample:
    merged = _sample(room, range(len(room.views)), position, RoomChange(), settings, rng)
    assert isinstance(merged.cloud, UnitSphereCloud)
    colours = seen_in_ball(room.balls[position], AnchorLattice(settings.n_anchors).directions)
    known = merged.cloud.is_set
    median_m = float(np.median(merged.cloud.distance_m[known])) if known.any() else 1.0
    distance_m = np.where(known, merged.cloud.distance_m, np.float32(median_m))
    return merged._replace(cloud=UnitSphereCloud(_srgb(colours), distance_m, np.ones(len(known), bool)))


def _srgb(radiance: NDArray[Any]) -> ArrayF32:
    """(P, 3) what a camera gives of linear colours at an exposure of 1."""
    return encode_exposed(radiance, 1.0).astype(np.float32) / np.float32(255)


def _sampled(views: list[PointCloud], settings: CacheSettings, rng: np.random.Generator) -> AnyCloud:
    """The views, already relative to the position, as one cloud."""
    if settings.sampling == "sphere":
        lattice = AnchorLattice(settings.n_anchors)
        sampled = (sample_unit_sphere(view, np.zeros(3), lattice) for view in views)
        return reduce(lambda old, new: merge_views(old, in_sight(old, new)), sampled)
    together = PointCloud(np.concatenate([v.points_m for v in views]), np.concatenate([v.srgb for v in views]))
    sample = sample_uniform if settings.sampling == "uniform" else sample_farthest
    return sample(together, settings.n_anchors, rng)


def _build_split(
    rooms: dict[Path, tuple[int, int]], folder: Path, split: Split, settings: CacheSettings,
    progress: Callable[[str], None],
) -> None:  # fmt: skip
    """`rooms` are the seeds by file."""
    n_clouds = sum(_n_clouds(pairs_that_count(path, is_upright=settings.is_upright), split, settings) for path in rooms)
    arrays, row = _open_arrays(folder, n_clouds, settings.n_anchors), 0
    for i, (path, seed) in enumerate(rooms.items()):
        # A generator per room: the same room gives the same clouds whatever other rooms there are.
        rng = np.random.default_rng([settings.seed, *seed])
        for sample in clouds_of_room(read_room(path, is_upright=settings.is_upright), settings, split, rng):
            _store(arrays, row, sample)
            arrays["room"][row] = room_number(seed)
            row += 1
        progress(f"{split}: room {i + 1} of {len(rooms)}, {row} clouds")


def _n_clouds(is_in_view: ArrayBool, split: Split, settings: CacheSettings) -> int:
    n_pairs, n_positions = int(is_in_view.sum()), is_in_view.shape[1]
    if settings.is_whole_sphere:
        return n_positions
    if split == "train":
        return n_pairs * settings.changes_per_pair + n_positions * settings.merged_per_position
    return n_pairs + n_positions


def _open_arrays(folder: Path, n: int, n_anchors: int) -> dict[str, NDArray[Any]]:
    """Files of a `CloudSet` of `n` clouds, full of zeros; its arrays, mapped for writing, if there are any clouds."""
    folder.mkdir(parents=True)
    anchors, places, light = (n_anchors,), (n_anchors, 3), (9, 3)
    layouts: dict[str, tuple[Any, tuple[int, ...]]] = {
        "srgb_u8": (np.uint8, places), "points_m": (np.float16, places), "is_set": (np.bool_, anchors),
        "truth_ldr": (np.float32, light), "truth_hdr": (np.float32, light), "ambient": (np.float32, (3,)),
        "room": (np.int64, ()), "n_views": (np.int64, ()), "facing_i8": (np.int8, anchors),
    }  # fmt: skip
    arrays: dict[str, NDArray[Any]] = {}
    for name, (dtype, shape) in layouts.items():
        path = folder / f"{name}.npy"
        if n:
            arrays[name] = np.lib.format.open_memmap(path, "w+", dtype, (n, *shape))  # type: ignore[no-untyped-call]
        else:  # a file cannot be mapped without content
            np.save(path, np.zeros((0, *shape), dtype))
    return arrays


def _store(arrays: dict[str, NDArray[Any]], row: int, sample: _Sample) -> None:
    """What a cloud lacks, anchors or points, stays 0."""
    cloud = sample.cloud
    if isinstance(cloud, UnitSphereCloud):
        is_set: Any = cloud.is_set
        points = AnchorLattice(len(cloud)).directions * np.minimum(cloud.distance_m, MAX_DISTANCE_M)[:, None]
        if cloud.surfaces is not None:
            arrays["facing_i8"][row] = facing_codes(cloud.surfaces.facing)
    else:
        is_set, points = True, cloud.points_m
    n = len(points)
    arrays["srgb_u8"][row, :n] = np.rint(cloud.srgb * 255)
    arrays["points_m"][row, :n] = np.clip(points, -MAX_DISTANCE_M, MAX_DISTANCE_M)
    arrays["is_set"][row, :n] = is_set
    arrays["truth_ldr"][row], arrays["truth_hdr"][row] = sample.truth
    arrays["ambient"][row], arrays["n_views"][row] = sample.ambient, sample.n_views
