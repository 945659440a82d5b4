"""The recording that a scene shows: which is it, and at which frame is each of its moments?

An imported scene remembers its recording, relative to the .blend where that is saved, and what was set of it by hand.
Each frame of the recording has a whole frame of the timeline: between two keys a camera would be somewhere between two
pictures, and what is put into them would slide. The panel asks at every redraw, so nothing here needs NumPy.
"""

from __future__ import annotations

import itertools
import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy

from xihe_blender.errors import UserError
from xihe_blender.scene.blend_file import absolute

CAPTURE, CAPTURE_WAS, CAPTURE_SET = "xihe_capture", "xihe_capture_was", "xihe_capture_set"
"""Custom properties of a scene: its recording as the .blend keeps it, where that was when it was imported, for a copy
of the .blend elsewhere, and what was set by hand, as JSON."""

SCAN = "xihe_scan"
"""Custom property of the mesh that was scanned by a recording: the name it was given."""

FIRST_FRAME = 1
MOST_FPS = 240
MOST_FRAMES_A_PICTURE = 1000  # Of the timeline, on average; each has a file. A picture every quarter of an hour has 900
FEW_FPS = 10  # Fewer a second are pictures that an app chose, at times of their own, and no video
IS_CAPTURED = "Captured by a phone: the session replaces rendered captures, and there is no ground truth."


@dataclass(frozen=True)
class ChosenCapture:
    """A recording: its folder or file, and what is set by hand as of `xihenet.captures`.

    `up` is the axis of its world that points up, None for the usual one, `scale` what its lengths are multiplied by,
    and `floor_m` the height of its floor after that, metres, which becomes 0.
    """

    path: Path
    up: str | None = None
    scale: float = 1.0
    floor_m: float = 0.0


def remember_capture(scene: bpy.types.Scene, chosen: ChosenCapture, blend_folder: Path | None) -> None:
    """Note that `scene` shows the recording `chosen`; see `stored_path`."""
    scene[CAPTURE], scene[CAPTURE_WAS] = stored_path(chosen.path, blend_folder), str(chosen.path.resolve())
    scene[CAPTURE_SET] = json.dumps({"up": chosen.up, "scale": chosen.scale, "floor_m": chosen.floor_m})


def stored_path(path: Path, blend_folder: Path | None) -> str:
    """`path` as a .blend in `blend_folder` keeps it, relative to itself; None for a file that is not saved yet."""
    whole = str(path.resolve())
    if blend_folder is None:
        return whole
    try:
        return str(bpy.path.relpath(whole, start=str(blend_folder.resolve())))
    except ValueError:  # On another drive
        return whole


def remembered_capture(scene: bpy.types.Scene) -> ChosenCapture | None:
    """What `remember_capture` noted; None for a scene whose captures are rendered."""
    path = scene.get(CAPTURE)
    if not isinstance(path, str) or not path:
        return None
    here, was = Path(absolute(path)), Path(str(scene.get(CAPTURE_WAS, path)))
    found = was if was.exists() and not (path.startswith("//") and here.exists()) else here
    return ChosenCapture(found, **json.loads(scene.get(CAPTURE_SET, "{}")))


def scan_of(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The scanned mesh in `scene`, the last one that was imported; None without one."""
    scans = [item for item in scene.objects if SCAN in item and item.type == "MESH"]
    return scans[-1] if scans else None


def frames_a_second(times_s: Sequence[float]) -> int:
    """The rate of the timeline at which a recording plays as fast as it was taken; 24 for a single picture.

    Where single pictures were taken, a few a second, up to twice as much, so that fewer fall onto the same frame.
    """
    steps_s = [after - before for before, after in itertools.pairwise(times_s) if after > before]
    if not steps_s:
        return 24
    usual = min(max(1, round(1 / statistics.median(steps_s))), MOST_FPS)
    rates = range(usual, 2 * usual + 1) if usual < FEW_FPS else range(usual, usual + 1)
    return max(rates, key=lambda rate: len(_frames_at(rate, times_s)))


def frames_of_times(times_s: Sequence[float]) -> dict[int, int]:
    """By frame of the timeline, in order, the index in `times_s` of what was taken then.

    What follows so closely that it falls onto a frame with the one before, or goes back in time, is left out. UserError
    for times so far apart that they are hardly seconds, or a clock was set between two.
    """
    indices = _frames_at(frames_a_second(times_s), times_s)
    if max(indices) > MOST_FRAMES_A_PICTURE * len(indices):
        steps_s = [after - before for before, after in itertools.pairwise(times_s)]
        n_before = 1 + steps_s.index(max(steps_s))
        raise UserError(
            f"{max(steps_s):g} s pass between pictures {n_before} and {n_before + 1} of the recording: correct its "
            "times, which are seconds, or leave out the pictures before or after that"
        )
    return indices


def _frames_at(fps: int, times_s: Sequence[float]) -> dict[int, int]:
    indices = {FIRST_FRAME: 0}
    for index, time_s in enumerate(times_s):
        number = FIRST_FRAME + round((time_s - times_s[0]) * fps)
        if number > next(reversed(indices)):
            indices[number] = index
    return indices
