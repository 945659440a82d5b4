"""Recordings of the app Record3D: one .r3d file, a zip of `metadata` and of rgbd/N.jpg, N.depth and N.conf.

Poses are camera to world as quaternion and place, the camera looks along -Z with +Y up. They begin at the first camera,
and `initPose` is where that one was in ARKit's world, which has +Y up; or `initPose` turns and moves nothing, and the
poses are in that world themselves. Where neither turns or moves anything, or without `initPose`, up is not known: the
floor is looked for. K, column by column, and the intrinsics of each frame are for the colour's size. Depth is float32
in metres and confidence 0, 1, 2, both packed by LZFSE, row by row; depth lies as the colour does, upright or not. Only
captures with LiDAR have poses: those of the face sensor neither turn nor move. One with a number that is not finite is
of a moment at which tracking was lost, as good as none.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.captures.capture import EXTRA, Capture, CapturedFrame
from xihenet.captures.floor import upright
from xihenet.captures.reading.phone_frame import confidence_levels, left_out, measured, phone_frame, without_confidence
from xihenet.captures.reading.values import notes_on_times, numbers, pose_numbers, pose_of
from xihenet.io.frame_files import BLENDER_FROM_UP, FrameCamera, frame_camera
from xihenet.io.json_files import named, number_in, parse_json, side_in
from xihenet.io.picture_size import MOST_PIXELS, same_field
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame

METADATA, SUFFIX = "metadata", ".r3d"
OF_EXPORT, EXPORTED_DEPTH = "metadata.json", "depth/*.exr"
NAME = re.compile(r"rgbd/(\d{1,9})\.depth")
MAGIC = b"PK"
BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, LookupError)
"""What zipfile raises for files that are none, are cut short, or are encrypted."""

MOST_BYTES = 2**26  # Of a member; an hour at 60 frames a second has 50 MB of metadata
USUAL_FPS = 60.0
AT_ORIGIN = 1e-4  # Who begins so near to the origin of the world, along its axes, has the first camera's own world


def is_in(path: Path) -> bool:
    if not path.is_file():
        return ((path / METADATA).is_file() and (path / "rgbd").is_dir()) or _is_export(path)
    with path.open("rb") as file:
        return file.read(2) == MAGIC or path.suffix.lower() == SUFFIX


def _is_export(folder: Path) -> bool:
    return (folder / OF_EXPORT).is_file() and (folder / "rgb").is_dir() and any(folder.glob(EXPORTED_DEPTH))


def read(path: Path, up: str | None) -> Capture:
    """As of `xihenet.captures.open_capture`; ImportError without the package lzfse, where the floor is looked for."""
    if _is_export(path):
        raise ValueError(f"{path} is what Record3D exports as EXR and JPG: export the recording as {SUFFIX} instead")
    if path.is_dir():
        raise ValueError(f"{path} is an unpacked {SUFFIX} file: give that file, or a zip of what is in the folder")
    try:
        archive = zipfile.ZipFile(path)
    except BROKEN as error:
        raise ValueError(f"{path}: no whole zip file ({error}): copy it again") from None
    members = set(archive.namelist())
    if METADATA not in members:
        raise ValueError(
            f"{path}: {METADATA} is missing, which Record3D stores at the top of its file: "
            "if another app made it, unpack the zip and give the folder in it"
        )
    content = _metadata(archive)
    with named(f"{path}, {METADATA}"):
        size, depth_size, notes = _sizes(content)
        n_said, poses, k, times_s = _by_frame(content, size)
        start = np.eye(4)
        if (first := content.get("initPose")) is not None:
            start = _pose(numbers(first, 7, "initPose"), "initPose")
        begin = start @ next((pose for pose in poses if pose is not None), np.eye(4))
        knows_up = first is not None and not np.allclose(begin, np.eye(4), atol=AT_ORIGIN)
        assumed = up or "y"
        cameras = [
            None if pose is None else frame_camera(Intrinsics(*size, *one), (start @ pose).tolist(), up=assumed)
            for one, pose in zip(k.tolist(), poses, strict=True)
        ]
    numbers_of = sorted(int(found[1]) for name in members if (found := NAME.fullmatch(name)))
    there = {
        n: camera
        for n in numbers_of
        if n < len(cameras) and (camera := cameras[n]) is not None and f"rgbd/{n}.jpg" in members
    }
    if len(poses) > 1 and not knows_up and all(pose is None or np.array_equal(pose, np.eye(4)) for pose in poses):
        notes += ("No pose turns or moves, as where Record3D has none: record with LiDAR, not with the face sensor.",)
    if not there:
        raise ValueError(f"{path}: no frame has colour, depth and a pose: record with LiDAR")
    begin_s = times_s[next(iter(there))]
    frames = [
        CapturedFrame(n, float(times_s[n] - begin_s), camera, partial(_load, archive, n, camera, depth_size))
        for n, camera in there.items()
    ]
    notes += notes_on_times([frame.time_s for frame in frames])
    notes += left_out(max(n_said, len(numbers_of)) - len(there), "colour, depth or a pose")
    are_sure = [f"rgbd/{n}.conf" in members for n in there]
    if any(are_sure):
        notes += without_confidence(are_sure)
    capture = Capture("Record3D", frames, BLENDER_FROM_UP[assumed], notes)
    return capture if up is not None or knows_up else upright(capture, assumed)


def _content(archive: zipfile.ZipFile, name: str) -> bytes:
    try:
        if (n := archive.getinfo(name).file_size) > MOST_BYTES:  # No more than it says is read.
            raise ValueError(f"expected at most {MOST_BYTES} bytes, got {n}")
        return archive.read(name)
    except BROKEN as error:
        raise ValueError(f"{archive.filename}: {name} cannot be read ({error}): copy the file again") from None


def _unpacked(archive: zipfile.ZipFile, name: str, most_bytes: int) -> bytes:
    """What LZFSE has packed in a member. ImportError, naming the extra, without the package."""
    try:
        import lzfse
    except ImportError as error:
        raise ImportError(f"the depth of Record3D is unpacked by lzfse: {EXTRA}") from error
    packed = _content(archive, name)
    try:
        if _said_bytes(packed) <= most_bytes:
            return bytes(lzfse.decompress(packed))
    except (lzfse.error, MemoryError, struct.error, KeyError):
        raise ValueError(
            f"{archive.filename}: {name}: expected LZFSE, and could not unpack it: copy it again"
        ) from None
    raise ValueError(f"{archive.filename}: {name}: it unpacks to more than the {most_bytes} bytes that are expected")


def _said_bytes(packed: bytes) -> int:
    """How many bytes blocks of LZFSE (lzfse_internal.h) say that they hold: fifty may hold 27 MB.

    KeyError for what is no block, struct.error for one that is cut short.
    """
    at = total = 0
    while (magic := packed[at : at + 4]) != b"bvx$":
        n_bytes, n_packed = struct.unpack_from("<2I", packed, at + 4)
        sizes = {b"bvx-": 8 + n_bytes, b"bvxn": 12 + n_packed, b"bvx1": 772 + n_packed}
        if magic == b"bvx2":
            first, second, third = struct.unpack_from("<3Q", packed, at + 8)
            sizes[magic] = (first >> 20 & 0xFFFFF) + (second >> 40 & 0xFFFFF) + (third & 0xFFFFFFFF)
        at, total = at + max(8, sizes[magic]), total + n_bytes
    return total


def _metadata(archive: zipfile.ZipFile) -> dict[str, Any]:
    content = _content(archive, METADATA)
    try:
        said = parse_json(content.decode("utf-8-sig"))
    except ValueError as error:
        raise ValueError(f"{archive.filename}, {METADATA}: expected JSON, and could not read it ({error})") from None
    if not isinstance(said, dict):
        raise ValueError(f"{archive.filename}, {METADATA}: expected a JSON object")
    return said


def _sizes(content: dict[str, Any]) -> tuple[tuple[int, int], tuple[int, int] | None, tuple[str, ...]]:
    """Width and height of colour and, where they are given, of depth, which lies as colour does; and notes."""
    size = side_in(content, "w"), side_in(content, "h")
    if "dw" not in content or "dh" not in content:
        return size, None, ()
    depth = side_in(content, "dw"), side_in(content, "dh")
    if depth[0] * depth[1] > MOST_PIXELS:
        raise ValueError(f"dw and dh: {depth[0]}x{depth[1]} pixels of depth are more than are read")
    if not same_field(*size, *depth) and same_field(*size, *depth[::-1]):
        said = f"Depth of {depth[0]}x{depth[1]} pixels is taken as {depth[1]}x{depth[0]}, since colour lies so."
        return size, depth[::-1], (said,)
    return size, depth, ()


def _by_frame(content: dict[str, Any], size: tuple[int, int]) -> tuple[int, list[ArrayF64 | None], ArrayF64, ArrayF64]:
    """How many frames are spoken of; poses, fx, fy, cx, cy (N, 4) and times (N,), seconds, of those with all.

    A pose is (4, 4), or None where tracking was lost.
    """
    rows = [pose_numbers(row, 7, f"poses, frame {i}") for i, row in enumerate(_rows({"poses": [], **content}, "poses"))]
    poses = [None if row is None else _pose(row, f"poses, frame {i}") for i, row in enumerate(rows)]
    if not poses:
        raise ValueError("poses: there are none: record with LiDAR, the face sensor has no poses")
    if content.get("perFrameIntrinsicCoeffs"):
        name = "perFrameIntrinsicCoeffs"
        k = np.array([numbers(row, 4, f"{name}, frame {i}") for i, row in enumerate(_rows(content, name))])
    else:
        matrix = numbers(content.get("K"), 9, "K")
        k = np.broadcast_to(matrix[[0, 4, 6, 7]], (len(poses), 4))
    if content.get("frameTimestamps"):
        times = content["frameTimestamps"]
        times_s = numbers(times, len(times) if isinstance(times, list) else 0, "frameTimestamps")
    else:
        fps = number_in(content, "fps", USUAL_FPS)
        if not 1e-3 <= fps <= 1e6:
            raise ValueError(f"fps: expected frames a second, got {fps:g}")
        times_s = np.arange(len(poses)) / fps
    lengths = len(poses), len(k), len(times_s)
    n = min(lengths)
    return max(lengths), poses[:n], k[:n], times_s[:n]


def _rows(content: dict[str, Any], name: str) -> list[Any]:
    rows = content.get(name)
    if not isinstance(rows, list):
        raise ValueError(f"{name}: expected a list, got {rows!r:.80}")
    return rows


def _pose(row: ArrayF64, name: str) -> ArrayF64:
    """(4, 4) of qx, qy, qz, qw, x, y, z."""
    return pose_of(row[4:], row[:4], name)


def _load(archive: zipfile.ZipFile, n: int, camera: FrameCamera, size: tuple[int, int] | None) -> RgbdFrame:
    source = Path(str(archive.filename)) / "rgbd" / f"{n}.depth"  # Names it; there is no such file.
    k = camera.intrinsics
    most = size[0] * size[1] if size else min(k.width * k.height, MOST_PIXELS)
    unpacked = _unpacked(archive, f"rgbd/{n}.depth", 4 * most)
    width, height = size or _size_as(k, len(unpacked) // 4, source)
    if len(unpacked) != 4 * width * height:
        raise ValueError(f"{source}: expected {width}x{height} distances of 4 bytes, got {len(unpacked)} bytes")
    plane_depth_m = np.frombuffer(unpacked, "<f4").reshape(height, width)
    confidence = None
    if (name := f"rgbd/{n}.conf") in archive.NameToInfo:
        levels = _unpacked(archive, name, most)
        if len(levels) != width * height:
            raise ValueError(f"{source.with_suffix('.conf')}: expected {width}x{height} bytes, got {len(levels)}")
        confidence = confidence_levels(np.frombuffer(levels, np.uint8).reshape(height, width))
    # The sensor's NaN is a distance that it has not got; the colour there is sound.
    depth = measured(source, np.nan_to_num(plane_depth_m, nan=0.0, posinf=np.inf, neginf=0.0), confidence)
    return phone_frame(source.with_suffix(".jpg"), _content(archive, f"rgbd/{n}.jpg"), depth, camera)


def _size_as(k: Intrinsics, n: int, source: Path) -> tuple[int, int]:
    """Width and height of `n` pixels that show the same field as colour. ValueError if there are none."""
    width = round(math.sqrt(n * k.width / k.height))
    if width < 1 or n % width or not same_field(width, n // width, k.width, k.height):
        raise ValueError(f"{source}: {n} distances are no picture as wide and high as one of {k.width}x{k.height}")
    return width, n // width
