"""A room with furniture and patterned surfaces, ray-cast here, and walks through it: known depth, light and poses."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from addon_tests.pure.made import pose_of
from addon_tests.pure.recordings import looking
from xihenet.camera import encode_exposed, pixel_rays
from xihenet.records import Intrinsics, RgbdFrame

PHONE = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)
ROOM = np.array([[-3.0, -2.5, 0.0], [3.0, 2.5, 2.6]])


def furniture(seed, n=5):
    """(n, 2, 3) lower and upper corners of boxes that stand along the walls, so that the middle is free to walk in."""
    rng = np.random.default_rng(seed)
    boxes = []
    for i in range(n):
        size = rng.uniform([0.4, 0.4, 0.4], [1.1, 1.1, 1.9])
        low = np.append(rng.uniform(ROOM[0, :2], ROOM[1, :2] - size[:2]), 0.0)
        axis = i % 2
        low[axis] = rng.choice([ROOM[0, axis], ROOM[1, axis] - size[axis]])
        boxes.append([low, low + size])
    return np.array(boxes)


def cast(intrinsics, pose, boxes):
    """Plane depth (H, W), points (H, W, 3) and the number of the surface (H, W): 6 to a box, the room's come first."""
    rays = pixel_rays(intrinsics) @ pose[:3, :3].T
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    # By axes first, whose three numbers are compared in whole pictures.
    along = np.ascontiguousarray(np.moveaxis(rays, -1, 0))
    depth, surface = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape[:2], int)
    for number, box in enumerate([ROOM, *boxes]):
        reach = (box - pose[:3, 3])[..., None, None] / along
        is_room = number == 0
        by_axis = np.maximum(*reach) if is_room else np.minimum(*reach)
        axis = by_axis.argmin(axis=0) if is_room else by_axis.argmax(axis=0)
        met = np.take_along_axis(by_axis, axis[None], 0)[0]
        is_nearer = (met > 0) & (met < depth)
        if not is_room:
            is_nearer &= met < np.maximum(*reach).min(axis=0)
        if not is_nearer.any():
            continue
        upper = (np.take_along_axis(along, axis[None], 0)[0] > 0) == is_room
        depth = np.where(is_nearer, met, depth)
        surface = np.where(is_nearer, 6 * number + 2 * axis + upper, surface)
    return depth, pose[:3, 3] + depth[..., None] * rays, surface


def radiance(points, surface, seed=0):
    """(H, W, 3) linear light that each point gives off, the same in all directions: a pattern of its surface's own."""
    colours = np.random.default_rng(seed).uniform(0.08, 0.45, (600, 3))[surface]
    waves = np.sin(2.6 * points[..., 0] + surface) + np.sin(3.1 * points[..., 1]) + np.sin(2.2 * points[..., 2])
    return colours * (1 + 0.15 * waves[..., None]) * (0.7 + 0.12 * points[..., 2:])


def picture(linear, gain=1.0, noise=0.0, rng=None):
    """8-bit sRGB of linear light times a gain, with noise in proportion to its root, clipped."""
    exposed = linear * gain
    if noise:
        exposed = exposed + noise * np.sqrt(exposed) * rng.normal(size=exposed.shape)
    return encode_exposed(exposed, 1.0)


def seen(pose, boxes, number=0, *, gain=1.0, noise=0.0, rng=None, intrinsics=PHONE, lit=None):
    """A frame of the room; `lit` (points -> factor of the light there) stands for a lamp."""
    depth, points, surface = cast(intrinsics, pose, boxes)
    linear = radiance(points, surface)
    if lit is not None:
        linear = linear * lit(points)[..., None]
    colour = picture(linear, gain, noise, rng)
    return RgbdFrame(colour, depth.astype(np.float32), intrinsics, pose, frame=number, time_s=number / 30)


def walk_poses(seed, n=12, turn=None, length_m=None):
    """n poses of a smooth walk through the middle of the room: at least 1 m, and turning by at least 90 degrees."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(np.pi / 2, 2 * np.pi) if turn is None else turn
    length_m = rng.uniform(1.1, 2.2) if length_m is None else length_m
    azimuth, course, side = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi), rng.choice([-1, 1])
    poses = []
    for share in np.linspace(0, 1, n):
        along = length_m * (share - 0.5)
        across = 0.25 * np.sin(2 * np.pi * share)
        place = [
            along * np.cos(course) - across * np.sin(course),
            along * np.sin(course) + across * np.cos(course),
            1.4 + 0.2 * np.sin(5 * share + seed),
        ]
        poses.append(looking(azimuth + side * turn * share, 0.3 * np.sin(4 * share + seed) - 0.15, place))
    return poses


def as_measured(frames, seed, degrees=1.5):
    """The frames with 1 % of noise in depth, holes of each kind in a fifth of it, and poses some degrees and cm off."""
    rng, measured = np.random.default_rng(1000 + seed), []
    for frame in frames:
        depth = frame.plane_depth_m * rng.normal(1, 0.01, frame.plane_depth_m.shape)
        depth = np.where(rng.random(depth.shape) < 0.2, rng.choice([0, np.nan, np.inf, -1], depth.shape), depth)
        axis = rng.normal(size=3)
        turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
        pose = pose_of(frame.world_from_camera[:3, :3] @ turn, frame.world_from_camera[:3, 3] + rng.normal(0, 0.01, 3))
        measured.append(replace(frame, plane_depth_m=depth, world_from_camera=pose))
    return measured
