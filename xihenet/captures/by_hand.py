"""A recording whose scale or floor is known better than it knows itself: both are set by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.records import RgbdFrame


def set_by_hand(capture: Capture, *, scale: float = 1.0, floor_m: float = 0.0) -> Capture:
    """The recording with lengths `scale` times as long, and then `floor_m` lower, so that the floor is at height 0.

    Poses and depth are scaled alike. ValueError for a scale that is not positive, or a floor that is not finite.
    """
    if not 0 < scale < np.inf:
        raise ValueError(f"the scale of a recording is a positive factor: {scale:g} is none")
    if not np.isfinite(floor_m):
        raise ValueError(f"the floor of a recording is a height in metres: {floor_m:g} is none")
    if (scale, floor_m) == (1.0, 0.0):
        return capture
    return replace(capture, frames=[_placed(frame, scale, floor_m) for frame in capture.frames])


def _placed(frame: CapturedFrame, scale: float, floor_m: float) -> CapturedFrame:
    pose = frame.camera.world_from_camera.copy()
    pose[:3, 3] = scale * pose[:3, 3] - (0, 0, floor_m)

    def placed(read: RgbdFrame) -> RgbdFrame:
        return replace(read, world_from_camera=pose, plane_depth_m=read.plane_depth_m * np.float32(scale))

    return frame.changed(placed, replace(frame.camera, world_from_camera=pose))
