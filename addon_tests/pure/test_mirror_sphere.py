"""A mirror sphere in a picture that is drawn here, from light that is known in every direction."""

from __future__ import annotations

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, pose_of
from xihenet import sh
from xihenet.camera import pixel_rays
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.estimators import load
from xihenet.mirror_sphere import OUTERMOST, mirror_sphere_cloud, reflected_directions
from xihenet.records import Intrinsics
from xihenet.sphere import AnchorLattice

SIDE = 200
CAMERA = Intrinsics(SIDE, SIDE, 900.0, 900.0, SIDE / 2, SIDE / 2)
CENTRE, RADIUS = np.array([0.3, -1.0, 0.8]), 0.1
LATTICE = AnchorLattice(320)
LIGHT = np.concatenate([np.full((1, 3), 1.2), np.random.default_rng(0).normal(size=(8, 3)) * 0.12])


def looking_at_the_sphere(distance_m=1.2, picture=0, plane_depth_m=None, yaw=0.7):
    """The camera looks at CENTRE from `distance_m` away, turned about the vertical."""
    back = np.array([np.sin(yaw), -np.cos(yaw), 0.3])
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0, 1], back)
    right /= np.linalg.norm(right)
    pose = pose_of(np.stack([right, np.cross(back, right), back], axis=1), CENTRE + distance_m * back)
    return frame_of(np.full((SIDE, SIDE), 3.0) if plane_depth_m is None else plane_depth_m, CAMERA, pose, picture)


def drawn(yaw=0.7):
    frame = looking_at_the_sphere(yaw=yaw)
    directions, depth_m, on_sphere = reflected_directions(frame, CENTRE, RADIUS)
    radiance = np.zeros((SIDE, SIDE, 3))
    radiance[on_sphere] = sh.basis(directions[on_sphere]) @ LIGHT
    picture = np.round(linear_to_srgb(radiance.clip(0, 1)) * 255).astype(np.uint8)
    depth = np.where(on_sphere, depth_m, 3.0).astype(np.float32)
    return looking_at_the_sphere(picture=picture, plane_depth_m=depth, yaw=yaw)


def test_middle_of_the_sphere_shows_the_camera_and_every_ray_is_reflected():
    frame = looking_at_the_sphere()
    directions, depth_m, on_sphere = reflected_directions(frame, CENTRE, RADIUS)
    back = frame.world_from_camera[:3, 2]
    middle = directions[SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, back, atol=1e-3)
    assert depth_m[SIDE // 2, SIDE // 2] == pytest.approx(1.1, abs=1e-3)
    np.testing.assert_allclose(np.linalg.norm(directions[on_sphere], axis=-1), 1.0)
    assert np.isnan(directions[~on_sphere]).all()
    points_m = depth_m[..., None] * pixel_rays(CAMERA) @ frame.world_from_camera[:3, :3].T
    points_m += frame.world_from_camera[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(points_m - CENTRE, axis=-1)[on_sphere], RADIUS)
    rim_px = CAMERA.fx * np.tan(np.arcsin(OUTERMOST * RADIUS / 1.2))
    assert on_sphere.sum() == pytest.approx(np.pi * rim_px**2, rel=0.01)
    # Nearly all of the sphere of directions is seen: at the rim, what is behind.
    assert (directions[on_sphere] @ back).min() < -0.8


@pytest.mark.parametrize("yaw", [0.0, 0.7, 3.0])
def test_light_is_that_which_the_sphere_reflects_wherever_the_camera_stands(yaw):
    lattice = AnchorLattice(1280)
    cloud = mirror_sphere_cloud(drawn(yaw), CENTRE, RADIUS, lattice)
    assert cloud.is_set.mean() > 0.9
    shown = srgb_to_linear(cloud.srgb[cloud.is_set])
    expected = (sh.basis(lattice.directions[cloud.is_set]) @ LIGHT).clip(0, 1)
    assert np.sqrt(np.mean((shown - expected) ** 2)) < 0.02
    estimate = load("projection").estimate(cloud)
    assert np.sqrt(np.mean((estimate - LIGHT) ** 2)) < 0.02


def test_what_stands_before_the_sphere_hides_it():
    frame = drawn()
    near = frame.plane_depth_m.copy()
    near[:, : SIDE // 2] = 0.5
    hidden = looking_at_the_sphere(picture=frame.srgb_u8, plane_depth_m=near)
    whole = mirror_sphere_cloud(frame, CENTRE, RADIUS, AnchorLattice(1280)).is_set.sum()
    half = mirror_sphere_cloud(hidden, CENTRE, RADIUS, AnchorLattice(1280)).is_set.sum()
    assert half == pytest.approx(whole / 2, rel=0.1)
    behind = looking_at_the_sphere(distance_m=-1.2)
    assert not mirror_sphere_cloud(behind, CENTRE, RADIUS, AnchorLattice(1280)).is_set.any()


def test_pixels_whose_colour_is_not_to_be_used_show_no_light():
    frame = drawn()
    broken = np.random.default_rng(0).random((SIDE, SIDE)) < 0.3
    picture, depth = frame.srgb_u8.copy(), frame.plane_depth_m.copy()
    picture[broken], depth[broken] = 0, np.nan
    cloud = mirror_sphere_cloud(looking_at_the_sphere(picture=picture, plane_depth_m=depth), CENTRE, RADIUS, LATTICE)
    whole = mirror_sphere_cloud(frame, CENTRE, RADIUS, LATTICE)
    both = cloud.is_set & whole.is_set
    assert both.sum() > 0.7 * whole.is_set.sum() and np.abs(cloud.srgb[both] - whole.srgb[both]).max() < 0.1


def test_radius_must_be_positive():
    with pytest.raises(ValueError, match="positive radius, got 0"):
        mirror_sphere_cloud(drawn(), CENTRE, 0, AnchorLattice(8))
