"""Pixels to points and back, for any pinhole camera."""

import tracemalloc

import numpy as np
import pytest

from addon_tests.pure.made import frame_of, pose_of, random_rotation
from xihenet.camera import (
    behind_m,
    encode_exposed,
    in_view,
    part_around,
    project_points,
    sensed_ambient,
    unproject_frame,
)
from xihenet.colour import srgb_to_linear
from xihenet.mirror_sphere import mirror_sphere_cloud
from xihenet.phone.depth_dropout import SurfaceFacts, facing_cosines
from xihenet.records import Intrinsics
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice


def random_camera(rng, width=17, height=11):
    """A camera anywhere, rolled and tilted, with separate focal lengths and a shifted lens."""
    intrinsics = Intrinsics(
        width, height, *rng.uniform(5, 40, 2), cx=width * rng.uniform(0.2, 0.8), cy=height * rng.uniform(0.2, 0.8)
    )
    return intrinsics, pose_of(random_rotation(rng), rng.uniform(-5, 5, 3))


@pytest.mark.parametrize("seed", range(50))
def test_projecting_unprojected_pixels_gives_the_pixel_grid(seed):
    rng = np.random.default_rng(seed)
    intrinsics, pose = random_camera(rng)
    plane_depth_m = rng.uniform(0.1, 8, (intrinsics.height, intrinsics.width)).astype(np.float32)
    cloud = unproject_frame(frame_of(plane_depth_m, intrinsics, pose))
    pixels, projected_m = project_points(cloud.points_m, intrinsics, pose)
    y, x = np.mgrid[: intrinsics.height, : intrinsics.width] + 0.5
    assert np.abs(pixels - np.stack([x.ravel(), y.ravel()], 1)).max() < 2e-3
    assert np.abs(projected_m - plane_depth_m.ravel()).max() < 1e-5


@pytest.mark.parametrize("place_m", [900.0, 5000.0])
def test_far_from_the_origin_a_point_is_off_by_no_more_than_storing_it_costs(place_m):
    """Rounding the camera's place as well would double that. Above and below what float32 holds."""
    rng, camera = np.random.default_rng(0), Intrinsics(4, 3, 4.0, 4.0, 2.0, 1.5)
    pose, depth_m = np.eye(4), rng.uniform(1, 3, (3, 4)).astype(np.float32)
    near_m = unproject_frame(frame_of(depth_m, camera)).points_m.astype(np.float64)
    for _ in range(20):
        pose[:3, 3] = rng.uniform(-place_m, place_m, 3)
        off_m = unproject_frame(frame_of(depth_m, camera, pose)).points_m - (near_m + pose[:3, 3])
        assert (np.abs(off_m) <= np.spacing(np.float32(place_m)) / 2 + 1e-6).all()


def test_camera_looks_down_minus_z_with_row_zero_on_top():
    intrinsics = Intrinsics(3, 3, 1.0, 1.0, 1.5, 1.5)
    cloud = unproject_frame(frame_of(np.full((3, 3), 2.0), intrinsics))
    points = cloud.points_m.reshape(3, 3, 3)
    np.testing.assert_allclose(points[1, 1], [0, 0, -2])
    np.testing.assert_allclose(points[0, 1], [0, 2, -2])
    np.testing.assert_allclose(points[1, 2], [2, 0, -2])


@pytest.mark.parametrize(("fx", "fy", "cx"), [(1e-6, 1, 2), (1, 1e-6, 1e9), (1, 1, -1e9), (1e9, 1e9, 2)])
def test_the_most_extreme_lenses_give_points_that_are_seen_or_left_out_and_counted(fx, fy, cx):
    """A warning, as of an overflow, fails it."""
    depth = np.where(np.eye(4) > 0, 0.0, 9e8)
    frame = frame_of(depth, Intrinsics(4, 4, fx, fy, cx, 2.0))
    cloud = unproject_frame(frame)
    assert (facing_cosines(frame, SurfaceFacts()) >= 0).all()
    assert not mirror_sphere_cloud(frame, np.array([0.0, 0.0, 5.0]), 1.0, AnchorLattice(12)).is_set.any()
    sampled = sample_unit_sphere(cloud, [0.0, 0.1, -1.0], AnchorLattice(64))
    n_finite = np.isfinite(cloud.points_m).all(axis=1).sum()
    assert n_finite + sampled.n_invalid_points == 16
    assert sampled.surfaces is not None and np.isfinite(sampled.surfaces.facing).all()


@pytest.mark.parametrize("origin_m", [(1e4, -2e4, 50.0), (448_262.3, 5_411_932.7, 120.4), (-1e7, 1e7, 1e7)])
def test_a_room_in_the_coordinates_of_a_map_looks_as_one_at_the_origin(origin_m):
    """float32 alone has steps of half a metre there."""
    rng, lattice = np.random.default_rng(0), AnchorLattice(1280)
    intrinsics, pose = random_camera(rng)
    there = pose.copy()
    there[:3, 3] += origin_m
    plane_depth_m = rng.uniform(0.5, 4, (intrinsics.height, intrinsics.width)).astype(np.float32)
    plane_depth_m[3:6, 4:8] = 0  # a window
    position_m = pose[:3, 3] - 1.2 * pose[:3, 2]
    near, far = (
        sample_unit_sphere(unproject_frame(frame_of(plane_depth_m, intrinsics, at)), position_m + offset, lattice)
        for at, offset in ((pose, 0), (there, np.array(origin_m)))
    )
    assert np.count_nonzero(near.is_set != far.is_set) <= 2
    both = near.is_set & far.is_set
    assert np.abs(near.distance_m - far.distance_m)[both].max() < 1e-5


