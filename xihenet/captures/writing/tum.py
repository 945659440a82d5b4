"""Frames as the TUM RGB-D benchmark has them; the layout is that of `xihenet.captures.reading.tum`.

It has no place for intrinsics. Those of another camera than the benchmark's are written beside it, in camera.json,
which our reader takes; other tools have to be told.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from xihenet.captures.reading.tum import CAMERA, CAMERA_KEYS, FILES, INTRINSICS, METRES_PER_UNIT
from xihenet.captures.reading.values import quaternion_of
from xihenet.captures.writing.pictures import Written, save_depth, save_png
from xihenet.io.frame_files import BLENDER_FROM_OPENCV_CAMERA
from xihenet.records import Intrinsics, RgbdFrame

TOLERANCE = 1e-3
SHORTEST_S = 1e-4  # Between two frames, whose files are named by their times


def write(folder: Path, frames: Iterable[RgbdFrame]) -> Written:
    """Pictures by their time, and the lists at the end. OSError if it cannot be written.

    ValueError for intrinsics that change, and for times that do not rise.
    """
    lists: dict[str, list[str]] = {name: ["# timestamp and what it has"] for name in FILES}
    last_s, n_unheld, camera = -np.inf, 0, None
    for frame in frames:
        camera = camera or frame.intrinsics
        if frame.intrinsics != camera:
            raise ValueError("TUM RGB-D: expected one camera for all frames, and its intrinsics change")
        if frame.time_s - last_s < SHORTEST_S:
            raise ValueError(f"TUM RGB-D: expected times that rise by {SHORTEST_S:g} s, got {frame.time_s:g} s")
        last_s, time = frame.time_s, f"{frame.time_s:.6f}"
        names = f"rgb/{time}.png", f"depth/{time}.png"
        save_png(folder / names[0], frame.srgb_u8)
        n_unheld += save_depth(folder / names[1], frame, 1 / METRES_PER_UNIT)
        pose = frame.world_from_camera @ BLENDER_FROM_OPENCV_CAMERA
        values = (*pose[:3, 3], *quaternion_of(pose[:3, :3]))
        for file, said in zip(FILES, (*names, " ".join(f"{value:.9f}" for value in values)), strict=True):
            lists[file].append(f"{time} {said}")
    folder.mkdir(exist_ok=True, parents=True)
    (folder / CAMERA).unlink(missing_ok=True)  # Of an earlier recording
    if camera is not None and not _is_the_benchmarks(camera):
        content = {name: getattr(camera, name) for name in CAMERA_KEYS}
        (folder / CAMERA).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for file, lines in lists.items():
        (folder / file).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Written(len(lists[FILES[0]]) - 1, n_unheld)


def _is_the_benchmarks(k: Intrinsics) -> bool:
    scale = INTRINSICS.width / k.width
    scaled = np.array([k.height, k.fx, k.fy, k.cx, k.cy]) * scale
    expected = [INTRINSICS.height, INTRINSICS.fx, INTRINSICS.fy, INTRINSICS.cx, INTRINSICS.cy]
    return bool(np.allclose(scaled, expected, rtol=TOLERANCE))
