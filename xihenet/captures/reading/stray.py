"""Recordings of the app Stray Scanner: rgb.mp4, depth/000000.png, confidence/, camera_matrix.csv and odometry.csv.

Poses are camera to world, the camera looks along +Z with +Y down; the world is ARKit's, +Y up. Depth is 16-bit, in
millimetres, in older recordings as .npy. The number in odometry.csv is that of the picture in the video and of the
files; the oldest recordings have neither numbers nor times, and a line for each picture. Intrinsics are for the video's
size: those of camera_matrix.csv, or, in newer recordings, of each line.
"""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path

import numpy as np

from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.reading.phone_frame import (
    left_out,
    phone_frame,
    read_measured,
    without_confidence,
)
from xihenet.captures.reading.values import notes_on_times, numbers, pose_of
from xihenet.captures.reading.video import Video
from xihenet.formats import format_count
from xihenet.io.frame_files import BLENDER_FROM_UP, FrameCamera, frame_camera
from xihenet.io.json_files import named
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame

VIDEO, ODOMETRY, MATRIX = "rgb.mp4", "odometry.csv", "camera_matrix.csv"
COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")
OLDEST = COLUMNS[2:]
INTRINSICS = ("fx", "fy", "cx", "cy")
FPS = 60.0  # Of the app, unless it is told otherwise
METRES_PER_UNIT = 1e-3
MOST_FRAMES = 10_000_000


def is_in(folder: Path) -> bool:
    return (folder / VIDEO).is_file() and (folder / ODOMETRY).is_file()


def read(folder: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`; ImportError without PyAV."""
    up = up or "y"
    rows, notes = _odometry(folder / ODOMETRY)
    of_all = None if len(rows[0]) > len(COLUMNS) else _matrix(folder / MATRIX)
    video = Video(folder / VIDEO)
    frames = []
    for row in rows:
        number = int(row[1])
        plane_depth = _depth_file(folder, number)
        if plane_depth is None or number >= video.n_frames:
            continue
        with named(f"{folder / ODOMETRY}, frame {number}"):
            k = row[9:] if of_all is None else of_all
            pose = pose_of(row[2:5], row[5:9]).tolist()
            intrinsics = Intrinsics(video.width, video.height, *k.tolist())
            camera = frame_camera(intrinsics, pose, is_opencv=True, up=up)
        load = partial(_load, folder, number, plane_depth, camera, video)
        frames.append(CapturedFrame(number, float(row[0] - rows[0][0]), camera, load))
    if not frames:
        raise ValueError(f"{folder}: no line of {ODOMETRY} has depth and a picture of {VIDEO}: record with depth")
    notes += notes_on_times([frame.time_s for frame in frames])
    last = int(rows[-1][1])
    if video.n_frames <= last:
        notes += (f"The video ends early, after {format_count(video.n_frames, 'frame')} of {last + 1}.",)
    if n_unspoken := video.n_frames - sum(row[1] < video.n_frames for row in rows):
        notes += (f"{format_count(n_unspoken, 'frame')} of the video without a line of {ODOMETRY} left out.",)
    notes += left_out(len(rows) - len(frames), "colour or depth")
    if (folder / "confidence").is_dir():
        notes += without_confidence([_confidence_file(folder, frame.number).is_file() for frame in frames])
    return Capture("Stray Scanner", frames, BLENDER_FROM_UP[up], notes, is_opencv=True)


def _odometry(path: Path) -> tuple[list[ArrayF64], tuple[str, ...]]:
    """Per frame, by rising number, what COLUMNS and, in newer files, INTRINSICS name; and what is assumed."""
    found = _lines(path)
    names = [name.strip() for name in found[0]] if found else []
    first = 1
    notes: tuple[str, ...] = ()
    named_in_file: tuple[str, ...] = COLUMNS
    fix = "copy the file again, or delete the line"
    if tuple(names) == OLDEST:
        named_in_file, fix = OLDEST, "copy the file again"  # Without a line those after it would be of other pictures.
        notes = (f"Times are not known: {FPS:g} frames a second are assumed.",)
    if names[: len(named_in_file)] == list(named_in_file):
        found, first = found[1:], 2
    has_intrinsics = set(INTRINSICS) <= set(names)
    columns = [*range(len(named_in_file)), *(names.index(name) for name in INTRINSICS if has_intrinsics)]
    rows: list[ArrayF64] = []
    for number, line in enumerate(found, start=first):
        if len(line) <= max(columns):
            raise ValueError(f"{path}, line {number}: expected {', '.join(named_in_file)}, got {line!r:.80}: {fix}")
        row = numbers([line[column] for column in columns], len(columns), f"{path}, line {number}")
        rows.append(np.array([len(rows) / FPS, len(rows), *row]) if named_in_file == OLDEST else row)
        if not (rows[-1][1].is_integer() and 0 <= rows[-1][1] < MOST_FRAMES):
            raise ValueError(f"{path}, line {number}: expected a number of a frame, got {rows[-1][1]:g}")
    if not rows:
        raise ValueError(f"{path}: expected a line for each frame, with {', '.join(named_in_file)}")
    if len({row[1] for row in rows}) < len(rows):
        raise ValueError(f"{path}: expected each frame once, and some come twice")
    return sorted(rows, key=lambda row: float(row[1])), notes


def _matrix(path: Path) -> ArrayF64:
    """(4,) fx, fy, cx, cy of three lines of three numbers."""
    lines = _lines(path)
    if len(lines) != 3:
        raise ValueError(f"{path}: expected three lines of three numbers, got {len(lines)}")
    matrix = np.array([numbers(line, 3, str(path)) for line in lines])
    return matrix[[0, 1, 0, 1], [0, 1, 2, 2]]


def _lines(path: Path) -> list[list[str]]:
    """Those that are not empty, split at commas. ValueError for what is no text."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return [row for row in csv.reader(file) if any(cell.strip() for cell in row)]
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected lines of numbers, and could not read it ({error})") from None


def _depth_file(folder: Path, number: int) -> Path | None:
    files = (folder / "depth" / f"{number:06d}{suffix}" for suffix in (".png", ".npy"))
    return next((path for path in files if path.is_file()), None)


def _confidence_file(folder: Path, number: int) -> Path:
    return folder / "confidence" / f"{number:06d}.png"


def _load(folder: Path, number: int, plane_depth: Path, camera: FrameCamera, video: Video) -> RgbdFrame:
    depth = read_measured(plane_depth, METRES_PER_UNIT, _confidence_file(folder, number))
    return phone_frame(video.path, video.read(number), depth, camera)
