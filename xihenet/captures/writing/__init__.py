"""Recordings in the layouts of others, written a frame at a time; `xihenet.captures` reads them, and others do too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from xihenet.captures.writing import nerfstudio, record3d, stray, tum
from xihenet.captures.writing.pictures import Written
from xihenet.records import RgbdFrame

WRITERS: dict[str, Callable[[Path, Iterable[RgbdFrame]], Written]] = {
    "record3d": record3d.write,
    "nerfstudio": nerfstudio.write,
    "tum": tum.write,
    "stray": stray.write,
}
"""By name, what writes frames: to a file for Record3D, which should end in .r3d, into a folder for the others."""
