"""Recordings as Nerfstudio has them: transforms.json beside pictures and depth.

Camera to world, the camera looks along -Z with +Y up, the world has +Z up; depth is 16-bit or .npy, in millimetres, or
in what the file says. Polycam and other apps export this form; instant-ngp and NeRFCapture name depth otherwise. There
are no times: frames are taken to follow each other FPS times a second, by the names of their pictures, as Nerfstudio
sorts them; COLMAP's converters list them as they were matched. Places were multiplied by `applied_scale`, if there is
one, and depth was not.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from xihenet.captures.capture import Capture, by_numbers, inside
from xihenet.captures.reading.phone_frame import left_out, picture_frame
from xihenet.io.frame_files import BLENDER_FROM_UP, frame_camera
from xihenet.io.json_files import named, number_in, read_json, side_in
from xihenet.records import Intrinsics

FILE = "transforms.json"
FPS = 30.0
MODELS = ("PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE", "OPENCV", "FULL_OPENCV", "SIMPLE_RADIAL", "RADIAL")
"""Of cameras that see straight lines as such, but for a distortion that is small; not a fish-eye's, nor a panorama."""

DEPTH = ("depth_file_path", "depth_path")
METRES_PER_UNIT = ("depth_unit_scale_factor", "integer_depth_scale")
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def is_in(folder: Path) -> bool:
    return (folder / FILE).is_file()


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`."""
    path = folder / FILE
    content = read_json(path)
    entries = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries or not all(isinstance(entry, dict) for entry in entries):
        raise ValueError(f"{path}: expected frames, a list with at least one")
    unit = next((name for name in METRES_PER_UNIT if name in content), METRES_PER_UNIT[0])
    with named(path):
        applied_scale, metres_per_unit = number_in(content, "applied_scale", 1.0), number_in(content, unit, 1e-3)
        if not 1e-6 < applied_scale < 1e6:
            raise ValueError(f"applied_scale: expected a positive number, got {applied_scale:g}")
        if not 1e-9 < metres_per_unit < 1e3:
            raise ValueError(f"{unit}: expected metres of a unit of depth, such as 0.001, got {metres_per_unit:g}")
    frames = []
    in_order = sorted(enumerate(entries, start=1), key=lambda one: by_numbers(str(one[1].get("file_path"))))
    for number, (place, entry) in enumerate(in_order, start=1):
        with named(f"{path}, frame {place}"):
            colour, plane_depth = _files(folder, entry)
            if plane_depth is None:
                continue
            camera = frame_camera(_intrinsics({**content, **entry}), entry.get("transform_matrix"), up=up or "z")
            camera.world_from_camera[:3, 3] /= applied_scale
        frames.append(picture_frame(number, (number - 1) / FPS, camera, colour, plane_depth, metres_per_unit))
    if not frames:
        depth_name = _depth_name(entries[0])
        of_depth = "no name of depth" if depth_name is None else f"{depth_name!r:.80}"
        wanted = f"{entries[0].get('file_path')!r:.80} and {of_depth}"
        raise ValueError(
            f"{path}: no frame has both a file_path and a depth_file_path that are there, and the first has {wanted}: "
            "record with depth, and copy all files"
        )
    notes: tuple[str, ...] = (f"Times are not known: {FPS:g} frames a second are assumed.",)
    if up is None:
        notes += ("+Z is taken to be up. In poses straight from ARKit or ARCore +Y is: for those, give --up y.",)
    notes += left_out(len(entries) - len(frames), "colour or depth")
    if any(number_in(of, name, 0.0) != 0 for of in (content, *entries) for name in DISTORTION if name in of):
        notes += ("The lens' distortion is not taken out.",)
    return Capture("Nerfstudio", frames, BLENDER_FROM_UP[up or "z"], notes)


def _files(folder: Path, entry: dict[str, Any]) -> tuple[Path, Path | None]:
    """Colour and depth; None for depth where one of the two is missing."""
    named = entry.get("file_path"), _depth_name(entry)
    if not isinstance(named[0], str):
        raise ValueError("file_path is missing")
    colour = inside(folder, named[0])
    if not (colour.suffix or colour.is_file()):  # As instant-ngp has it, also for NeRFCapture
        colour = inside(folder, f"{named[0]}.png")
    plane_depth = inside(folder, named[1]) if isinstance(named[1], str) else None
    is_there = colour.is_file() and plane_depth is not None and plane_depth.is_file()
    return colour, plane_depth if is_there else None


def _depth_name(entry: dict[str, Any]) -> Any:
    return next((entry[name] for name in DEPTH if name in entry), None)


def _intrinsics(values: dict[str, Any]) -> Intrinsics:
    """Of a frame: its own come before those of all. ValueError for a camera that is no pinhole."""
    model = values.get("camera_model", MODELS[0])
    if str(model).upper() not in MODELS or values.get("is_fisheye"):
        said = "is_fisheye: a fish-eye" if values.get("is_fisheye") else f"camera_model: {model!r:.80}"
        raise ValueError(f"{said} is no pinhole camera: undistort the pictures first")
    fx = number_in(values, "fl_x")
    fy, cx, cy = number_in(values, "fl_y", fx), number_in(values, "cx"), number_in(values, "cy")
    return Intrinsics(side_in(values, "w"), side_in(values, "h"), fx, fy, cx, cy)
