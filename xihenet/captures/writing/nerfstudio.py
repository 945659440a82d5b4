"""Frames as Nerfstudio has them; the layout is that of `xihenet.captures.reading.nerfstudio`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from xihenet.captures.reading.nerfstudio import FILE
from xihenet.captures.writing.pictures import Written, save_depth, save_png
from xihenet.records import RgbdFrame

UNITS_PER_METRE = 1000


def write(folder: Path, frames: Iterable[RgbdFrame]) -> Written:
    """Pictures in the order of the frames, by which others sort them, and transforms.json at the end.

    Not by the frames' own numbers, which may be below 0 or all the same. OSError if it cannot be written.
    """
    entries, n_unheld = [], 0
    first: dict[str, Any] = {}
    for number, frame in enumerate(frames, start=1):
        names = f"images/{number}.png", f"depth/{number}.png"
        save_png(folder / names[0], frame.srgb_u8)
        n_unheld += save_depth(folder / names[1], frame, UNITS_PER_METRE)
        k = frame.intrinsics
        said = {"w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy}
        first = first or said
        pose = frame.world_from_camera.tolist()
        own = {} if said == first else said
        entries.append({"file_path": names[0], "depth_file_path": names[1], "transform_matrix": pose, **own})
    content = json.dumps({**first, "frames": entries}, allow_nan=False)
    folder.mkdir(exist_ok=True, parents=True)
    (folder / FILE).write_text(content, encoding="utf-8")
    return Written(len(entries), n_unheld)
