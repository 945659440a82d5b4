"""How does the camera move while it takes a frame? As it does to the scene's next frame, which needs no rendering."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import bpy
import numpy as np

from xihenet.phone import CameraMotion, motion_between
from xihenet.records import ArrayF64, Intrinsics

STILL = CameraMotion(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class CameraView:
    """What the scene's camera is at one frame: which, its intrinsics and pose (4, 4) in metres, and the time."""

    camera: bpy.types.Object
    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    time_s: float


def camera_motion(frame: int, views: Mapping[int, CameraView]) -> CameraMotion:
    """How the camera moves in `frame`: evenly to the next one of `views`, or as from the one before.

    A camera that is switched, or turned by half a circle within a frame, was cut and stands still, as one does of which
    neither is known.
    """
    for before, after in ((frame, frame + 1), (frame - 1, frame)):
        if before not in views or after not in views or views[before].camera != views[after].camera:
            continue
        start, end = views[before], views[after]
        try:
            return motion_between(start.world_from_camera, end.world_from_camera, end.time_s - start.time_s)
        except ValueError:
            continue
    return STILL


def fastest(velocities: Collection[ArrayF64]) -> float:
    """The largest length of any of `velocities` (3,), in their unit; 0 without one."""
    return max((float(np.linalg.norm(velocity)) for velocity in velocities), default=0.0)
