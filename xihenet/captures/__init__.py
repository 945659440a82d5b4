"""Recordings of phones and depth cameras: opened, checked, replayed, made a mesh."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from xihenet.camera import valid_plane_depth
from xihenet.captures.capture import Capture, CapturedFrame, names_in
from xihenet.captures.reading import READERS
from xihenet.captures.reading.record3d import SUFFIX
from xihenet.formats import format_count
from xihenet.io.frame_files import off_centre
from xihenet.records import RgbdFrame

ARCHIVES = (SUFFIX, ".zip")
N_NAMED = 3


def open_capture(path: str | Path, up: str | None = None, *, scale: float = 1.0, floor_m: float = 0.0) -> Capture:
    """The session in the folder or file `path`; its pictures are read one by one, when they are asked for.

    `up` is the axis of the recording's world that points up, "z", "y", "x", or one of these after a minus; None takes
    what is usual for the format, or looks for the floor in some frames where it says nothing. `scale` and `floor_m` are
    as of `set_by_hand`. ValueError, naming the fix, for what is no known format, and for what is broken in it; OSError
    if it cannot be read; ImportError, naming the extra, without a package that it takes.
    """
    path = Path(path)
    if not path.exists():
        raise ValueError(f"{path} is not there: give a folder or file with a recording of {', '.join(READERS)}")
    names_in.cache_clear()  # Missing pictures may have been copied since.
    for is_in, read in READERS.values():
        if is_in(path):
            return set_by_hand(_with_doubts(read(path, up)), scale=scale, floor_m=floor_m)
    if inside := _recordings_in(path):
        raise ValueError(f"{path} holds no recording itself: give {' or '.join(map(str, inside))}, which is one")
    if any(is_in(path.parent) for is_in, _ in READERS.values()):
        raise ValueError(f"{path} is a part of a recording: give {path.parent}")
    raise ValueError(
        f"{path} holds no recording that is known: expected one of {', '.join(READERS)}. Convert other recordings to "
        "a plain folder: camera.json, colour/, depth/ and poses/, as docs/captures.md says"
    )


def set_by_hand(capture: Capture, *, scale: float = 1.0, floor_m: float = 0.0) -> Capture:
    """A recording whose scale or floor is known better than it knows itself.

    Lengths are `scale` times as long, and then `floor_m` lower, so that the floor is at height 0. Poses and depth are
    scaled alike. ValueError for a scale that is not positive, from 1e-6 to 1e6, or a floor that is not finite.
    """
    if not 1e-6 <= scale <= 1e6:
        raise ValueError(f"the scale of a recording is a positive factor from 1e-6 to 1e6: {scale:g} is none")
    if not np.isfinite(floor_m):
        raise ValueError(f"the floor of a recording is a height in metres: {floor_m:g} is none")
    if (scale, floor_m) == (1.0, 0.0):
        return capture
    return replace(capture, frames=[_placed(frame, scale, floor_m) for frame in capture.frames])


def _placed(frame: CapturedFrame, scale: float, floor_m: float) -> CapturedFrame:
    pose = frame.camera.world_from_camera.copy()
    pose[:3, 3] = scale * pose[:3, 3] - (0, 0, floor_m)

    def placed(read: RgbdFrame) -> RgbdFrame:
        depth_m = read.plane_depth_m
        scaled_m = np.multiply(depth_m, np.float32(scale), out=depth_m.copy(), where=valid_plane_depth(depth_m))
        return replace(read, world_from_camera=pose, plane_depth_m=scaled_m)

    return frame.changed(placed, replace(frame.camera, world_from_camera=pose))


def _recordings_in(folder: Path) -> list[Path]:
    """The first few recordings that lie in `folder`, one level deeper, as where an app's folder was copied into one."""
    found: list[Path] = []
    with contextlib.suppress(OSError):  # What cannot be looked into is none that could be named.
        for path in sorted(folder.iterdir()):
            if (path.is_dir() or path.suffix.lower() in ARCHIVES) and any(is_in(path) for is_in, _ in READERS.values()):
                found.append(path)
    return found[:N_NAMED]


def _with_doubts(capture: Capture) -> Capture:
    """The recording with a note where the principal point of frames is not within their picture."""
    doubts = [doubt for frame in capture.frames if (doubt := off_centre(frame.camera.intrinsics)) is not None]
    if not doubts:
        return capture
    also = ", and that K is stored column by column" if capture.format_name == "Record3D" else ""
    return replace(capture, notes=(*capture.notes, f"In {format_count(len(doubts), 'frame')} {doubts[0]}{also}."))