@pytest.mark.parametrize("seed", range(20))
def test_a_part_of_the_picture_has_all_pixels_that_show_the_points_and_no_row_or_column_more(seed):
    rng = np.random.default_rng(seed)
    intrinsics, pose = random_camera(rng, 170, 110)
    points = (rng.normal(size=(8, 3)) * 0.3 + [*rng.uniform(-2, 2, 2), -3.0]) @ pose[:3, :3].T + pose[:3, 3]
    left, top, right, bottom = part_around(points, intrinsics, pose)
    pixels, _ = project_points(points, intrinsics, pose)
    is_in_picture = ((pixels >= 0) & (pixels < [170, 110])).all(axis=1)
    seen = np.floor(pixels[is_in_picture])
    assert ((seen >= [left, top]) & (seen < [right, bottom])).all()
    if is_in_picture.all():
        assert [left, top, right, bottom] == [*seen.min(axis=0), *seen.max(axis=0) + 1]
    wider = part_around(points, intrinsics, pose, 3)
    assert wider == (max(left - 3, 0), max(top - 3, 0), min(right + 3, 170), min(bottom + 3, 110))


def test_a_part_of_the_picture_is_not_known_where_a_point_is_not_before_the_camera():
    intrinsics = Intrinsics(4, 4, 2.0, 2.0, 2.0, 2.0)
    for behind in ([0, 0, 1], [0, 0, 0], [np.nan, 0, -1]):
        assert part_around([[0, 0, -1], behind], intrinsics, np.eye(4)) is None
    assert part_around([[9, 0, -1]], intrinsics, np.eye(4)) == (4, 2, 4, 2)


def test_a_point_is_as_far_behind_as_the_surface_of_its_own_pixel_says():
    frame = frame_of(np.arange(1.0, 13.0).reshape(3, 4), Intrinsics(4, 3, 2.0, 2.0, 2.0, 1.5))
    for row, column in np.ndindex(3, 4):
        point = np.array([(column - 1.5) / 2, (1 - row) / 2, -1]) * 20
        assert behind_m(point, frame) == pytest.approx(20 - (1 + 4 * row + column))
    assert behind_m([0, 0, 5], frame) == behind_m([90, 0, -1], frame) == 0
    # Nor is it behind what its pixel does not show, or by no more than a sensor errs.
    one, camera = np.array([0.0, 0.0, -2.0]), Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5)
    for surface_m, by_m in ((0.0, 0), (np.nan, 0), (2.5, 0), (1.9, 0), (1.7, 0.3)):
        assert behind_m(one, frame_of([[np.float32(surface_m)]], camera)) == pytest.approx(by_m)


def test_in_view_is_what_lies_before_the_camera_within_the_near_edges_of_the_picture_and_not_on_the_far_ones():
    camera = Intrinsics(4, 3, 2.0, 2.0, 2.0, 1.5), np.eye(4)
    in_picture, far_edges = [[0, 0, -1], [0.9, 0, -1], [-1, 0.75, -1]], [[1, 0, -1], [0, -0.75, -1], [1.1, 0, -1]]
    own_plane, behind = [[1, 1, 0], [0, 0, 0], [1, 0, 0]], [[0, 0, 1], [np.nan, 0, -1]]
    seen = in_view([*in_picture, *far_edges, *own_plane, *behind], *camera)
    assert seen.tolist() == [True] * 3 + [False] * 8
    assert np.isnan(project_points(own_plane, *camera)[0]).all()


def test_no_points_project_to_no_pixels():
    pixels, plane_depth_m = project_points(np.zeros((0, 3)), Intrinsics(1, 1, 1, 1, 0, 0), np.eye(4))
    assert pixels.shape == (0, 2) and plane_depth_m.shape == (0,)


def test_the_frames_own_exposure_keeps_its_bytes():
    colours = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
    plane_depth_m = np.arange(256.0)[None] - 128  # Pixels that give no point keep theirs, too.
    frame = frame_of(plane_depth_m, srgb_u8=colours, exposure=0.37)
    np.testing.assert_array_equal(np.rint(unproject_frame(frame).srgb * 255), colours.reshape(-1, 3))


def test_a_large_picture_is_encoded_in_little_more_memory_than_it_takes():
    """Of 8192x8192 pixels, the largest capture, all at once would take 10 GB."""
    radiance = np.full((700, 700, 3), 0.5, np.float32)
    tracemalloc.start()
    sensed_ambient(encode_exposed(radiance, 1.0), 1.0)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3 * radiance.nbytes


def test_the_ambient_sensor_reads_the_mean_of_the_picture():
    rng = np.random.default_rng(0)
    srgb_u8 = rng.integers(256, size=(5, 7, 3), dtype=np.uint8)
    expected = srgb_to_linear(srgb_u8 / 255).mean(axis=(0, 1)) / 0.25
    np.testing.assert_allclose(sensed_ambient(srgb_u8, 0.25), expected, rtol=1e-13)
