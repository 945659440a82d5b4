"""Frames as the app Record3D has them; the layout is that of `xihenet.captures.reading.record3d`."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.camera import valid_plane_depth
from xihenet.captures.capture import EXTRA
from xihenet.captures.reading.record3d import METADATA
from xihenet.captures.reading.values import quaternion_of
from xihenet.captures.writing.pictures import (
    USUAL,
    Form,
    Written,
    colour_bytes,
    confidence_of,
    enlarged_intrinsics,
    in_y_up,
)
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame

FPS = 30.0  # Of a single frame


def write(path: Path, frames: Iterable[RgbdFrame], form: Form = USUAL) -> Written:
    """One .r3d file, whole or absent; colour is JPEG.

    OSError if it cannot be written, ValueError for frames of several sizes or none, ImportError without lzfse.
    """
    try:
        import lzfse
    except ImportError as error:
        raise ImportError(f"the depth of Record3D is packed by lzfse: {EXTRA}") from error
    form, poses, k, times_s = replace(form, is_jpeg=True), [], [], []
    start = size = None
    path.parent.mkdir(exist_ok=True, parents=True)
    beside = path.with_name(f".{path.name}.part")
    try:
        with zipfile.ZipFile(beside, "w") as file:
            for n, frame in enumerate(frames):
                pose = in_y_up(frame.world_from_camera)
                start = pose if start is None else start
                size = frame.intrinsics if size is None else size
                if (frame.intrinsics.width, frame.intrinsics.height) != (size.width, size.height):
                    raise ValueError("Record3D: expected frames of one size")
                poses.append(_row(np.linalg.inv(start) @ pose))
                large = enlarged_intrinsics(frame.intrinsics, form.colour_scale)
                k.append([float(large.fx), float(large.fy), float(large.cx), float(large.cy)])
                times_s.append(frame.time_s)
                valid = valid_plane_depth(frame.plane_depth_m)
                depth = np.where(valid, frame.plane_depth_m, np.float32(np.nan)).astype("<f4")
                file.writestr(f"rgbd/{n}.jpg", colour_bytes(frame, form))
                file.writestr(f"rgbd/{n}.depth", lzfse.compress(depth.tobytes()))
                file.writestr(f"rgbd/{n}.conf", lzfse.compress(confidence_of(frame).tobytes()))
            if start is None or size is None:
                raise ValueError("Record3D: expected at least one frame")
            content = {**_metadata(size, form.colour_scale, poses, k, times_s), "initPose": _row(start)}
            file.writestr(METADATA, json.dumps(content, allow_nan=False))
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    return Written(len(poses))


def _metadata(
    size: Intrinsics, scale: int, poses: list[list[float]], k: list[list[float]], times_s: list[float]
) -> dict[str, Any]:
    fx, fy, cx, cy = k[0]
    lasts_s = times_s[-1] - times_s[0]
    return {
        "w": size.width * scale,
        "h": size.height * scale,
        "dw": size.width,
        "dh": size.height,
        "fps": (len(times_s) - 1) / lasts_s if lasts_s > 0 else FPS,
        "K": [fx, 0.0, 0.0, 0.0, fy, 0.0, cx, cy, 1.0],
        "perFrameIntrinsicCoeffs": k,
        "frameTimestamps": times_s,
        "poses": poses,
    }


def _row(pose: ArrayF64) -> list[float]:
    return [*quaternion_of(pose[:3, :3]).tolist(), *pose[:3, 3].tolist()]
