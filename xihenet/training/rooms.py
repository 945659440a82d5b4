"""Rooms for training: what of a rendered room does it need, and in which split does it belong?

Reads the rooms that the data set's build leaves (one .npz per room, raw) without knowing Blender. A room belongs to a
split as a whole, by a hash of its seed: more rooms leave the older ones where they were, and no room is on two sides.
"""

from __future__ import annotations

import hashlib
import itertools
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from xihenet.camera import in_view, unproject_frame
from xihenet.io.json_files import read_json
from xihenet.io.npz_files import read_npz
from xihenet.mirror_ball import project_mirror_ball
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, Intrinsics, PointCloud, RgbdFrame

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)
TRAIN_SHARE, VALIDATION_SHARE = 0.8, 0.1
ROOM_FORMAT = 2
MANIFEST = "dataset.json"  # What the rooms in a folder are made with
ROOMS_OF_A_SEED = 1_000_000  # That a data set has at most
PARTS = (
    "srgb_u8", "plane_depth_m", "world_from_camera", "intrinsics", "exposure", "positions_m", "is_in_view", "balls",
    "sh_ldr", "sh_hdr",
)  # fmt: skip
TRAINING_ONLY = frozenset({"radiance"})
"""Parts of a room's file that only training uses."""

Stored = Mapping[str, NDArray[Any]]
"""Arrays of a room's file by name."""


