"""Pixels of one frame that show a surface of other frames' points again, for checks of a recording by itself.

A point is compared with the pixel that it falls on, not with a mean of those around it: between a near and a far
surface a mean is neither. Pixels at edges of depth are left out for the same reason: their colour is mixed, and half a
pixel of error in a pose puts another surface there.
"""

from __future__ import annotations

import numpy as np

from xihenet.camera import valid_plane_depth
from xihenet.records import ArrayBool, ArrayF32, ArrayInt

EDGE_STEP = 0.1  # A pixel and its neighbour whose plane depth differs by more than this share are not of one surface


def away_from_edges(plane_depth_m: ArrayF32) -> ArrayBool:
    """(H, W) where plane depth (H, W), metres, is known and differs little from that of the four neighbours.

    Neighbours without a depth (0, infinite, NaN) are not asked: sensors leave holes within surfaces too.
    """
    valid = valid_plane_depth(plane_depth_m)
    depth_m = np.where(valid, plane_depth_m, np.nan)
    is_smooth = valid.copy()
    for one, other in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        # NaN, which is a hole, is no step.
        step = np.abs(depth_m[one] - depth_m[other]) > EDGE_STEP * np.minimum(depth_m[one], depth_m[other])
        is_smooth[one] &= ~step
        is_smooth[other] &= ~step
    return is_smooth


def thinned(pixels: ArrayInt, most: int) -> ArrayInt:
    """At most that many of these pixels (K,), evenly over them all."""
    if len(pixels) <= most:
        return pixels
    return pixels[np.linspace(0, len(pixels) - 1, most).astype(np.intp)]
