"""Raw data of the app Polycam: keyframes/images, cameras, depth and confidence, files of one picture having one name.

A camera's file holds t_00 to t_23, row by row, camera to world: the camera looks along -Z with +Y up, the world is
ARKit's, +Y up. Intrinsics are for the picture's size. Depth is 16-bit, in millimetres, smaller than colour; confidence
is 0, 54 or 127, and 255. Where Polycam has corrected the cameras, those and their pictures are taken alone, since the
two sets do not fit together; but since 2025 only the others say how large the pictures are. Names are times, taken to
be in microseconds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.reading.phone_frame import left_out, picture_frame, without_confidence
from xihenet.captures.reading.values import FARTHEST_M
from xihenet.io.frame_files import BLENDER_FROM_UP, FrameCamera, frame_camera
from xihenet.io.json_files import named, number_in, read_json, side_in
from xihenet.records import Intrinsics

METRES_PER_UNIT, SECONDS_PER_UNIT = 1e-3, 1e-6
SETS = ("corrected_", "")
PICTURES = (".jpg", ".jpeg", ".png")
SPAN_S = 0.5  # Between frames whose names are no times
LONGEST_NAME = 18  # Digits of a name that is a time


def is_in(folder: Path) -> bool:
    return any((folder / "keyframes" / f"{which}cameras").is_dir() for which in SETS)


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`."""
    up, keyframes = up or "y", folder / "keyframes"
    cameras = {one: list((keyframes / f"{one}cameras").glob("[!.]*.json")) for one in SETS}
    which = next((one for one in SETS if cameras[one]), "")
    paths = cameras[which]
    are_times = all(path.stem.isdecimal() and len(path.stem) <= LONGEST_NAME for path in paths)
    paths.sort(key=lambda path: (int(path.stem) if are_times else 0, path.stem))
    frames: list[CapturedFrame] = []
    are_sure = []
    for i, path in enumerate(paths):
        pictures = (keyframes / f"{which}images" / f"{path.stem}{suffix}" for suffix in PICTURES)
        colour = next((picture for picture in pictures if picture.is_file()), None)
        plane_depth = keyframes / "depth" / f"{path.stem}.png"
        if colour is None or not (plane_depth.is_file() and path.is_file()):
            continue
        time_s = (int(path.stem) - int(paths[0].stem)) * SECONDS_PER_UNIT if are_times else i * SPAN_S
        camera = _camera(path, up)
        confidence = keyframes / "confidence" / f"{path.stem}.png"
        are_sure.append(confidence.is_file())
        frames.append(picture_frame(i + 1, time_s, camera, colour, plane_depth, METRES_PER_UNIT, confidence))
    if not frames:
        raise ValueError(f"{keyframes}: no camera has colour and depth: record with LiDAR, and export raw data")
    notes = ["Cameras are those that Polycam has corrected."] if which else []
    if not are_times:
        notes.append(f"Times are not known: {SPAN_S:g} s between frames are assumed.")
    notes += left_out(len(paths) - len(frames), "colour or depth")
    if (keyframes / "confidence").is_dir():
        notes += without_confidence(are_sure)
    return Capture("Polycam", frames, BLENDER_FROM_UP[up], tuple(notes))


def _camera(path: Path, up: str) -> FrameCamera:
    content = read_json(path)
    with named(path):
        if not isinstance(content, dict):
            raise ValueError("expected a JSON object")
        k = (number_in(content, name) for name in ("fx", "fy", "cx", "cy"))
        sides, uncorrected = content, path.parents[1] / "cameras" / path.name
        if "width" not in content and uncorrected.is_file() and isinstance(other := read_json(uncorrected), dict):
            sides = other
        intrinsics = Intrinsics(side_in(sides, "width"), side_in(sides, "height"), *k)
        rows = [[number_in(content, f"t_{row}{column}") for column in range(4)] for row in range(3)]
        if np.abs(rows).max() > FARTHEST_M:
            raise ValueError(f"expected a place within {FARTHEST_M:g} m of the origin")
        return frame_camera(intrinsics, [*rows, [0, 0, 0, 1]], up=up)
