"""A camera that goes where the phone went, and projects as its lens did.

Poses are keyed as quaternions of one sign, which do not flip, and between keys everything is linear. Focal length and
shift are keyed only where they change. Blender has one focal length; pixels that are not square, fx unlike fy, are the
scene's pixel aspect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np
from mathutils import Matrix

from xihe_blender.apply.keys import key_values
from xihenet.io.frame_files import FrameCamera
from xihenet.records import ArrayF64, Intrinsics

SENSOR_MM = 36.0
SAME_PX = 1e-3
"""Intrinsics that differ by less are the same."""

CLIP_START_M = 0.02


def add_camera(name: str, cameras: Mapping[int, FrameCamera], unit_m: float) -> bpy.types.Object:
    """A camera, in no collection yet, keyed at the frames of `cameras`; `unit_m` are metres in a Blender unit."""
    item = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    item.data.clip_start = CLIP_START_M / unit_m
    key_camera(item, cameras, unit_m)
    return item


def key_camera(
    item: bpy.types.Object, cameras: Mapping[int, FrameCamera], unit_m: float, *, is_held: bool = False
) -> None:
    """Have the camera `item`, which nothing else moves, go by `cameras`, as `add_camera` says.

    With `is_held` it stays where it is at a frame until the next one of `cameras`, and goes between neighbours alone.
    """
    data, item.rotation_mode = item.data, "QUATERNION"
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    frames, poses = list(cameras), np.stack([one.world_from_camera for one in cameras.values()])
    key_values(item, "location", frames, poses[:, :3, 3] / unit_m, is_held=is_held)
    key_values(item, "rotation_quaternion", frames, quaternions(poses[:, :3, :3]), is_held=is_held)
    lenses = np.array([lens_of(one.intrinsics) for one in cameras.values()])
    changes = np.ptp(lenses, axis=0) > SAME_PX / cameras[frames[0]].intrinsics.width
    for name_of, values, is_changing in zip(("lens", "shift_x", "shift_y"), lenses.T, changes, strict=True):
        scaled = values * (SENSOR_MM if name_of == "lens" else 1.0)
        setattr(data, name_of, float(scaled[0]))
        if is_changing:
            key_values(data, name_of, frames, scaled[:, None], is_held=is_held)


def lens_of(k: Intrinsics) -> tuple[float, float, float]:
    """Focal length and Blender's shifts of a camera whose sensor fits the picture's width, all in such widths."""
    return k.fx / k.width, (k.width / 2 - k.cx) / k.width, (k.cy - k.height / 2) / k.width * k.fx / k.fy


def pixel_aspect(cameras: Sequence[FrameCamera]) -> tuple[float, float]:
    """Width and height of a pixel as Blender has them, 1 at least: the median of all frames."""
    ratio = float(np.median([one.intrinsics.fy / one.intrinsics.fx for one in cameras]))
    if abs(ratio - 1) < 1e-6:
        return 1.0, 1.0
    return max(1.0, ratio), max(1.0, 1 / ratio)


def quaternions(rotations: ArrayF64) -> ArrayF64:
    """(N, 4) w, x, y, z of rotations (N, 3, 3), each of the sign that is next to the one before."""
    found = np.array([Matrix(one.tolist()).to_quaternion() for one in rotations], np.float64)
    turns = np.where((found[1:] * found[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    found[1:] *= np.cumprod(turns)[:, None]
    return found
