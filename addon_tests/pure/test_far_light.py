"""Pixels without a distance say what light comes from far away, wherever nothing nearer is known."""

import numpy as np
import pytest

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of, random_cloud
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.buffers import merge_in_sight
from xihenet.camera import pixel_rays, project_points, unproject_frame
from xihenet.controller import ControllerSettings, XiheController
from xihenet.records import FAR_FROM_M, FAR_M, Intrinsics, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sampling_reference import sample_unit_sphere_reference
from xihenet.sphere import AnchorLattice
from xihenet.training.dataset import RoomChange
from xihenet.trigger import TriggerSettings

LATTICE = AnchorLattice(1280)
CAMERA = Intrinsics(96, 72, 60.0, 60.0, 48.0, 36.0)
SKY, WALL = (90, 160, 250), (60, 50, 40)


def window(opening=0.0, yaw=0.0, place_m=(0.0, -2.0, 0.3), last=96, is_apart=True):
    """A wall 3 m ahead, and the sky to the right of it; `opening` is the plane depth that the sky has.

    With a `last` column before the picture's the wall goes on behind it. Unless the sky `is_apart` from the wall, its
    rim broken, it is a window in it.
    """
    plane_depth_m, colours = np.full((72, 96), 3.0, np.float32), np.empty((72, 96, 3), np.uint8)
    colours[:] = WALL
    if is_apart:
        plane_depth_m[19:41, 59 : last + 1] = np.nan
    plane_depth_m[20:40, 60:last], colours[20:40, 60:last] = opening, SKY
    return frame_of(plane_depth_m, CAMERA, pose_of(about_z(yaw) @ UPRIGHT, place_m), colours)


def is_sky(cloud):
    return cloud.is_set & (cloud.srgb[:, 2] > 0.9)


@pytest.mark.parametrize("opening", [0.0, -1.0, np.inf, 1e10])
def test_the_sky_is_seen_in_the_directions_of_its_pixels_and_far_away(opening):
    frame = window(opening)
    sampled = sample_unit_sphere(unproject_frame(frame), (0.3, -1.2, 0.2), LATTICE)
    sky = is_sky(sampled)
    assert sky.sum() > 8 and (sampled.distance_m[sky] > FAR_FROM_M).all() and (sampled.distance_m[~sky] < 5).all()
    # From far away a direction is that from the camera, within half of the 6 degrees between two anchors, 5 pixels.
    place_m = frame.world_from_camera[:3, 3]
    pixels, _ = project_points(place_m + LATTICE.directions[sky], CAMERA, frame.world_from_camera)
    across, up = pixels.T
    assert (across > 60 - 4).all() and (across < 96 + 4).all() and (up > 20 - 5).all() and (up < 40 + 5).all()
    assert (sampled.surfaces.facing[sky] == 1).all() and (sampled.surfaces.camera_distance_m[sky] == FAR_M).all()
    assert sampled.n_invalid_points == 22 * 37


@pytest.mark.parametrize("opening", [0.0, -1.0, np.inf, 1e10])
@pytest.mark.parametrize("before_it", [3.0, 1.2])
def test_light_through_a_window_comes_from_the_window_wherever_it_is_seen_from(opening, before_it):
    """From a step aside it is where the hole in the wall is, and not where the phone saw the sky.

    Also if something stands before its lower edge.
    """
    frame = window(opening, last=90, is_apart=False)
    plane_depth_m = frame.plane_depth_m.copy()
    plane_depth_m[40:50, 60:90] = before_it
    cloud = unproject_frame(frame_of(plane_depth_m, CAMERA, frame.world_from_camera, frame.srgb_u8))
    assert cloud.grid.far is None and not cloud.invalid
    position_m = np.array([1.4, -0.3, 0.2])
    sampled = sample_unit_sphere(cloud, position_m, LATTICE)
    sky = is_sky(sampled)
    assert (sampled.distance_m[sky] > FAR_FROM_M).all() and (sampled.surfaces.facing[sky] == 1).all()
    directions = LATTICE.directions[sky]
    at = position_m + directions * ((1 - position_m[1]) / directions[:, 1])[:, None]
    # The wall is at y = 1; pixels 60 to 90 look through it from x = 0.6 to 2.1, rows 20 to 40 from z = 0.1 to 1.1.
    half_an_anchor = 0.06 * 1.6 + (0 if before_it == 3 else 0.02)
    assert sky.sum() > 30
    assert (at[:, 0] > 0.6 - half_an_anchor).all() and (at[:, 0] < 2.1 + half_an_anchor).all()
    assert (at[:, 2] > 0.1 - half_an_anchor).all() and (at[:, 2] < 1.1 + half_an_anchor).all()