@dataclass(frozen=True, eq=False)
class TrainingRoom:
    """V views and P positions of one room, ready for sampling."""

    views: list[PointCloud]  # V, in the world, coloured as the phone delivered them
    # (V, points, 3) linear colour of the same points at the room's exposure, not clipped; None where its file lacks it.
    radiance: ArrayF32 | None
    positions_m: ArrayF64  # (P, 3) world
    balls: ArrayF64  # (P, n, n, 3) linear light around each position that camera rays see, exposed so too, not clipped
    sh_ldr: ArrayF64  # (P, 9, 3) the reference light at each position, clipped at 1
    sh_hdr: ArrayF64  # (P, 9, 3) the same, whole
    is_in_view: ArrayBool  # (V, P) the pair counts

    def truth(self, position: int, gains: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
        """(9, 3) of the light at a position times `gains` (3,): clipped at 1, and whole.

        The mirror ball says what gains do to clipped light. It is smoothed, and pixels hold more than one ray: what it
        is off from the reference without gains is added.
        """
        clipped, whole = self.sh_ldr[position], self.sh_hdr[position] * gains
        if (gains == 1).all():
            return clipped, whole
        ball = self.balls[position]
        off = clipped - project_mirror_ball(np.minimum(ball, 1.0))
        return project_mirror_ball(np.minimum(ball * gains, 1.0)) + off * np.minimum(gains, 1.0), whole


def room_files(folder: Path) -> list[Path]:
    """The rooms in `folder`, in order of their numbers; ValueError if there are none, or they are of another format."""
    files = sorted(folder.glob("room_[0-9]*.npz"))
    if not files:
        hint = "make them with the data set build"
        raise ValueError(f"{folder}: expected rooms (room_000000.npz and on), got none; {hint}")
    manifest = folder / MANIFEST
    if manifest.exists():
        try:
            found = read_json(manifest)["format"]
        except (ValueError, KeyError, TypeError):
            found = "none"
        if found != ROOM_FORMAT:
            raise ValueError(f"{manifest}: expected rooms of format {ROOM_FORMAT}, got {found!r:.80}; build them again")
    return files


def room_seed(path: Path) -> tuple[int, int]:
    """Seed of the data set and number of the room; ValueError if the file is no room."""
    return tuple(_read(path, "seed")["seed"].tolist())


def room_digest(path: Path) -> str:
    """Tells the rooms of data sets of one seed apart, by the checksums in the file; ValueError if it is no room."""
    try:
        with zipfile.ZipFile(path) as file:
            sums = {part.filename: part.CRC for part in file.infolist()}
        used = [(name, sums.get(f"{name}.npy")) for name in (*PARTS, *sorted(TRAINING_ONLY))]
    except zipfile.BadZipFile as error:
        raise _no_room(path, error) from None
    return hashlib.sha256(repr(used).encode()).hexdigest()


def room_number(seed: tuple[int, int]) -> int:
    """One number for a room whatever its data set: that of the room itself in the data set of seed 0."""
    return seed[0] * ROOMS_OF_A_SEED + seed[1]


def split_of(seed: tuple[int, int]) -> Split:
    """80 % of all seeds train, 10 % validate, 10 % test."""
    digest = hashlib.sha256(f"{seed[0]}/{seed[1]}".encode()).digest()
    place = int.from_bytes(digest[:8], "big") / 2**64
    if place < TRAIN_SHARE:
        return "train"
    return "validation" if place < TRAIN_SHARE + VALIDATION_SHARE else "test"


def n_rooms_needed(seed: int) -> int:
    """Of a data set of that seed: rooms from the first on, up to the first with which some train and some validate."""
    return next(n for n in itertools.count(1) if {"train", "validation"} <= {split_of((seed, i)) for i in range(n)})


def pairs_that_count(path: Path, *, is_upright: bool) -> ArrayBool:
    """(V, P) without reading the pictures."""
    return _pairs_that_count(_read(path, "is_in_view", "positions_m", "world_from_camera", "intrinsics"), is_upright)


def read_room(path: Path, *, is_upright: bool = False) -> TrainingRoom:
    """All of a room, or what an upright phone sees of it. ValueError naming the file if it is no room."""
    stored = _read(path, *PARTS, *TRAINING_ONLY)
    for name, array in stored.items():
        if not np.isfinite(array).all():
            raise _no_room(path, f"{name} is not finite")
    frames, exposure, radiance = frames_of(stored, is_upright=is_upright), float(stored["exposure"]), None
    if "radiance" in stored:
        kept = stored["radiance"][:, :, _phone(stored, is_upright)[1]].astype(np.float32)
        radiance = kept.reshape(len(frames), -1, 3) * np.float32(exposure)
    return TrainingRoom(
        [unproject_frame(frame) for frame in frames],
        radiance,
        stored["positions_m"],
        stored["balls"].astype(np.float64) * exposure,
        stored["sh_ldr"],
        stored["sh_hdr"],
        _pairs_that_count(stored, is_upright),
    )


def frames_of(stored: Stored, *, is_upright: bool = False) -> list[RgbdFrame]:
    """The views of a room's arrays as the phone delivered them, or what an upright phone sees of them."""
    intrinsics, columns = _phone(stored, is_upright)
    pictures = zip(stored["srgb_u8"], stored["plane_depth_m"], stored["world_from_camera"], strict=True)
    return [
        RgbdFrame(srgb_u8[:, columns], plane_depth_m[:, columns], intrinsics, pose, float(stored["exposure"]))
        for srgb_u8, plane_depth_m, pose in pictures
    ]


def _phone(stored: Stored, is_upright: bool) -> tuple[Intrinsics, slice]:
    """Intrinsics, and the columns of the pictures that are used: all, or 3:4 of the height in the middle."""
    width, height, fx, fy, cx, cy = stored["intrinsics"].tolist()
    n_columns = int(height * 3 / 4) if is_upright else int(width)
    first = (int(width) - n_columns) // 2
    return Intrinsics(n_columns, int(height), fx, fy, cx - first, cy), slice(first, first + n_columns)


def _pairs_that_count(stored: Stored, is_upright: bool) -> ArrayBool:
    if not is_upright:
        return np.asarray(stored["is_in_view"], bool)
    intrinsics, _ = _phone(stored, is_upright)
    return np.stack([in_view(stored["positions_m"], intrinsics, pose) for pose in stored["world_from_camera"]])


def _read(path: Path, *names: str) -> Stored:
    """These arrays; only what training alone uses may be missing."""
    try:
        stored = read_npz(path, names)
        return {name: stored[name] for name in names if name in stored or name not in TRAINING_ONLY}
    except (KeyError, ValueError) as error:
        raise _no_room(path, error) from None


def _no_room(path: Path, why: object) -> ValueError:
    return ValueError(f"{path}: expected a room of a data set ({why}); delete it and build again")
