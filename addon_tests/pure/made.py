"""Poses, frames and clouds that tests of many stages share; what light they need is in `sh_samples`."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.records import AnchorSurfaces, Intrinsics, RgbdFrame, UnitSphereCloud

UPRIGHT = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
"""The axes of a camera that looks along +Y with +Z up in its picture."""


def random_rotation(seed):
    """(3, 3); `seed` may be a generator."""
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.sign(np.linalg.det(matrix))


def about_z(yaw):
    """(3, 3) turn by `yaw` in radians, from +X towards +Y."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def pose_of(axes=None, place_m=(0, 0, 0)):
    """(4, 4) world_from_camera; without axes it looks down -Z."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.eye(3) if axes is None else axes, place_m
    return pose


def looked_at(cloud):
    """The cloud, if it passes its own checks: ValueError for what `UnitSphereCloud.trusted` should not have got."""
    anew = UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set, cloud.invalid, cloud.surfaces)
    for name in ("srgb", "distance_m", "is_set"):
        one, other = getattr(cloud, name), getattr(anew, name)
        assert one.dtype == other.dtype and not one.flags.writeable
    return cloud


def assert_same(a, b, rtol=1e-6):
    """Two clouds of anchors, sampled alike."""
    np.testing.assert_array_equal(a.is_set, b.is_set)
    np.testing.assert_array_equal(a.srgb, b.srgb)
    np.testing.assert_allclose(a.distance_m, b.distance_m, rtol=rtol)
    assert a.invalid == b.invalid


def frame_of(plane_depth_m, intrinsics=None, pose=None, srgb_u8=128, **fields):
    """A frame of plane depths (H, W), at the origin and of one grey unless it is said."""
    plane_depth_m = np.asarray(plane_depth_m)
    height, width = plane_depth_m.shape
    colours = np.broadcast_to(np.uint8(srgb_u8), (height, width, 3))
    intrinsics = intrinsics or Intrinsics(width, height, 1.0, 1.0, width / 2, height / 2)
    return RgbdFrame(colours, plane_depth_m, intrinsics, np.eye(4) if pose is None else pose, **fields)


def random_cloud(rng, n, share=0.5):
    """Random colours at 0 to 5 m in a random `share` of `n` anchors."""
    is_set = rng.random(n) < share
    return UnitSphereCloud(rng.random((n, 3)) * is_set[:, None], rng.uniform(0, 5, n) * is_set, is_set)


def with_facing(cloud, rng):
    """The cloud, its surfaces facing anywhere."""
    surfaces = AnchorSurfaces.of_facing(rng.uniform(-1, 1, len(cloud)))
    return UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set, surfaces=surfaces)


def without_surfaces(cloud):
    return UnitSphereCloud(cloud.srgb, cloud.distance_m, cloud.is_set)


def constant(radiance: ArrayLike) -> NDArray[np.float64]:
    """(9, 3) coefficients of light that is the same from everywhere."""
    coefficients = np.zeros((9, 3))
    coefficients[0] = 2 * np.sqrt(np.pi) * np.asarray(radiance)
    return coefficients