def test_light_through_a_window_has_the_colour_of_its_direction():
    """What is far away looks alike from every place in the room: a sky that has another colour in every direction."""
    frame = window(last=90, is_apart=False)
    rays = pixel_rays(CAMERA) @ frame.world_from_camera[:3, :3].T
    sky = np.rint(127 + 127 * rays / np.linalg.norm(rays, axis=-1, keepdims=True)).astype(np.uint8)
    colours = np.where((frame.plane_depth_m == 3)[..., None], frame.srgb_u8, sky)
    cloud = unproject_frame(frame_of(frame.plane_depth_m, CAMERA, frame.world_from_camera, colours))
    for position_m in ((1.4, -0.3, 0.2), (-0.5, 0.2, 0.4), (0.8, -2.5, 0.3)):
        sampled = sample_unit_sphere(cloud, position_m, LATTICE)
        far = sampled.is_set & (sampled.distance_m > FAR_FROM_M)
        turned = np.linalg.norm(2 * sampled.srgb[far] - 1 - LATTICE.directions[far], axis=1)
        pixels, depth_m = project_points(
            frame.world_from_camera[:3, 3] + LATTICE.directions[far], CAMERA, frame.world_from_camera
        )
        was_seen = (depth_m > 0) & (pixels >= [60, 20]).all(axis=1) & (pixels < [90, 40]).all(axis=1)
        assert far.sum() > 5 and (turned[was_seen] < 0.06).all()
        # Where no pixel of the window looked, as near to it as one did.
        looked = rays[20:40, 60:90].reshape(-1, 3) / np.linalg.norm(
            rays[20:40, 60:90].reshape(-1, 3), axis=1, keepdims=True
        )
        least = np.linalg.norm(LATTICE.directions[far][:, None] - looked, axis=2).min(axis=1)
        assert (turned < least + 0.06)[least < 0.8].all()
        slow = sample_unit_sphere_reference(cloud, position_m, LATTICE)
        np.testing.assert_array_equal(sampled.srgb, slow.srgb)
        looking = [one.surfaces.view_direction[far] for one in (sampled, slow)]
        np.testing.assert_allclose(*looking, atol=2e-5)


def test_what_is_near_hides_what_is_far_in_one_picture():
    """From close to the wall, the window's pixels point at the wall beside it."""
    with_sky = sample_unit_sphere(unproject_frame(window()), (1.5, 0.9, 0.3), LATTICE)
    without = sample_unit_sphere(unproject_frame(window(np.nan)), (1.5, 0.9, 0.3), LATTICE)
    seen = without.is_set
    np.testing.assert_array_equal(with_sky.srgb[seen], without.srgb[seen])
    np.testing.assert_array_equal(with_sky.distance_m[seen], without.distance_m[seen])


@pytest.mark.parametrize("nothing", [np.full((72, 96), np.nan), np.zeros((72, 96))])
def test_a_frame_in_which_nothing_has_a_distance_or_all_is_broken_says_nothing(nothing):
    cloud = unproject_frame(frame_of(nothing, CAMERA))
    assert cloud.grid.far is None and not sample_unit_sphere(cloud, (0, 0, 0), LATTICE).is_set.any()


@pytest.mark.parametrize("seed", range(6))
def test_far_light_is_sampled_as_by_the_plain_loop(seed):
    rng = np.random.default_rng(seed)
    frame = window(yaw=rng.uniform(0, 6), place_m=rng.uniform(-2, 2, 3))
    plane_depth_m = frame.plane_depth_m.copy()
    plane_depth_m[rng.random(plane_depth_m.shape) < 0.3] = rng.choice([0, np.nan, np.inf, -1])
    cloud = unproject_frame(frame_of(plane_depth_m, CAMERA, frame.world_from_camera, frame.srgb_u8))
    position_m, lattice = rng.uniform(-2, 2, 3) * rng.choice([1, 1e-30, 1e38]), AnchorLattice(320)
    fast, slow = (sample(cloud, position_m, lattice) for sample in (sample_unit_sphere, sample_unit_sphere_reference))
    bare = sample_unit_sphere(cloud, position_m, lattice, with_surfaces=False)
    for name in ("is_set", "srgb", "distance_m"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(fast, name))
    np.testing.assert_array_equal(fast.is_set, slow.is_set)
    np.testing.assert_allclose(fast.distance_m, slow.distance_m, rtol=1e-6)
    np.testing.assert_array_equal(fast.srgb, slow.srgb)
    for name in ("facing", "camera_distance_m", "view_direction"):
        np.testing.assert_allclose(getattr(fast.surfaces, name), getattr(slow.surfaces, name), atol=2e-5)
    assert fast.invalid == slow.invalid


def test_far_light_replaces_nothing_near_and_gives_way_to_it():
    rng = np.random.default_rng(1)
    near, later = random_cloud(rng, 64), random_cloud(rng, 64)
    far = UnitSphereCloud(later.srgb, FAR_M * later.is_set, later.is_set)
    behind = merge_in_sight(near, far)
    np.testing.assert_array_equal(behind.srgb, np.where(near.is_set[:, None], near.srgb, far.srgb))
    np.testing.assert_array_equal(behind.is_set, near.is_set | far.is_set)
    before = merge_in_sight(far, near)
    np.testing.assert_array_equal(before.distance_m, np.where(near.is_set, near.distance_m, far.distance_m))
    np.testing.assert_array_equal(merge_in_sight(far, far).srgb, far.srgb)


def test_far_light_behind_what_was_seen_near_fires_nothing():
    """A phone that goes to and fro in front of a window sees wall and sky by turns in the same directions."""
    settings = ControllerSettings(trigger=TriggerSettings(theta=0))
    controller = XiheController(LocalBackend(estimators.load("projection", 1280)), settings)
    controller.add_position("Ball", (0.0, -0.5, 0.3))
    places = [(0.0, -2.0, 0.3), (1.2, -2.0, 0.3)]
    reports = [controller.step(window(place_m=places[i % 2]))["Ball"] for i in range(10)]
    assert reports[0].decision.fire and not any(report.decision.fire for report in reports[2:])


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_a_changed_room_has_its_sky_in_the_changed_direction(is_mirrored):
    change = RoomChange(angle=0.9, is_mirrored=is_mirrored)
    position_m, rng = np.array([0.3, -1.2, 0.2]), np.random.default_rng(2)
    there = change.of_cloud(unproject_frame(window()), position_m, rng.random((72 * 96, 3)))
    mirroring = [-1.0 if is_mirrored else 1.0, 1.0, 1.0]
    expected = (unproject_frame(window()).grid.far.rays.T * mirroring) @ about_z(0.9).T
    np.testing.assert_allclose(there.grid.far.rays.T, expected, atol=1e-6)
