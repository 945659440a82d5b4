"""A recording: which pictures it has, where the camera was, and what is not known of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from xihenet.frame_files import FrameCamera, read_frame
from xihenet.records import ArrayF64, RgbdFrame


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """One moment of a recording, on disk.

    Parameters
    ----------
    number, time_s : in the recording; seconds since its start
    colour, plane_depth : image files, the second of 16 bits
    metres_per_unit : of the 16-bit image
    camera : intrinsics and pose
    """

    number: int
    time_s: float
    colour: Path
    plane_depth: Path
    metres_per_unit: float
    camera: FrameCamera

    def read(self) -> RgbdFrame:
        """OSError or ValueError as of `read_frame`."""
        frame = read_frame(
            self.colour, self.camera, plane_depth=self.plane_depth, depth_scale=self.metres_per_unit, exposure=1.0
        )
        return replace(frame, frame=self.number, time_s=self.time_s)


@dataclass(frozen=True, eq=False)
class Capture:
    """A recording.

    Parameters
    ----------
    format_name : of its format
    frames : in order of time, at least one
    blender_from_file : (3, 3) from the recording's world to Blender's axes
    notes : what is missing, assumed or not known, in sentences
    """

    format_name: str
    frames: Sequence[CapturedFrame]
    blender_from_file: ArrayF64
    notes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[RgbdFrame]:
        """The frames, one in memory at a time."""
        return (frame.read() for frame in self.frames)


def inside(folder: Path, name: str) -> Path:
    """The file of that name below `folder`; ValueError for one that lies elsewhere."""
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{name!r} lies outside {folder}: a recording may name only what is in its folder")
    return path


def n_frames(n: int) -> str:
    """ "1 frame", "3 frames"."""
    return f"{n} frame{'' if n == 1 else 's'}"
