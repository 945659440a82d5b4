"""Rolling shutter against a camera that really renders each row, and drift against a random walk."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from addon_tests.pure import made
from addon_tests.pure.made import about_z, pose_of
from xihenet.camera import pixel_rays
from xihenet.phone.motion import (
    CameraMotion,
    PoseDrift,
    RollingShutter,
    drift_at,
    drift_pose,
    motion_between,
    read_rows,
    row_poses,
)
from xihenet.records import Intrinsics, RgbdFrame

CAMERA = Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)
SHUTTER = RollingShutter(source="test", readout_s=0.03, reads_plane_depth=True)
DRIFT = PoseDrift(source="test", position_m_per_sqrt_s=0.02, yaw_deg_per_sqrt_s=1.0)
STILL = CameraMotion(np.zeros(3), np.zeros(3))


def some_pose(seed):
    rng = np.random.default_rng(seed)
    # Within some 30 degrees of looking at the wall below.
    axes = about_z(rng.uniform(-3, 3)) @ Rotation.from_rotvec(rng.uniform(-0.3, 0.3, 3)).as_matrix()
    return pose_of(axes, rng.uniform(-0.5, 0.5, 3))


def wall_seen(poses):
    """Colour (smooth in the world) and plane depth of a wall at world z = -3, each row seen by its own pose."""
    directions = np.einsum("hij,hwj->hwi", poses[:, :3, :3], pixel_rays(CAMERA))
    z = (-3 - poses[:, None, 2, 3]) / directions[..., 2]
    points = poses[:, None, :3, 3] + directions * z[..., None]
    colour = 128 + 100 * np.stack([np.sin(points[..., 0]), np.sin(points[..., 1]), np.cos(points[..., 0])], -1)
    return np.rint(colour).astype(np.uint8), z.astype(np.float32)


def frame_of(pose, plane_depth_m=None):
    colour, z = wall_seen(np.broadcast_to(pose, (48, 4, 4)))
    return RgbdFrame(colour, z if plane_depth_m is None else plane_depth_m, CAMERA, pose, time_s=2.0, frame=5)


MOTIONS = {
    "sideways": CameraMotion(np.array([2.0, 0, 0]), np.zeros(3)),
    "forwards": CameraMotion(np.array([0, 0, -2.0]), np.zeros(3)),
    "a pan": CameraMotion(np.zeros(3), np.array([0, 1.5, 0])),
    "a roll": CameraMotion(np.zeros(3), np.array([0, 0, 2.0])),
    "all at once": CameraMotion(np.array([0.7, -0.5, 0.6]), np.array([0.5, 0.8, -1.0])),
}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@pytest.mark.parametrize("seed", range(3))
def test_each_row_shows_what_its_own_camera_saw(motion, seed):
    pose = some_pose(seed)
    slow = RollingShutter(source="test", readout_s=0.2, reads_plane_depth=True)
    read, source = read_rows(frame_of(pose), motion, slow)
    colour, z = wall_seen(row_poses(pose, motion, 48, slow.readout_s))
    inside = read.plane_depth_m > 0
    assert inside.mean() > 0.7
    # The look-up takes the nearest pixel: half a pixel of colour and of slope.
    errors, unread = (np.abs(f.srgb_u8.astype(int) - colour)[inside] for f in (read, frame_of(pose)))
    assert errors.max() <= 8
    assert errors.mean() < 0.6 * unread.mean()
    assert np.abs(read.plane_depth_m - z)[inside].max() < 0.06
    assert source.shape == (48, 64)


def test_a_sideways_move_shears_the_picture_by_the_known_number_of_pixels():
    column_of_pixel = np.broadcast_to(np.arange(64, dtype=np.uint8)[None, :, None], (48, 64, 3))
    frame = made.frame_of(np.full((48, 64), 2.0), CAMERA, srgb_u8=column_of_pixel)
    read, _ = read_rows(frame, CameraMotion(np.array([4.0, 0, 0]), np.zeros(3)), SHUTTER)
    shift = read.srgb_u8[:, 32, 0].astype(float) - 32
    expected = 50 * 4.0 * ((np.arange(48) + 0.5) / 48 - 0.5) * 0.03 / 2.0
    assert np.abs(shift - expected).max() <= 0.5 + 1e-6


AT_ONCE = RollingShutter(source="test", readout_s=0, reads_plane_depth=True)
PAN = MOTIONS["a pan"]


@pytest.mark.parametrize(("motion", "shutter"), [(None, SHUTTER), (STILL, SHUTTER), (PAN, None), (PAN, AT_ONCE)])
def test_without_motion_or_readout_the_frame_is_given_itself(motion, shutter):
    frame = frame_of(some_pose(1))
    assert read_rows(frame, motion, shutter) == (frame, None)


def test_a_global_shutter_for_plane_depth_leaves_it_alone():
    colour_only = RollingShutter(source="test", readout_s=0.03, reads_plane_depth=False)
    frame = frame_of(some_pose(2))
    read, _ = read_rows(frame, PAN, colour_only)
    assert read.plane_depth_m.tobytes() == frame.plane_depth_m.tobytes()
    assert read.srgb_u8.tobytes() != frame.srgb_u8.tobytes()


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e10])
def test_invalid_pixels_stay_invalid_wherever_they_end_up(value):
    pose = some_pose(0)
    z = frame_of(pose).plane_depth_m.copy()
    z[10:20, 10:20] = value
    read, source = read_rows(frame_of(pose, z), MOTIONS["all at once"], SHUTTER)
    valid = (read.plane_depth_m > 0) & (read.plane_depth_m < 1e9)
    came_from_hole = ~((z > 0) & (z < 1e9)).ravel()[source]
    assert came_from_hole.any() and not valid[came_from_hole].any()
    assert valid[~came_from_hole].mean() > 0.8


def test_a_frame_without_any_plane_depth_is_still_read():
    read, _ = read_rows(frame_of(np.eye(4), np.zeros((48, 64))), PAN, SHUTTER)
    assert not read.plane_depth_m.any()


def test_one_pixel_is_its_own_middle_row():
    frame = made.frame_of(np.ones((1, 1)))
    read, _ = read_rows(frame, MOTIONS["all at once"], SHUTTER)
    assert read.srgb_u8.tobytes() == frame.srgb_u8.tobytes()
    np.testing.assert_allclose(read.plane_depth_m, frame.plane_depth_m)


@pytest.mark.parametrize("seed", range(5))
def test_motion_between_two_poses_leads_from_one_to_the_other(seed):
    before, after = some_pose(seed), some_pose(seed + 10)
    motion = motion_between(before, after, 0.5)
    turn = Rotation.from_rotvec(motion.turn_rad_per_s * 0.5).as_matrix()
    np.testing.assert_allclose(turn @ before[:3, :3], after[:3, :3], atol=1e-9)
    np.testing.assert_allclose(before[:3, 3] + 0.5 * motion.velocity_m_per_s, after[:3, 3])
    assert motion_between(before, before, 1.0).velocity_m_per_s.tolist() == [0, 0, 0]


def test_motion_needs_time_and_a_direction():
    with pytest.raises(ValueError, match="expected some time"):
        motion_between(np.eye(4), np.eye(4), 0.0)
    with pytest.raises(ValueError, match="half a circle"):
        motion_between(np.eye(4), np.diag([-1.0, -1, 1, 1]), 1.0)


def test_drift_has_the_published_spread_and_grows_with_the_root_of_time():
    for time_s in (1.0, 9.0):
        walks = [drift_at(time_s, DRIFT, [seed, 2]) for seed in range(1500)]
        offsets = np.array([offset for offset, _ in walks])
        assert np.sqrt((offsets**2).sum(axis=1).mean()) == pytest.approx(0.02 * np.sqrt(time_s), rel=0.05)
        yaws = np.degrees([yaw for _, yaw in walks])
        assert yaws.std() == pytest.approx(np.sqrt(time_s), rel=0.06)
        assert np.abs(offsets.mean(axis=0)).max() < 0.1 * 0.02 * np.sqrt(time_s)


def test_drift_is_one_walk_whatever_is_asked_first():
    times = [0.0, 0.033, 0.05, 0.07, 1.0, 5.0]
    forwards = [drift_at(t, DRIFT, [3, 2])[0].tolist() for t in times]
    backwards = [drift_at(t, DRIFT, [3, 2])[0].tolist() for t in reversed(times)]
    assert forwards == backwards[::-1]
    near, nearer = (np.linalg.norm(drift_at(1 + d, DRIFT, [3, 2])[0] - forwards[4]) for d in (1e-3, 1e-4))
    assert nearer < near < 1e-3
    with pytest.raises(ValueError, match="since the start of the session, got 1"):
        drift_at(1.7e9, DRIFT, [3, 2])


def test_drift_keeps_pitch_and_roll_and_the_picture():
    frame = frame_of(some_pose(4))
    drifted = drift_pose(frame, DRIFT, [1, 2])
    np.testing.assert_allclose(drifted.world_from_camera[2, :3], frame.world_from_camera[2, :3], atol=1e-12)
    np.testing.assert_allclose(
        drifted.world_from_camera[:3, :3] @ drifted.world_from_camera[:3, :3].T, np.eye(3), atol=1e-12
    )
    assert not np.allclose(drifted.world_from_camera, frame.world_from_camera)
    assert drifted.srgb_u8.tobytes() == frame.srgb_u8.tobytes()


def test_no_drift_gives_the_frame_itself():
    frame = frame_of(some_pose(4))
    none = PoseDrift(source="test", position_m_per_sqrt_s=0, yaw_deg_per_sqrt_s=0)
    assert drift_pose(frame, None, 1) is frame
    assert drift_pose(frame, none, 1) is frame
