"""A recording: which pictures it has, where the camera was, and what is not known of it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path, PureWindowsPath

from xihenet.io.frame_files import FrameCamera
from xihenet.records import ArrayF64, RgbdFrame
from xihenet.trigger import TriggerSettings

EXTRA = "pip install 'xihe-blender[captures]'"
KEPT_BYTES = 2**28
"""Of frames that are read more than once: some 700 of 256x192."""


@dataclass(frozen=True, eq=False)
class CapturedFrame:
    """One moment of a recording, on disk.

    Parameters
    ----------
    number, time_s : in the recording; seconds since its start
    camera : intrinsics and pose
    load : reads the frame; OSError or ValueError, naming the file, for what is not there or broken, ImportError without
        a package that it takes. What it says of number and time does not count
    picture : image of 8 bits with the colour as it was taken, which may have more pixels than the frame; None for none
    """

    number: int
    time_s: float
    camera: FrameCamera
    load: Callable[[], RgbdFrame]
    picture: Path | None = None

    def read(self) -> RgbdFrame:
        """Raises as `load`."""
        return replace(self.load(), frame=self.number, time_s=self.time_s)

    def changed(self, change: Callable[[RgbdFrame], RgbdFrame], camera: FrameCamera | None = None) -> CapturedFrame:
        """The same moment, read as `change` makes it of what is read, with the camera that it has then."""
        return replace(self, camera=camera or self.camera, load=lambda: change(self.load()))


@dataclass(frozen=True, eq=False)
class Capture:
    """A recording.

    Parameters
    ----------
    format_name : of its format
    frames : in the order in which they were taken, at least one
    blender_from_file : (3, 3) from the recording's world to Blender's axes
    notes : what is missing, assumed or not known, in sentences
    reference_exposure : that light carries; None takes that of the first frame
    trigger : with which the session was run when it was recorded; None for one that was not
    is_exposure_known : whether its frames say their own; else it is taken to be 1, and may drift
    is_opencv : whether the axes of its cameras were turned from OpenCV's when it was read
    source : where a recording of our own says that its frames come from, in words; empty where nothing is said
    """

    format_name: str
    frames: Sequence[CapturedFrame]
    blender_from_file: ArrayF64
    notes: tuple[str, ...] = ()
    reference_exposure: float | None = None
    trigger: TriggerSettings | None = None
    is_exposure_known: bool = False
    is_opencv: bool = False
    source: str = ""

    def __iter__(self) -> Iterator[RgbdFrame]:
        """The frames, one in memory at a time."""
        return (frame.read() for frame in self.frames)

    def kept_once_read(self, most_bytes: int = KEPT_BYTES) -> Capture:
        """The same recording, of which what is read first stays in memory, up to `most_bytes`."""
        kept: dict[int, RgbdFrame] = {}

        def load(index: int) -> RgbdFrame:
            nonlocal most_bytes
            if index in kept:
                return kept[index]
            frame = self.frames[index].load()
            most_bytes -= sum(getattr(value, "nbytes", 0) for value in vars(frame).values())
            if most_bytes >= 0:
                kept[index] = frame
            return frame

        frames = [replace(frame, load=partial(load, index)) for index, frame in enumerate(self.frames)]
        return replace(self, frames=frames)


def by_numbers(name: str) -> list[str]:
    """By which names are sorted, numbers in them by their value: 2 comes before 10."""
    return [part.zfill(20) for part in re.split(r"(\d+)", name)]


def inside(folder: Path, name: str) -> Path:
    """The file of that name below `folder`, accents in either Unicode form, and with the separators of Windows too;
    of a whole path there the one with its last parts. ValueError for one that lies elsewhere, links followed."""
    path = folder / name
    if ("\\" in name or name[1:3] == ":/") and not path.exists():
        whole = PureWindowsPath(name)
        name = name.replace("\\", "/")
        path = folder / name
        if whole.is_absolute():  # Two parts at least: by its name alone depth may be a picture.
            ends = (folder.joinpath(*whole.parts[i:]) for i in range(1, len(whole.parts) - 1))
            path = next((end for end in ends if end.exists()), path)
    if not name.isascii() and not path.exists():
        path = folder
        for part in Path(name).parts:
            path /= names_in(str(path)).get(unicodedata.normalize("NFC", part), part)
    lies_at = _resolved(str(path.parent)) / path.name
    if path.name == ".." or lies_at.is_symlink():
        lies_at = lies_at.resolve()
    if not lies_at.is_relative_to(_resolved(str(folder))):
        raise ValueError(
            f"{name!r} lies outside {folder}, and a recording may name only what is in its folder: "
            "copy the file there, and write its place in that folder"
        )
    return path


@lru_cache(maxsize=64)
def names_in(folder: str) -> Mapping[str, str]:
    """Of the files in a folder, by their composed form: copied from a Mac, accents may stand beside their letters."""
    try:
        return {unicodedata.normalize("NFC", path.name): path.name for path in Path(folder).iterdir()}
    except OSError:
        return {}


@lru_cache(maxsize=64)
def _resolved(folder: str) -> Path:
    """Kept, since it takes longer than reading a frame's line, and thousands of frames lie in one folder."""
    return Path(folder).resolve()
