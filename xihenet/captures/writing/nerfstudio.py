"""Frames as Nerfstudio has them; the layout is that of `xihenet.captures.reading.nerfstudio`."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from xihenet.captures.reading.nerfstudio import FILE
from xihenet.captures.writing.pictures import USUAL, Form, Written, colour_bytes, enlarged_intrinsics, save_depth
from xihenet.records import RgbdFrame

UNITS_PER_METRE = 1000


def write(folder: Path, frames: Iterable[RgbdFrame], form: Form = USUAL) -> Written:
    """Pictures by the number of their frame, and transforms.json at the end. OSError if it cannot be written."""
    suffix, entries, n_unheld = ".jpg" if form.is_jpeg else ".png", [], 0
    first: dict[str, Any] = {}
    for frame in frames:
        names = f"images/{frame.frame}{suffix}", f"depth/{frame.frame}.png"
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / names[0]).write_bytes(colour_bytes(frame, form))
        n_unheld += save_depth(folder / names[1], frame, UNITS_PER_METRE)
        k = enlarged_intrinsics(frame.intrinsics, form.colour_scale)
        said = {"w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy}
        first = first or said
        pose = frame.world_from_camera.tolist()
        own = {} if said == first else said
        entries.append({"file_path": names[0], "depth_file_path": names[1], "transform_matrix": pose, **own})
    content = json.dumps({**first, "frames": entries}, allow_nan=False)
    folder.mkdir(exist_ok=True, parents=True)
    (folder / FILE).write_text(content, encoding="utf-8")
    return Written(len(entries), n_unheld)
