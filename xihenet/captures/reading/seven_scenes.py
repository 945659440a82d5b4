"""Recordings of 7-Scenes: frame-000000.color.png, .depth.png and .pose.txt.

Poses are camera to world, the camera looks along +Z with +Y down. Depth is 16-bit, in millimetres; 65535 is a miss.
Which way is up is not given: the world is that of the first camera, so that its -Y is about up, and the floor says how
far it is from that. Depth is not registered to colour, since the two cameras are some centimetres apart.
"""

from __future__ import annotations

import re
from pathlib import Path

from xihenet.captures.capture import Capture
from xihenet.captures.floor import upright
from xihenet.captures.reading.phone_frame import left_out, picture_frame
from xihenet.io.frame_files import BLENDER_FROM_UP, frame_camera
from xihenet.io.json_files import named
from xihenet.records import Intrinsics

NAME = re.compile(r"frame-(\d+)\.pose\.txt")
INTRINSICS = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
FPS = 30.0


def is_in(folder: Path) -> bool:
    return any(NAME.fullmatch(path.name) for path in folder.glob("frame-*.pose.txt"))


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`."""
    numbers = sorted((int(found[1]), path) for path in folder.iterdir() if (found := NAME.fullmatch(path.name)))
    frames, first = [], numbers[0][0]
    for number, path in numbers:
        stem = path.name.removesuffix(".pose.txt")
        colour, plane_depth = (folder / f"{stem}.{kind}.png" for kind in ("color", "depth"))
        if not (colour.is_file() and plane_depth.is_file()):
            continue
        with named(path):
            rows = [
                [float(text) for text in line.split()]
                for line in path.read_text(encoding="utf-8-sig").splitlines()
                if line.strip()
            ]
            camera = frame_camera(INTRINSICS, rows, is_opencv=True, up=up or "-y")
        frames.append(picture_frame(number, (number - first) / FPS, camera, colour, plane_depth, 1e-3))
    if not frames:
        raise ValueError(
            f"{folder}: no pose has both pictures, {stem}.color.png and {stem}.depth.png, beside it: copy all files, "
            "or convert the recording to a plain folder, as docs/captures.md says"
        )
    notes = ("Depth is not registered to colour.", *left_out(len(numbers) - len(frames), "colour or depth"))
    capture = Capture("7-Scenes", frames, BLENDER_FROM_UP[up or "-y"], notes, is_opencv=True)
    return upright(capture, "-y") if up is None else capture
