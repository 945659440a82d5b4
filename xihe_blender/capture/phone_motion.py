"""How does the camera move while it takes a frame? As it does to the scene's next frame, which needs no rendering."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from xihe_blender.capture.scanner import CyclesScanner
from xihenet.phone import CameraMotion, motion_between
from xihenet.records import ArrayF64

STILL = CameraMotion(np.zeros(3), np.zeros(3))


def camera_motions(scanner: CyclesScanner, frames: Collection[int], first: int, last: int) -> dict[int, CameraMotion]:
    """How the camera moves in each of `frames`: evenly to the next frame of the scene, at the last from the one before.

    A camera that is switched, or turned by half a circle within a frame, was cut and stands still. `first` and `last`
    are the scene's; one frame alone has no motion. The scanner's scene is left at another frame.
    """
    wanted = {f + step for f in frames for step in (-1, 0, 1) if first <= f + step <= last}
    poses, times_s, cameras = {}, {}, {}
    for frame in sorted(wanted):
        _, poses[frame] = scanner.move_to(frame)
        times_s[frame], cameras[frame] = scanner.time_s, scanner.scene.camera
    return {frame: _motion(frame, poses, times_s, cameras) for frame in frames}


def _motion(
    frame: int, poses: Mapping[int, ArrayF64], times_s: Mapping[int, float], cameras: Mapping[int, Any]
) -> CameraMotion:
    for before, after in ((frame, frame + 1), (frame - 1, frame)):
        if before not in poses or after not in poses or cameras[before] != cameras[after]:
            continue
        try:
            return motion_between(poses[before], poses[after], times_s[after] - times_s[before])
        except ValueError:
            continue
    return STILL


def fastest(velocities: Collection[ArrayF64]) -> float:
    """The largest length of any of `velocities` (3,), in their unit; 0 without one."""
    return max((float(np.linalg.norm(velocity)) for velocity in velocities), default=0.0)
