"""A folder that anyone can fill: camera.json, colour/ and depth/ with files of equal names, and poses.

camera.json   width, height, fx, fy, cx, cy; if need be `convention` and `up`, as `xihenet.io.frame_files.read_camera`
              has them; `metres_per_unit` of depth, by default 0.001, and `frames_per_second`, by default 30
colour/       images of 8 bits, in the order of their names, numbers in names by their value
depth/        grey images of 16 bits, 0 and 65535 where there is none; confidence/, if there is one, as 0, 1 and 2
poses/        NAME.txt: camera to world, four rows of four; or, in place of the folder,
poses.txt     a line for each picture of colour/: 16 numbers, row by row, or 8, which are time, place and
              quaternion: t x y z qx qy qz qw

A pose with a number that is not finite is of a moment at which tracking was lost, and as good as none.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from xihenet.captures.capture import Capture, by_numbers
from xihenet.captures.reading.phone_frame import left_out, picture_frame, without_confidence
from xihenet.captures.reading.values import FARTHEST_M, notes_on_times, numbers, pose_numbers, pose_of
from xihenet.io.frame_files import BLENDER_FROM_UP, CAMERA_KEYS, camera_facts, frame_camera
from xihenet.io.json_files import named, number_in, read_json
from xihenet.records import ArrayF64

FILE, LINES = "camera.json", "poses.txt"
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".ppm", ".pgm")
KEYS = (*(key for key in CAMERA_KEYS if key != "world_from_camera"), "metres_per_unit", "frames_per_second")


def is_in(folder: Path) -> bool:
    return (folder / FILE).is_file() and (folder / "colour").is_dir()


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`."""
    content = read_json(folder / FILE)
    with named(folder / FILE):
        intrinsics, is_opencv, said_up = camera_facts(content, KEYS)
        metres_per_unit, fps = (
            number_in(content, "metres_per_unit", 1e-3),
            number_in(content, "frames_per_second", 30.0),
        )
        if not (1e-9 < metres_per_unit < 1e3 and 1e-6 < fps < 1e6):
            raise ValueError("metres_per_unit and frames_per_second: expected positive numbers")
    colours, depths = _images(folder / "colour"), _by_name(_images(folder / "depth"))
    confidences = _by_name((folder / "confidence").glob("*.png"))
    if not colours:
        raise ValueError(
            f"{folder / 'colour'}: expected pictures, which end in {' or '.join(SUFFIXES)}, and found none"
        )
    poses, times_s = _poses(folder, colours)
    frames, are_sure = [], []
    for i, (colour, pose) in enumerate(zip(colours, poses, strict=True)):
        name = _name(colour)
        if pose is None or name not in depths:
            continue
        with named(f"{folder}, pose of {colour.name}"):
            camera = frame_camera(intrinsics, pose.tolist(), is_opencv=is_opencv, up=up or said_up)
        time_s = i / fps if times_s is None else float(times_s[i] - times_s[0])
        confidence = confidences.get(name)
        are_sure.append(confidence is not None)
        frames.append(picture_frame(i + 1, time_s, camera, colour, depths[name], metres_per_unit, confidence))
    if not frames:
        wanted = f"expected finite numbers, and depth/{colours[0].stem}.png for {colours[0].name}"
        raise ValueError(f"{folder}: no picture of colour/ has depth and a pose of its name: {wanted}")
    notes = notes_on_times([frame.time_s for frame in frames])
    if times_s is None:
        notes += (f"Times are not known: {fps:g} frames a second are assumed.",)
    notes += left_out(len(colours) - len(frames), "depth or a pose")
    if (folder / "confidence").is_dir():
        notes += without_confidence(are_sure)
    return Capture("plain folder", frames, BLENDER_FROM_UP[up or said_up], notes, is_opencv=is_opencv)


def _name(path: Path) -> str:
    """By which files belong together: a Mac's copies may have accents beside their letters."""
    return unicodedata.normalize("NFC", path.stem)


def _by_name(paths: Iterable[Path]) -> dict[str, Path]:
    return {_name(path): path for path in paths}


def _images(folder: Path) -> list[Path]:
    """By name. What macOS puts beside files has a dot."""
    found = (path for path in folder.glob("[!.]*") if path.suffix.lower() in SUFFIXES and path.is_file())
    return sorted(found, key=lambda path: by_numbers(path.name))


def _poses(folder: Path, colours: Sequence[Path]) -> tuple[list[ArrayF64 | None], ArrayF64 | None]:
    """(4, 4) for each picture, None where it has none or was lost; and times in seconds, if they are known."""
    if not (folder / LINES).is_file():
        if not (folder / "poses").is_dir():
            raise ValueError(f"{folder}: expected {LINES} or a folder poses/ beside {FILE}")
        files = _by_name((folder / "poses").glob("*.txt"))
        found = (files.get(_name(colour)) for colour in colours)
        return [None if path is None else _matrix(_words(path), path) for path in found], None
    path = folder / LINES
    lines = [line.split() for line in _words(path, "\n") if line.strip() and not line.startswith("#")]
    if len(lines) != len(colours):
        raise ValueError(f"{path}: expected a line for each of {len(colours)} pictures, got {len(lines)}")
    for number, line in enumerate(lines, 1):
        if len(line) not in (8, 16):
            raise ValueError(
                f"{path}: pose {number}: expected 16 numbers with spaces between them, four rows of four, or 8, "
                f"t x y z qx qy qz qw, got {len(line)}"
            )
    if any(len(line) != 8 for line in lines):
        return [_matrix(line, path) for line in lines], None
    rows = [pose_numbers(line, 8, str(path)) for line in lines]
    times_s = np.concatenate([numbers(line[:1], 1, str(path)) for line in lines])
    with named(path):
        return [
            None if row is None else pose_of(row[1:4], row[4:], f"pose {number}") for number, row in enumerate(rows, 1)
        ], times_s


def _matrix(words: list[str], path: Path) -> ArrayF64 | None:
    values = pose_numbers(words, 16, str(path))
    if values is None:
        return None
    pose = values.reshape(4, 4)
    if np.abs(pose).max() > FARTHEST_M:
        raise ValueError(f"{path}: expected a place within {FARTHEST_M:g} m of the origin")
    return pose


def _words(path: Path, separator: str | None = None) -> list[str]:
    try:
        return path.read_text(encoding="utf-8-sig").split(separator)
    except UnicodeDecodeError:
        raise ValueError(f"{path}: expected numbers as text") from None
