"""Recordings of our own, as `xihenet.io.recording` has them: session.json beside one OpenEXR file per frame."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from xihenet.captures.capture import Capture, CapturedFrame, inside
from xihenet.formats import format_count
from xihenet.io.frame_files import BLENDER_FROM_UP, frame_camera
from xihenet.io.json_files import named
from xihenet.io.recording import FRAME_FILES, SESSION_FILE, load_frame, read_header, read_session

FORMAT_NAME = "Xihe session"
NUMBER = re.compile(r"frame_(\d{1,9})\.exr")


def is_in(folder: Path) -> bool:
    return (folder / SESSION_FILE).is_file()


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`; files without a rotation for a pose are refused."""
    if up not in (None, "z"):
        raise ValueError(f"{folder}: +Z is up in a Xihe session: leave out --up")
    facts = read_session(folder / SESSION_FILE)
    paths = [inside(folder, name) for name in facts.files] or sorted(folder.glob(FRAME_FILES))
    if not paths:
        raise ValueError(f"{folder}: no frames ({FRAME_FILES}) beside {SESSION_FILE}: record again")
    frames = [_frame(path) for path in paths]
    if len({one.number for one in frames}) < len(frames):  # As of an app that gives its frames no numbers.
        frames = [replace(one, number=number) for number, one in enumerate(frames)]
    return Capture(
        FORMAT_NAME,
        frames,
        BLENDER_FROM_UP["z"],
        (*facts.not_known, *_gaps(paths)),
        facts.reference_exposure,
        facts.trigger,
        is_exposure_known=True,
        source=facts.source,
    )


def _gaps(paths: Sequence[Path]) -> tuple[str, ...]:
    """A note where numbers are missing between those of the files, which are written one after the other."""
    found = [NUMBER.fullmatch(path.name) for path in paths]
    numbers = [int(one[1]) for one in found if one is not None]
    n_gone = max(numbers) + 1 - min(numbers) - len(set(numbers)) if len(numbers) == len(paths) else 0
    return (f"{format_count(n_gone, 'frame')} missing between the others: copy the recording again.",) if n_gone else ()


def _frame(path: Path) -> CapturedFrame:
    header = read_header(path)
    with named(path):
        camera = frame_camera(header.intrinsics, header.world_from_camera.tolist())
    return CapturedFrame(header.frame, header.time_s, camera, partial(load_frame, path))
