"""Records check themselves."""

import numpy as np
import pytest

from xihenet.records import AnchorSurfaces, Intrinsics, PointCloud, RgbdFrame, UnitSphereCloud

PINHOLE = Intrinsics(4, 3, 2.0, 2.0, 2.0, 1.5)


def frame(**changes):
    fields = {
        "srgb_u8": np.zeros((3, 4, 3), np.uint8),
        "plane_depth_m": np.ones((3, 4)),
        "intrinsics": PINHOLE,
        "world_from_camera": np.eye(4),
    }
    return RgbdFrame(**(fields | changes))


def test_arrays_become_read_only_views_and_the_callers_stay_writable():
    depths = np.ones((3, 4), np.float32)
    record = frame(plane_depth_m=depths)
    assert np.shares_memory(record.plane_depth_m, depths)
    assert not record.plane_depth_m.flags.writeable and depths.flags.writeable


def test_a_pose_that_is_written_into_the_array_of_the_last_one_moves_no_frame():
    pose = np.eye(4)
    before = frame(world_from_camera=pose)
    pose[:3, 3] = 1
    assert not before.world_from_camera[:3, 3].any() and not before.world_from_camera.flags.writeable


def test_arrays_of_other_kinds_become_plain_ones():
    as_they_were = np.array([[448_262.3, 5_411_932.7, 120.4], [448_262.4, 5_411_932.8, 120.5]])
    for points_m in (as_they_were.astype(">f8"), as_they_were.tolist(), np.asfortranarray(as_they_were)):
        np.testing.assert_array_equal(PointCloud(points_m, np.zeros((2, 3))).points_m, as_they_were)
    for kind in (np.int32, np.uint32, np.uint64):
        assert PointCloud(np.array([[20_000_001, 0, 0]], kind), [[0, 0, 0]]).points_m[0, 0] == 20_000_001
    depths = np.ma.array(np.ones((3, 4), np.float32))
    assert type(frame(plane_depth_m=depths).plane_depth_m) is np.ndarray
    depths[0, 0] = np.ma.masked
    with pytest.raises(ValueError, match="plane_depth_m: expected an array without masked values: fill them"):
        frame(plane_depth_m=depths)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"srgb_u8": np.zeros((3, 4, 3))}, "expected uint8"),
        ({"srgb_u8": np.zeros((4, 3, 3), np.uint8)}, "srgb_u8"),
        ({"plane_depth_m": np.ones((4, 3))}, "plane_depth_m"),
        ({"plane_depth_m": np.full((3, 4), 1500, np.uint16)}, "expected metres, as floats, got uint16: multiply"),
        ({"plane_depth_m": np.full((3, 4), 1500)}, "expected metres"),
        ({"world_from_camera": np.eye(3)}, "world_from_camera"),
        ({"world_from_camera": np.full((4, 4), np.nan)}, "finite"),
        ({"world_from_camera": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [2, 1, 3, 1]])}, "transpose it"),
        ({"world_from_camera": np.diag([1.0, 1, 1, 2])}, "expected the last row 0 0 0 1, .*: write the camera's axes"),
        ({"world_from_camera": np.diag([0.01, 0.01, 0.01, 1])}, "world_from_camera: .*got lengths of 0.01, 0.01, 0.01"),
        ({"world_from_camera": np.diag([1.0, 1, 1.002, 1])}, "world_from_camera: .*of length 1"),
        ({"world_from_camera": np.diag([0, 0, 0, 1.0])}, "world_from_camera: .*of length 1"),
        ({"exposure": 0.0}, "exposure"),
        ({"exposure": np.nan}, "exposure"),
        ({"time_s": np.nan}, "time_s: expected finite seconds, got nan"),
        ({"ambient": [1.0, 2.0]}, "ambient"),
        ({"ambient": [1.0, np.nan, 0.0]}, "ambient"),
        ({"ambient": [-1.0, 0.0, 0.0]}, "ambient"),
    ],
)
def test_a_frame_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        frame(**changes)


@pytest.mark.parametrize(
    "wrong",
    [
        *((0, 3, 1, 1, 0, 0), (4, 3, 0, 1, 0, 0), (4, 3, 1, np.inf, 0, 0), (4, 3, 1, 1, np.nan, 0)),
        *((4, 3, 5e-324, 1, 2, 0), (4, 3, 1, 1e-42, 2, 0), (4, 3, 1e300, 1e300, 2, 0), (4, 3, np.nan, 1, 0, 0)),
        *((4, 3, 1, 1, -1e300, 0), (4, 3, 1, 1, 0, 1e30), (2.5, 3, 1, 1, 0, 0), (4, np.nan, 1, 1, 0, 0)),
    ],
)
def test_intrinsics_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="Intrinsics"):
        Intrinsics(*wrong)


def test_sizes_that_come_as_floats_are_whole_numbers():
    """As from JSON: a session with reflections stopped at them, deep within."""
    intrinsics = Intrinsics(4.0, np.float32(3), 2.0, 2.0, 2.0, 1.5)
    assert (type(intrinsics.width), type(intrinsics.height)) == (int, int)


@pytest.mark.parametrize(
    ("srgb", "distance_m", "is_set", "message"),
    [
        ([[0.5] * 3], [1.0], [False], "not set"),
        ([[0.0] * 3], [1.0], [False], "not set"),
        ([[1.1] * 3], [1.0], [True], r"\[0, 1\]"),
        ([[np.nan] * 3], [1.0], [True], r"\[0, 1\]"),
        ([[0.5] * 3], [-1.0], [True], "distance"),
        ([[0.5] * 3], [np.inf], [True], "distance"),
        ([[0.5] * 3], [np.nan], [True], "distance"),
        ([[0.5] * 3] * 2, [1.0], [True], "shape"),
    ],
)
def test_a_cloud_that_makes_no_sense_is_refused(srgb, distance_m, is_set, message):
    with pytest.raises(ValueError, match=message):
        UnitSphereCloud(srgb, distance_m, is_set)


@pytest.mark.parametrize("facing", [1.1, -5, np.inf])
def test_surfaces_that_face_the_position_by_no_cosine_are_refused(facing):
    assert len(AnchorSurfaces.of_facing([-1, 1, np.nan])) == 3
    with pytest.raises(ValueError, match="facing: expected cosines from -1 to 1"):
        AnchorSurfaces.of_facing([facing])


def test_a_set_anchor_may_be_black_and_at_distance_zero():
    assert UnitSphereCloud([[0.0] * 3], [0.0], [True]).is_set.all()


def test_empty_records_are_legal():
    assert len(UnitSphereCloud.empty(0)) == 0
    assert len(PointCloud(np.zeros((0, 3)), np.zeros((0, 3))).points_m) == 0


def test_points_may_be_nan_but_need_a_colour_each():
    PointCloud([[np.nan, 0, 0]], [[0, 0, 0]])
    with pytest.raises(ValueError, match=r"PointCloud\.srgb"):
        PointCloud([[np.nan, 0, 0]], np.zeros((2, 3)))
    with pytest.raises(ValueError, match="divide them by 255"):
        PointCloud([[np.nan, 0, 0]], np.zeros((1, 3), np.uint8))
