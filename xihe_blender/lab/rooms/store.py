"""The store of rooms: one compressed .npz each, whole or absent, raw: whatever is sampled from it is derived later.

The same room gives the same bytes: nothing stored tells the time or the machine. float16 where it is harmless: plane
depth (a step of 4 mm at 5 m, less than a sensor's noise) and radiance (11 bits; brighter than 65504 is cut there).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.io.npz_files import read_npz
from xihenet.io.whole_files import written_whole
from xihenet.mirror_ball import panorama_of_ball
from xihenet.phone.metering import Metering
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayU8
from xihenet.training.rooms import ROOM_FORMAT

ArrayF16 = NDArray[np.float16]
FORMAT_VERSION = ROOM_FORMAT

METERING: Metering = "highlights"  # Of every room; a folder that was begun with another is not gone on with
MAX_FLOAT16 = 65504.0


@dataclass(frozen=True, eq=False)
class StoredRoom:
    """What one room gives: V views and P placement positions. The views of a walk are its frames, in order.

    `xihenet.training.rooms.frames_of` of its `vars` are the views as the phone delivered them.
    """

    srgb_u8: ArrayU8  # (V, H, W, 3) uint8, what the phone delivers at `exposure`
    radiance: ArrayF16  # (V, H, W, 3) float16, the same pictures as linear scene radiance, neither exposed nor clipped
    plane_depth_m: ArrayF16  # (V, H, W) float16, 0 where no surface was seen
    world_from_camera: ArrayF64  # (V, 4, 4) float64
    intrinsics: ArrayF64  # (6,) float64: width, height, fx, fy, cx, cy, the same for all views
    exposure: float  # the phone's, one for the room
    positions_m: ArrayF64  # (P, 3) float64, world
    balls: ArrayF16  # (P, n, n, 3) float16, scene radiance around each position that camera rays see, as mirror balls
    sh_ldr: ArrayF64  # (P, 9, 3) float64, the reference light at each position, clipped at white; carries the exposure
    sh_hdr: ArrayF64  # (P, 9, 3) float64, all of it, also of lamps hidden from cameras; carries the exposure
    sh_noise: ArrayF64  # (P, 2) float64, relative noise of the two, which is not all of their error; 0 if not known
    is_in_view: ArrayBool  # (V, P) bool, the position projects into the picture: the pair counts
    is_unhidden: ArrayBool  # (V, P) bool, nothing stands between the phone and the position
    seed: NDArray[np.int64]  # (2,) int64, of the data set and the room's number; of a scene see SCENE_SEED
    kind: str  # of the room, in words; of a scene its name
    regime: str  # of its light, in words; of a scene SCENE_REGIME
    versions: str  # of the format, this software and Blender

    def panorama(self, place: int, height: int = 32) -> ArrayF32:
        """(height, 2 height, 3) scene radiance around a position that camera rays see, for pictures."""
        return panorama_of_ball(self.balls[place], height)


def as_float16(values: NDArray[Any]) -> ArrayF16:
    """Values cut to what float16 can hold; NaN becomes 0."""
    finite = np.nan_to_num(values, nan=0.0, posinf=MAX_FLOAT16, neginf=0.0)
    return np.clip(finite, -MAX_FLOAT16, MAX_FLOAT16).astype(np.float16)


def save_room(path: Path, room: StoredRoom) -> None:
    """Write `room` whole or not at all. OSError if it cannot be written."""
    with written_whole(path) as beside:
        np.savez_compressed(beside, **vars(room))


def load_room(path: Path) -> StoredRoom:
    """Read what `save_room` wrote. ValueError naming the file if it is no such file, OSError if it cannot be read."""
    try:
        stored = read_npz(path)
        content: dict[str, Any] = {f.name: stored[f.name] for f in fields(StoredRoom)}
        content |= {name: content[name].item() for name in ("exposure", "kind", "regime", "versions")}
    except (KeyError, ValueError) as error:
        raise ValueError(f"{path}: not a room of a data set ({error})") from None
    return StoredRoom(**content)


def room_path(folder: Path, index: int) -> Path:
    return folder / f"room_{index:06d}.npz"


def stored_indices(folder: Path) -> Iterator[int]:
    """The numbers of the rooms that are there, in order."""
    return (int(path.stem.removeprefix("room_")) for path in sorted(folder.glob("room_[0-9]*.npz")))
