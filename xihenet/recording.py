"""How is a session kept, so that the same walk can be run again with other settings?

One compressed .npz per frame in a folder, whole or absent: colour, plane depth, intrinsics, pose, exposure, ambient,
time, and how many pixels were invalid and why. Chosen over one big file because a recording that is cut short is still
a recording, and a run can resume on it.
Paper: section 5, `XiheRecorder`; `EnvironmentScanner` is what a phone, a renderer or a recording can stand behind.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xihenet.npz_files import read_npz
from xihenet.records import Intrinsics, RgbdFrame

INVALID = "invalid_"  # Begins the name of the number that belongs to a reason
FRAME_FILES = "frame_*.npz"


class EnvironmentScanner(Protocol):
    """Whatever delivers frames."""

    def acquire_environment_scan(self) -> RgbdFrame: ...


def save_frame(path: Path, frame: RgbdFrame) -> None:
    """Write `frame` to `path` (.npz). OSError if it cannot be written; an older file then stays as it was."""
    beside = path.with_name(f".{path.name}.part")
    fields: dict[str, Any] = {f"intrinsics_{name}": value for name, value in asdict(frame.intrinsics).items()}
    if frame.ambient is not None:
        fields["ambient"] = frame.ambient
    fields |= {f"{INVALID}{reason}": n for reason, n in frame.invalid.items()}
    for name in ("srgb_u8", "plane_depth_m", "world_from_camera", "exposure", "time_s", "frame"):
        fields[name] = getattr(frame, name)
    try:
        # Through memory: a zip file that a full disk stops complains once more when it is collected.
        content = io.BytesIO()
        np.savez_compressed(content, **fields)
        beside.write_bytes(content.getvalue())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)


def load_frame(path: Path) -> RgbdFrame:
    """Read what `save_frame` wrote. ValueError naming the file if it is no such file, OSError if it cannot be read."""
    try:
        fields = read_npz(path)
        return RgbdFrame(
            _numbers(fields, "srgb_u8", 3),
            _numbers(fields, "plane_depth_m", 2),
            Intrinsics(
                int(_number(fields, "intrinsics_width")),
                int(_number(fields, "intrinsics_height")),
                *(float(_number(fields, f"intrinsics_{name}")) for name in ("fx", "fy", "cx", "cy")),
            ),
            _numbers(fields, "world_from_camera", 2),
            float(_number(fields, "exposure")),
            _numbers(fields, "ambient", 1) if "ambient" in fields else None,
            float(_number(fields, "time_s")),
            int(_number(fields, "frame")),
            {name.removeprefix(INVALID): _count(fields, name) for name in fields if name.startswith(INVALID)},
        )
    except (LookupError, ValueError, OverflowError) as error:
        raise ValueError(f"{path}: not a recorded frame ({error})") from None


def _numbers(fields: Mapping[str, NDArray[Any]], name: str, n_axes: int) -> NDArray[Any]:
    """An array of real numbers of so many axes."""
    array = fields[name]
    if array.dtype.kind not in "iuf" or array.ndim != n_axes:
        raise ValueError(f"{name}: expected numbers along {n_axes} axes, got {array.dtype} of {array.shape}")
    return array


def _count(fields: Mapping[str, NDArray[Any]], name: str) -> int:
    number = _number(fields, name)
    if not isinstance(number, int) or number < 1:
        raise ValueError(f"{name}: expected a count of 1 or more, got {number}")
    return number


def _number(fields: Mapping[str, NDArray[Any]], name: str) -> Any:
    return _numbers(fields, name, 0).item()


class SessionRecorder:
    """Keeps every frame it is given in `folder`, which is made if it is not there.

    FileExistsError if the folder already holds a recording: nothing is overwritten.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.glob(FRAME_FILES)):
            raise FileExistsError(f"{folder}: already holds a recording; choose another folder")
        self.folder = folder
        self.n_frames = 0

    def record(self, frame: RgbdFrame) -> None:
        """Add one frame; the order of recording is the order of replay."""
        save_frame(self.folder / f"frame_{self.n_frames:06d}.npz", frame)
        self.n_frames += 1


class ReplayScanner:
    """Delivers the frames of a recording one after the other.

    FileNotFoundError if `folder` holds none; `acquire_environment_scan` raises StopIteration after the last.
    """

    def __init__(self, folder: Path) -> None:
        self.files = sorted(folder.glob(FRAME_FILES))
        if not self.files:
            raise FileNotFoundError(f"{folder}: no recorded frames (frame_*.npz) in this folder")
        self._frames = iter(self)

    def __len__(self) -> int:
        return len(self.files)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (load_frame(file) for file in self.files)

    def acquire_environment_scan(self) -> RgbdFrame:
        """The next frame of the recording."""
        return next(self._frames)
