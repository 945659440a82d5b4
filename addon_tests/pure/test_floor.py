"""Up, where a recording does not say it, is the normal of the floor that its frames show."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from addon_tests.pure.broken_recordings import metadata
from addon_tests.pure.recordings import PACKED, SMALL, as_record3d, as_seven_scenes, looking, seen, walk
from xihenet.captures import open_capture
from xihenet.captures.floor import floor_normal, rotation_between
from xihenet.records import Intrinsics

N = 14
SCENES = Intrinsics(64, 48, 58.5, 58.5, 32.0, 24.0)


def turned(axis, degrees):
    """(3, 3) about an axis."""
    return Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis)).as_matrix()


def noisy(frames, sigma_m, seed=0):
    rng = np.random.default_rng(seed)
    return [
        replace(f, plane_depth_m=f.plane_depth_m + rng.normal(0, sigma_m, f.plane_depth_m.shape).astype(np.float32))
        for f in frames
    ]


def looking_down(intrinsics, n=N, pitch=-0.35):
    """A walk along which the floor is in sight, and the walls take more of the pictures."""
    poses = [looking(0.5 * i, pitch + 0.2 * np.sin(i), (0.3 * np.cos(i), 0.2 * np.sin(i), 0.3)) for i in range(n)]
    return [seen(intrinsics, pose, 1 + i, i / 30) for i, pose in enumerate(poses)]


def off_degrees(capture, frames):
    """Between up as it was found and as it is, from where the same camera looks."""
    read, made = capture.frames[0].read(), frames[0]
    up = read.world_from_camera[:3, :3] @ made.world_from_camera[:3, :3].T @ [0, 0, 1]
    return np.degrees(np.arccos(np.clip(up[2], -1, 1)))


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (1, 2, 0)])
@pytest.mark.parametrize("degrees", [0.0, 3.0, 15.0, -30.0])
@pytest.mark.parametrize("sigma_m", [0.0, 0.01])
def test_a_tilted_room_is_set_upright(tmp_path, axis, degrees, sigma_m):
    frames = noisy(looking_down(SCENES), sigma_m)
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # -Y is up, before it is tilted.
    capture = open_capture(as_seven_scenes(tmp_path, frames, down @ turned(axis, degrees)))
    assert off_degrees(capture, frames) < 1
    (note,) = (note for note in capture.notes if note.startswith("Up is the normal of the floor"))
    said = float(note.split(": ")[1].split()[0])
    assert said == pytest.approx(abs(degrees), abs=1.0) and note.endswith("degrees from -Y.")
    assert 4 <= int(note.split("which ")[1].split()[0]) <= 12
    # Positions that are typed in the recording's world come to where its frames are.
    np.testing.assert_allclose(
        capture.blender_from_file @ down @ turned(axis, degrees) @ frames[3].world_from_camera[:3, 3],
        capture.frames[3].camera.world_from_camera[:3, 3],
        atol=1e-6,
    )
    for frame in (capture.frames[0], capture.frames[-1]):
        assert (frame.read().world_from_camera == frame.camera.world_from_camera).all()


def test_up_that_is_said_is_not_looked_for(tmp_path):
    capture = open_capture(as_seven_scenes(tmp_path, looking_down(SCENES)), up="-y")
    assert capture.notes == ("Depth is not registered to colour.",)


def test_without_a_floor_in_sight_the_usual_axis_is_taken_and_said(tmp_path):
    at_a_wall = [seen(SCENES, looking(0, 0.3, (1.0, 0.1 * i, 0.5)), 1 + i, i / 30) for i in range(3)]
    capture = open_capture(as_seven_scenes(tmp_path, at_a_wall))
    assert "Which way is up is not given, and 3 frames show no floor: -Y is taken." in capture.notes
    assert off_degrees(capture, at_a_wall) < 1e-3


@PACKED
def test_a_record3d_file_that_begins_level_along_an_axis_knows_where_up_is(tmp_path):
    frames = [seen(SMALL, looking(np.pi / 2, 0.0, (0.5, 0.0, 0.3)))]
    assert open_capture(as_record3d(tmp_path / "level", frames)).notes == ()


@PACKED
@pytest.mark.parametrize("pitch", [-0.6, -0.2])
@pytest.mark.parametrize("start", [None, [0, 0, 0, 1, 0, 0, 0]])
def test_the_first_camera_of_record3d_need_not_be_upright(tmp_path, pitch, start):
    frames = looking_down(SMALL, pitch=pitch)
    path = as_record3d(tmp_path / "older", frames)
    metadata(initPose=start)(path)
    capture = open_capture(path)
    assert off_degrees(capture, frames) < 1
    assert any("degrees from +Y" in note and "Up is the normal" in note for note in capture.notes)
    with_pose = open_capture(as_record3d(tmp_path, frames))
    assert off_degrees(with_pose, frames) < 1e-3 and not with_pose.notes


def test_a_table_is_as_level_as_the_floor_and_a_ceiling_does_not_count():
    rng = np.random.default_rng(0)
    flat = np.concatenate([rng.uniform(-2, 2, (3000, 2)), rng.normal(0, 0.003, (3000, 1))], axis=1)
    floor, table, ceiling = flat[:1500], flat[1500:2000] + [0, 0, 0.7], flat[2000:] + [0, 0, 2.4]
    points = np.concatenate([floor, table, ceiling])
    normals = np.repeat([[0.0, 0, 1], [0, 0, 1], [0, 0, -1]], [1500, 500, 1000], axis=0)
    turn = turned((1, 0, 0), 20)
    up, is_floor = floor_normal(points @ turn.T, normals @ turn.T, np.ones(3000))
    assert np.degrees(np.arccos(up @ turn[:, 2])) < 0.2 and is_floor[:1500].all() and not is_floor[1500:].any()


@pytest.mark.parametrize("seed", range(5))
def test_the_smallest_rotation_takes_one_direction_to_the_other(seed):
    start, end = np.random.default_rng(seed).normal(size=(2, 3))
    start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
    turn = rotation_between(start, end)
    np.testing.assert_allclose(turn @ start, end, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.trace(turn) == pytest.approx(1 + 2 * start @ end)


def test_a_walk_whose_frames_are_few_is_enough(tmp_path):
    frames = walk(SCENES, 6)
    assert off_degrees(open_capture(as_seven_scenes(tmp_path, frames)), frames) < 1
