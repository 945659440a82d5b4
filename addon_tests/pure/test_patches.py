"""The patches of surface that pixels show: against the plain reference, and where they must and must not be."""

import numpy as np
import pytest

from addon_tests.pure.made import assert_same, pose_of
from xihenet.camera import pixel_rays, unproject_frame
from xihenet.records import Intrinsics, PixelGrid, PointCloud, RgbdFrame
from xihenet.sampling import sample_unit_sphere
from xihenet.sampling_reference import sample_unit_sphere_reference
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(1280)
BELOW = LATTICE.directions[:, 2] < 0
TABLE_M, CAMERA_M = 0.7, 1.4
ABOVE_TABLE = np.array([0.0, 2.0, TABLE_M + 0.08])
RED, BLUE = np.uint8([255, 0, 0]), np.uint8([0, 0, 255])


def frame_of_a_table(width=64, height=48, pitch=0.3, has_table=True, seed=None):
    """A red table of 1.2 x 1 m at 0.7 m on a blue floor, before a blue wall at 6 m; `seed` drops pixels and colours."""
    camera = Intrinsics(width, height, 0.9 * width, 0.9 * width, width / 2, height / 2)
    axes = np.stack([[1, 0, 0], [0, np.sin(pitch), np.cos(pitch)], [0, -np.cos(pitch), np.sin(pitch)]], axis=1)
    rays = pixel_rays(camera) @ axes.T
    with np.errstate(divide="ignore"):  # A ray along the floor never meets it.
        wall, floor, table = 6 / rays[..., 1], -CAMERA_M / rays[..., 2], (TABLE_M - CAMERA_M) / rays[..., 2]
    depth = np.minimum(np.where(wall > 0, wall, np.inf), np.where(floor > 0, floor, np.inf))
    at = table[..., None] * rays
    on_table = (table > 0) & (np.abs(at[..., 0]) < 0.6) & (np.abs(at[..., 1] - 2) < 0.5) & has_table
    colours = np.where(on_table[..., None], RED, BLUE)
    depth = np.where(on_table, table, depth)
    if seed is not None:
        rng = np.random.default_rng(seed)
        depth[rng.random(depth.shape) < 0.05] = np.nan
        colours = rng.integers(0, 256, colours.shape, np.uint8)
    return RgbdFrame(colours, depth, camera, pose_of(axes, [0, 0, CAMERA_M]))


def without_grid(cloud):
    return PointCloud(cloud.points_m, cloud.srgb, cloud.invalid)


def assert_same_without_surfaces(cloud, position_m, lattice, with_them):
    bare = sample_unit_sphere(cloud, position_m, lattice, with_surfaces=False)
    assert bare.surfaces is None
    for name in ("is_set", "srgb", "distance_m"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(with_them, name))


def table_range_m():
    """(N,) distance of the table top in each anchor's direction; NaN beside it."""
    directions = LATTICE.directions
    with np.errstate(divide="ignore", invalid="ignore"):  # As do directions along the table.
        reach = -0.08 / directions[:, 2]
        at = ABOVE_TABLE + reach[:, None] * directions
    on_table = BELOW & (np.abs(at[:, 0]) < 0.5) & (np.abs(at[:, 1] - 2) < 0.4)
    return np.where(on_table, reach, np.nan)


@pytest.mark.parametrize("seed", [None, 0, 1])
@pytest.mark.parametrize("n", [7, 320, 1280])
def test_sampling_pictures_agrees_with_the_reference(n, seed):
    cloud, lattice = unproject_frame(frame_of_a_table(40, 30, seed=seed)), AnchorLattice(n)
    for position in (ABOVE_TABLE, [0.2, 3.0, 0.05], [0, 0, CAMERA_M]):
        fast = sample_unit_sphere(cloud, position, lattice)
        slow = sample_unit_sphere_reference(cloud, position, lattice)
        assert_same(fast, slow)
        assert_same_without_surfaces(cloud, position, lattice, fast)
        for name in ("facing", "view_direction", "camera_distance_m"):
            np.testing.assert_allclose(getattr(fast.surfaces, name), getattr(slow.surfaces, name), atol=2e-5)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 9), (7, 1), (2, 2), (3, 5), (40, 30)])
@pytest.mark.parametrize("seed", range(3))
def test_sampling_pictures_agrees_with_the_reference_on_nasty_points(width, height, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(width * height, 3)) * 10.0 ** rng.uniform(-30, 30, (width * height, 1))
    points[:: 2 + seed] = rng.normal(size=points[:: 2 + seed].shape)
    points[rng.random(len(points)) < 0.1] = [np.nan, np.inf, 0][seed]
    cloud = PointCloud(points, rng.random(points.shape), grid=PixelGrid(height, width, [0.1, 0.2, 0.3]))
    fast = sample_unit_sphere(cloud, np.zeros(3), LATTICE)
    assert_same(fast, sample_unit_sphere_reference(cloud, np.zeros(3), LATTICE))
    assert_same_without_surfaces(cloud, np.zeros(3), LATTICE, fast)
    assert np.isfinite(fast.surfaces.facing).all() and (np.abs(fast.surfaces.facing) <= 1 + 1e-6).all()


