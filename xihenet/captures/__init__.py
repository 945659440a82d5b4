"""Recordings of phones and depth cameras: one file for each format, recognised by what lies in the folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from xihenet.captures import nerfstudio, seven_scenes, tum, xihe_session
from xihenet.captures.capture import Capture

READERS: dict[str, tuple[Callable[[Path], bool], Callable[[Path, str | None], Capture]]] = {
    "Xihe session": (xihe_session.is_in, xihe_session.read),
    "Nerfstudio": (nerfstudio.is_in, nerfstudio.read),
    "TUM RGB-D": (tum.is_in, tum.read),
    "7-Scenes": (seven_scenes.is_in, seven_scenes.read),
}
"""By name, whether a folder holds one, and how it is read."""


def open_capture(folder: Path, up: str | None = None) -> Capture:
    """The session in `folder`; its pictures are read one by one, when they are asked for.

    `up` is the axis of the recording's world that points up, "z", "y", "x", or one of these after a minus; None takes
    what is usual for the format. ValueError, naming the fix, for a folder of no known format, and for what is broken in
    it; OSError if it cannot be read.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder: give one with a recording of {', '.join(READERS)}")
    for is_in, read in READERS.values():
        if is_in(folder):
            return read(folder, up)
    raise ValueError(f"{folder} holds no recording that is known: expected one of {', '.join(READERS)}")
