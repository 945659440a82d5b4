"""What of a rendered room does training need, and in which split does it belong?

Reads the rooms that the data set's build leaves (one .npz per room, raw) without knowing Blender. A room belongs to a
split as a whole, by a hash of its seed: more rooms leave the older ones where they were, and no room is on two sides.
"""

from __future__ import annotations

import hashlib
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from xihenet.camera import unproject_frame
from xihenet.colour import srgb_to_linear
from xihenet.panorama import project_panorama
from xihenet.records import ArrayBool, ArrayF64, Intrinsics, PointCloud, RgbdFrame

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = ("train", "validation", "test")
TRAIN_SHARE, VALIDATION_SHARE = 0.8, 0.1


@dataclass(frozen=True, eq=False)
class TrainingRoom:
    """V views and P positions of one room, ready for sampling.

    Parameters
    ----------
    views : V clouds in the world, coloured at the room's exposure
    ambient : (V, 3) the pictures' mean linear colour at that exposure: what the phone's sensor says
    positions_m : (P, 3) world
    truth_ldr, truth_hdr : (P, 9, 3) coefficients at that exposure, of panoramas clipped at 1 and whole
    is_in_view : (V, P) the pair counts
    """

    views: list[PointCloud]
    ambient: ArrayF64
    positions_m: ArrayF64
    truth_ldr: ArrayF64
    truth_hdr: ArrayF64
    is_in_view: ArrayBool


def room_files(folder: Path) -> list[Path]:
    """The rooms in `folder`, in order of their numbers; ValueError if there are none."""
    files = sorted(folder.glob("room_[0-9]*.npz"))
    if not files:
        raise ValueError(
            f"{folder}: expected rooms (room_000000.npz and on), got none; make them with the data set build"
        )
    return files


def room_seed(path: Path) -> tuple[int, int]:
    """Seed of the data set and number of the room; ValueError if the file is no room."""
    return tuple(_read(path, "seed")["seed"].tolist())


def split_of(seed: tuple[int, int]) -> Split:
    """80 % of all seeds train, 10 % validate, 10 % test."""
    digest = hashlib.sha256(f"{seed[0]}/{seed[1]}".encode()).digest()
    place = int.from_bytes(digest[:8], "big") / 2**64
    if place < TRAIN_SHARE:
        return "train"
    return "validation" if place < TRAIN_SHARE + VALIDATION_SHARE else "test"


def pairs_that_count(path: Path) -> ArrayBool:
    """(V, P) without reading the pictures."""
    return np.asarray(_read(path, "is_in_view")["is_in_view"], bool)


def read_room(path: Path) -> TrainingRoom:
    """All of a room. ValueError naming the file if it is not one."""
    names = ("srgb_u8", "plane_depth_m", "world_from_camera", "intrinsics", "exposure", "positions_m", "panoramas")
    stored = _read(path, *names, "is_in_view")
    width, height, *rest = stored["intrinsics"].tolist()
    intrinsics, exposure = Intrinsics(int(width), int(height), *rest), float(stored["exposure"])
    pictures = zip(stored["srgb_u8"], stored["plane_depth_m"], stored["world_from_camera"], strict=True)
    frames = [RgbdFrame(c, d.astype(np.float32), intrinsics, pose, exposure) for c, d, pose in pictures]
    light = stored["panoramas"].astype(np.float64) * exposure
    return TrainingRoom(
        [unproject_frame(frame) for frame in frames],
        np.array([srgb_to_linear(frame.srgb_u8 / 255.0).mean(axis=(0, 1)) for frame in frames]),
        stored["positions_m"],
        np.array([project_panorama(np.minimum(panorama, 1.0)) for panorama in light]),
        np.array([project_panorama(panorama) for panorama in light]),
        np.asarray(stored["is_in_view"], bool),
    )


def _read(path: Path, *names: str) -> dict[str, np.ndarray]:  # type: ignore[type-arg]
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in names}
    except (KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path}: expected a room of a data set ({error})") from None
