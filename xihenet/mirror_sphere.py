"""A mirror sphere at the estimation position: what does it tell the phone of the light there?

The way of GLEAM (Prakash, Bahremand, Nguyen and LiKamWa, MobiSys 2019): a real mirror sphere stands where the virtual
object will, and each of its pixels in the camera's picture is light from the direction that it reflects. It has to be
in view, and shows nearly all directions at once; what is brighter than white is clipped as in any picture.
"""

from __future__ import annotations

import numpy as np

from xihenet.camera import MISS_PLANE_DEPTH_M, pixel_rays
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.records import ArrayBool, ArrayF64, RgbdFrame, UnitSphereCloud
from xihenet.sphere import AnchorLattice

OUTERMOST = 0.97
"""Of the sphere's radius: beyond it a pixel shows too much of the room at once, and what lies beside the sphere."""

TOLERANCE = 0.02
"""Of the sphere's distance: what is nearer than that before it hides it."""


def reflected_directions(frame: RgbdFrame, centre_m: ArrayF64, radius_m: float) -> tuple[ArrayF64, ArrayF64, ArrayBool]:
    """What each pixel of `frame` sees in a mirror sphere around `centre_m` (3,), world, metres.

    Unit directions (H, W, 3), world, from which the light comes; the plane depth (H, W) of the sphere; and which pixels
    (H, W) lie on it, within `OUTERMOST` of its radius. The others are NaN.
    """
    rotation, place_m = frame.world_from_camera[:3, :3], frame.world_from_camera[:3, 3]
    rays = pixel_rays(frame.intrinsics) @ rotation.T
    lengths = np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = rays / lengths
    to_centre_m = centre_m - place_m
    along_m = rays @ to_centre_m
    beside_m = np.sqrt(np.maximum(to_centre_m @ to_centre_m - along_m**2, 0.0))
    on_sphere = (along_m > radius_m) & (beside_m < OUTERMOST * radius_m)
    distance_m = np.where(on_sphere, along_m - np.sqrt(np.maximum(radius_m**2 - beside_m**2, 0.0)), np.nan)
    normals = (place_m + distance_m[..., None] * rays - centre_m) / radius_m
    directions = rays - 2 * (rays * normals).sum(axis=-1, keepdims=True) * normals
    return directions, distance_m / lengths[..., 0], on_sphere


def mirror_sphere_cloud(
    frame: RgbdFrame, centre_m: ArrayF64, radius_m: float, lattice: AnchorLattice
) -> UnitSphereCloud:
    """The light that `frame` shows in a mirror sphere: the mean of the pixels that reflect each anchor's directions.

    Pixels in which something stands before the sphere, by the frame's plane depth, do not count, nor do those whose
    plane depth is NaN; no anchor is set where it is not in view. Distances are not known, and 1 m wherever an anchor is
    set. ValueError for a radius that is not positive.
    """
    if not radius_m > 0:
        raise ValueError(f"mirror_sphere_cloud: expected a positive radius, got {radius_m}")
    directions, depth_m, on_sphere = reflected_directions(frame, centre_m, radius_m)
    seen_m = np.where(frame.plane_depth_m > 0, frame.plane_depth_m, MISS_PLANE_DEPTH_M)
    is_seen = on_sphere & ~np.isnan(frame.plane_depth_m) & (seen_m >= depth_m * (1 - TOLERANCE))
    means, is_set = lattice.means(directions[is_seen], srgb_to_linear(frame.srgb_u8[is_seen] / 255.0))
    return UnitSphereCloud(linear_to_srgb(means).astype(np.float32), is_set.astype(np.float32), is_set)
