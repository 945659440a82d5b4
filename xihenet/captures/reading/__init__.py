"""Recordings in the layouts of others, and our own: one file for each, recognised by what lies there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from xihenet.captures.capture import Capture
from xihenet.captures.reading import nerfstudio, plain, polycam, record3d, seven_scenes, stray, tum, xihe_session

READERS: dict[str, tuple[Callable[[Path], bool], Callable[[Path, str | None], Capture]]] = {
    xihe_session.FORMAT_NAME: (xihe_session.is_in, xihe_session.read),
    "Stray Scanner": (stray.is_in, stray.read),
    "Polycam": (polycam.is_in, polycam.read),
    "Nerfstudio": (nerfstudio.is_in, nerfstudio.read),
    "TUM RGB-D": (tum.is_in, tum.read),
    "7-Scenes": (seven_scenes.is_in, seven_scenes.read),
    "plain folder": (plain.is_in, plain.read),
    "Record3D": (record3d.is_in, record3d.read),
}
"""By name, whether a folder, or for Record3D a file, holds one, and how it is read.

The first that says so reads. Record3D is last: in the folder of its EXR export may lie what was made of it.
"""
