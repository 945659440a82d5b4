"""Frames as the TUM RGB-D benchmark has them; the layout is that of `xihenet.captures.tum`.

It has no place for intrinsics: whoever reads it takes those of the benchmark, so that no others can be written.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from xihenet.captures.tum import FILES, INTRINSICS, METRES_PER_UNIT
from xihenet.captures.values import quaternion_of
from xihenet.captures.writing.pictures import OPENCV_FROM_BLENDER_CAMERA, USUAL, Form, Written, colour_bytes, save_depth
from xihenet.records import Intrinsics, RgbdFrame

TOLERANCE = 1e-3
SHORTEST_S = 1e-4  # Between two frames, whose files are named by their times


def write(folder: Path, frames: Iterable[RgbdFrame], form: Form = USUAL) -> Written:
    """Pictures by their time, and the lists at the end. OSError if it cannot be written.

    ValueError for other intrinsics than the benchmark's, and for times that do not rise.
    """
    lists: dict[str, list[str]] = {name: ["# timestamp and what it has"] for name in FILES}
    last_s, n_too_far = -np.inf, 0
    for frame in frames:
        _check(frame.intrinsics)
        if frame.time_s - last_s < SHORTEST_S:
            raise ValueError(f"TUM RGB-D: expected times that rise by {SHORTEST_S:g} s, got {frame.time_s:g} s")
        last_s, time = frame.time_s, f"{frame.time_s:.6f}"
        names = f"rgb/{time}{'.jpg' if form.is_jpeg else '.png'}", f"depth/{time}.png"
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / names[0]).write_bytes(colour_bytes(frame, form))
        n_too_far += save_depth(folder / names[1], frame, 1 / METRES_PER_UNIT)
        pose = frame.world_from_camera @ OPENCV_FROM_BLENDER_CAMERA
        values = (*pose[:3, 3], *quaternion_of(pose[:3, :3]))
        for file, said in zip(FILES, (*names, " ".join(f"{value:.9f}" for value in values)), strict=True):
            lists[file].append(f"{time} {said}")
    folder.mkdir(exist_ok=True, parents=True)
    for file, lines in lists.items():
        (folder / file).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Written(len(lists[FILES[0]]) - 1, n_too_far)


def _check(k: Intrinsics) -> None:
    scale = INTRINSICS.width / k.width
    scaled = np.array([k.height, k.fx, k.fy, k.cx, k.cy]) * scale
    expected = [INTRINSICS.height, INTRINSICS.fx, INTRINSICS.fy, INTRINSICS.cx, INTRINSICS.cy]
    if not np.allclose(scaled, expected, rtol=TOLERANCE):
        raise ValueError(
            f"TUM RGB-D: the layout has no place for intrinsics other than {INTRINSICS}: write another, such as "
            "nerfstudio"
        )