@pytest.mark.parametrize("depth_m", [1e-40, 1e-12, 1e-9])
def test_a_point_in_the_camera_itself_is_on_no_surface_with_its_neighbours(depth_m):
    rng = np.random.default_rng(4)
    depth = rng.uniform(1, 20, (12, 16)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = depth_m
    picture = Intrinsics(16, 12, 16, 16, 8, 6)
    colours = rng.integers(0, 256, (12, 16, 3), np.uint8)
    cloud = unproject_frame(RgbdFrame(colours, depth, picture, pose_of(np.eye(3), [0.3, 0.7, CAMERA_M])))
    lattice = AnchorLattice(320)
    fast = sample_unit_sphere(cloud, np.zeros(3), lattice)
    assert_same(fast, sample_unit_sphere_reference(cloud, np.zeros(3), lattice))


@pytest.mark.parametrize("size", [(64, 48), (128, 96)])
def test_the_floor_does_not_show_through_a_table_at_a_flat_angle(size):
    cloud, expected = unproject_frame(frame_of_a_table(*size)), table_range_m()
    on_table = ~np.isnan(expected)

    def leaks(sampled):
        """Share of the anchors over the table that show the floor."""
        return (sampled.is_set & on_table & (sampled.distance_m > 1.5 * expected)).sum() / on_table.sum()

    before = sample_unit_sphere(without_grid(cloud), ABOVE_TABLE, LATTICE)
    after = sample_unit_sphere(cloud, ABOVE_TABLE, LATTICE)

    assert leaks(before) > 0.1 and leaks(after) < 0.01
    assert after.is_set[on_table].mean() > 0.95 > before.is_set[on_table].mean()
    assert (after.srgb[on_table & after.is_set] == [1, 0, 0]).mean() > 0.99


def test_patches_lie_on_their_surface():
    sampled = sample_unit_sphere(unproject_frame(frame_of_a_table()), ABOVE_TABLE, LATTICE)
    is_red = sampled.srgb[:, 0] > 0.5
    # A point of a patch stands for the whole cell of its anchor, so its height is asked by the nearest one alone.
    assert is_red.sum() > 300
    assert sampled.distance_m[is_red].min() == pytest.approx(0.08, abs=2e-3)


def test_nothing_lies_between_a_table_and_the_wall_behind_it():
    position = np.array([0.0, 3.6, TABLE_M])
    sampled = sample_unit_sphere(unproject_frame(frame_of_a_table()), position, LATTICE)
    points = position + sampled.distance_m[:, None] * LATTICE.directions
    between = sampled.is_set & (points[:, 1] > 2.8) & (points[:, 1] < 5.5) & (points[:, 2] > 0.3)
    assert not between.any()


def test_where_pixels_are_dense_nothing_changes():
    cloud = unproject_frame(frame_of_a_table(256, 192))
    position = [0.0, 1.0, CAMERA_M]
    plain, patched = (sample_unit_sphere(c, position, AnchorLattice(64)) for c in (without_grid(cloud), cloud))
    np.testing.assert_array_equal(plain.distance_m, patched.distance_m)
    np.testing.assert_array_equal(plain.srgb, patched.srgb)
    assert plain.surfaces is None and patched.surfaces is not None


@pytest.mark.parametrize("behind_m", [1.2, 2, 5, 20])
@pytest.mark.parametrize("is_stepped_along_rows", [False, True])
def test_a_step_from_one_surface_to_another_is_never_bridged(behind_m, is_stepped_along_rows):
    frame = frame_of_a_table(40, 30, pitch=0)
    depth_m = np.ones((30, 40))
    depth_m[(np.s_[:15], np.s_[:, :20])[is_stepped_along_rows]] = behind_m
    cloud = unproject_frame(RgbdFrame(frame.srgb_u8, depth_m, frame.intrinsics, frame.world_from_camera))
    position = np.array([0.01, (1 + behind_m) / 2, CAMERA_M + 0.01])
    sampled = sample_unit_sphere(cloud, position, LATTICE)
    assert sampled.is_set.any()
    along = (position + sampled.distance_m[:, None] * LATTICE.directions)[sampled.is_set, 1]
    # Beside its surface by no more than the cell of an anchor.
    near = np.minimum(np.abs(along - 1), np.abs(along - behind_m))
    assert (near <= 0.08 * sampled.distance_m[sampled.is_set]).all()


def test_the_table_faces_the_position_above_it_and_the_side_that_was_seen_is_known():
    cloud = unproject_frame(frame_of_a_table())
    above = sample_unit_sphere(cloud, ABOVE_TABLE, LATTICE)
    directions, is_red = LATTICE.directions, above.srgb[:, 0] > 0.5
    known = is_red & (above.surfaces.facing != 0)
    assert known.sum() > 0.9 * is_red.sum()
    np.testing.assert_allclose(above.surfaces.facing[known], -directions[known, 2], atol=1e-4)
    below = sample_unit_sphere(cloud, ABOVE_TABLE - [0, 0, 0.3], LATTICE)
    is_red = (below.srgb[:, 0] > 0.5) & (below.surfaces.facing != 0)
    assert is_red.sum() > 50 and (below.surfaces.facing[is_red] < 0).all()
    camera = np.array([0, 0, CAMERA_M])
    points = ABOVE_TABLE + above.distance_m[:, None] * directions
    far = above.is_set & (above.distance_m > 1)
    # Within what the cell of an anchor and the half pixel of a patch allow.
    np.testing.assert_allclose(
        above.surfaces.camera_distance_m[far], np.linalg.norm(points - camera, axis=1)[far], rtol=0.15
    )
    np.testing.assert_allclose(np.linalg.norm(above.surfaces.view_direction[above.is_set], axis=1), 1, rtol=1e-5)
