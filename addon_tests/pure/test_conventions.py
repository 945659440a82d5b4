"""What a recording's own surfaces say of how it was read: wrong conventions are named, and right ones let be."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from addon_tests.pure.furnished import as_measured, furniture, seen, walk_poses
from addon_tests.pure.made import UPRIGHT, about_z, pose_of
from addon_tests.pure.recordings import looking
from xihenet.camera import pixel_rays
from xihenet.captures.conventions import suspect
from xihenet.captures.reading.values import quaternion_of, rotation_of
from xihenet.captures.self_fit import AS_READ, MIRROR, Recording
from xihenet.io.frame_files import BLENDER_FROM_OPENCV_CAMERA, BLENDER_FROM_UP


def transposed(pose):
    turned = pose.copy()
    turned[:3, :3] = pose[:3, :3].T
    return turned


def w_first(pose):
    turned = pose.copy()
    turned[:3, :3] = rotation_of(np.roll(quaternion_of(pose[:3, :3]), 1))
    return turned


def as_ray_distance(frame):
    per_metre = np.linalg.norm(pixel_rays(frame.intrinsics), axis=-1)
    return replace(frame, plane_depth_m=frame.plane_depth_m * per_metre.astype(np.float32))


def posed(change):
    return lambda frame: replace(frame, world_from_camera=change(frame.world_from_camera))


def scaled(factor):
    return lambda frame: replace(frame, plane_depth_m=frame.plane_depth_m * np.float32(factor))


def turned(frame, quarters=-1):
    """The picture alone, by quarters to the left: its pose stays that of the sensor."""
    for _ in range(quarters % 4):
        k = frame.intrinsics
        k = replace(k, width=k.height, height=k.width, fx=k.fy, fy=k.fx, cx=k.cy, cy=k.width - k.cx)
        depth_m, srgb_u8 = np.rot90(frame.plane_depth_m), np.rot90(frame.srgb_u8)
        frame = replace(frame, srgb_u8=srgb_u8, plane_depth_m=depth_m, intrinsics=k)
    return frame


WRONG = {
    ("camera axes", AS_READ): posed(lambda pose: pose @ BLENDER_FROM_OPENCV_CAMERA),
    ("transposed", AS_READ): posed(transposed),
    ("inverse", AS_READ): posed(np.linalg.inv),
    ("w first", AS_READ): posed(w_first),
    ("left-handed", AS_READ): posed(lambda pose: MIRROR @ pose @ MIRROR),
    ("turned right", AS_READ): turned,
    (AS_READ, "10 x"): scaled(10),
    (AS_READ, "ray distance"): as_ray_distance,
}


@functools.lru_cache(maxsize=64)
def right(seed):
    """Twelve frames of a walk, in a world that lies and is turned somehow."""
    rng, boxes = np.random.default_rng(seed), furniture(seed)
    world = pose_of(about_z(rng.uniform(0.1, 6)), rng.uniform(-2, 2, 3))
    frames = [seen(pose, boxes, number) for number, pose in enumerate(walk_poses(seed))]
    return [replace(frame, world_from_camera=world @ frame.world_from_camera) for frame in frames]


def walked(frames):
    places = np.array([frame.world_from_camera[:3, 3] for frame in frames])
    axes = np.array([frame.world_from_camera[:3, 2] for frame in frames])
    turns = np.arccos(np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1))
    return np.linalg.norm(np.diff(places, axis=0), axis=1).sum(), np.degrees(turns.sum())


@pytest.mark.slow
@pytest.mark.parametrize(("n_each", "is_measured"), [(8, False), (3, True)])
def test_wrong_conventions_are_named(n_each, is_measured):
    n_named = 0
    for (expected, harm), seed in ((case, seed) for case in WRONG.items() for seed in range(n_each)):
        metres, degrees = walked(right(seed))
        assert metres > 1 and degrees > 85  # Of the view alone; the path turns by 90 degrees or more.
        frames = as_measured(right(seed), seed) if is_measured else right(seed)
        found = suspect([harm(frame) for frame in frames])
        assert found is None or (found.poses, found.depth) == expected, f"{expected} in walk {seed}: {found}"
        n_named += found is not None
    assert n_named >= 0.95 * n_each * len(WRONG)


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [None, 1.0, 2.0])
def test_right_walks_are_not_accused(degrees):
    """As they are, and as they are measured with poses that are off by so much."""
    walks = (right(seed) if degrees is None else as_measured(right(seed), seed, degrees) for seed in range(40))
    assert [found for walk in walks if (found := suspect(walk))] == []


def test_the_sentence_says_what_fits_and_how_well():
    found = suspect([posed(np.linalg.inv)(frame) for frame in right(0)])
    fits_twice = "The poses look like camera-from-world: their inverse fits 100 % of the surfaces seen twice"
    as_read = f"{found.share_as_read:.0%}".replace("%", " %")
    assert found.sentence == f"{fits_twice}, as read {as_read}."
    turned = [WRONG["camera axes", AS_READ](frame) for frame in right(0)]
    assert suspect(turned).sentence.startswith("The cameras seem to look along +Z with +Y down: turned so they fit")
    assert suspect(turned, is_opencv=True).sentence.startswith("The cameras seem to look along -Z with +Y up")


@pytest.mark.parametrize(
    ("factor", "name"), [(5, "5 x"), (0.2, "0.2 x"), (0.1, "0.1 x"), (1000, "1000 x"), (0.001, "0.001 x")]
)  # fmt: skip
def test_units_of_depth_are_told(factor, name):
    found = suspect([scaled(factor)(frame) for frame in right(2)])
    assert (found.poses, found.depth) == (AS_READ, name) and found.share > 0.95


@pytest.mark.parametrize(("quarters", "name"), [(1, "turned left"), (2, "upside down"), (3, "turned right")])
@pytest.mark.parametrize("is_opencv", [False, True])
def test_pictures_that_were_turned_without_their_poses_are_told(quarters, name, is_opencv):
    found = suspect([turned(frame, quarters) for frame in right(1)], is_opencv=is_opencv)
    assert (found.poses, found.depth) == (name, AS_READ) and found.share > 0.95


@pytest.mark.parametrize("up", ["y", "-z"])
@pytest.mark.parametrize("is_opencv", [False, True])
def test_poses_are_judged_as_the_file_had_them(up, is_opencv):
    """As a reader turns what is in a file: its world upright and its camera's axes to Blender's."""
    upright, axes = np.eye(4), BLENDER_FROM_OPENCV_CAMERA if is_opencv else np.eye(4)
    upright[:3, :3] = BLENDER_FROM_UP[up]
    for name, harm in (("inverse", np.linalg.inv), ("transposed", transposed)):

        def as_read(pose, harm=harm):
            return upright @ harm(upright.T @ pose @ axes) @ axes

        frames = [posed(as_read)(frame) for frame in right(1)]
        found = suspect(frames, blender_from_file=BLENDER_FROM_UP[up], is_opencv=is_opencv)
        assert (found.poses, found.depth) == (name, AS_READ)


def test_two_mistakes_at_once_are_both_named():
    found = suspect([scaled(1000)(posed(np.linalg.inv)(frame)) for frame in right(3)])
    assert (found.poses, found.depth) == ("inverse", "1000 x")
    assert ", and the depth looks 1000 times too large: with both put right they fit" in found.sentence
    colmap = posed(lambda pose: np.linalg.inv(pose @ BLENDER_FROM_OPENCV_CAMERA))
    assert suspect([colmap(frame) for frame in right(3)]).poses == "inverse, camera axes"


def still(frames):
    return [replace(frame, world_from_camera=frames[0].world_from_camera) for frame in frames[:1] * 12]


def without_depth(frames):
    return [replace(frame, plane_depth_m=np.full_like(frame.plane_depth_m, np.nan)) for frame in frames]


@pytest.mark.parametrize("case", ["empty", "one", "still", "no depth"])
def test_nobody_is_accused_where_nobody_can_say(case):
    cases = {"empty": [], "one": right(0)[:1], "still": still(right(0)), "no depth": without_depth(right(0))}
    for harm in (lambda frame: frame, *WRONG.values(), scaled(0.001)):
        assert suspect([harm(frame) for frame in cases[case]]) is None


def test_a_camera_that_turns_in_place_says_nothing_of_the_unit_of_depth():
    boxes, place = furniture(4), walk_poses(4)[0][:3, 3]
    poses = walk_poses(4)
    for pose in poses:
        pose[:3, 3] = place
    frames = [seen(pose, boxes, number) for number, pose in enumerate(poses)]
    for factor in (0.001, 0.1, 1, 10, 1000):
        assert suspect([scaled(factor)(frame) for frame in frames]) is None


def test_a_camera_that_only_pitches_looks_the_same_with_either_axes():
    """Half a turn about the camera's X axis, which is what it turns about, is no change."""
    boxes, poses = furniture(6), []
    for pitch in np.linspace(-1.2, 1.2, 12):
        poses.append(looking(0.4, pitch, [0.2, 0.1, 1.3]))
    frames = [seen(pose, boxes, number) for number, pose in enumerate(poses)]
    turned = [WRONG["camera axes", AS_READ](frame) for frame in frames]
    assert suspect(frames) is None and suspect(turned) is None
    assert Recording(turned, None, False).fit(AS_READ, AS_READ).share > 0.95


def test_frames_that_share_nothing_in_a_square_room_are_not_accused():
    """Each wall is equally far: with transposed rotations all of them would be one wall, and agree."""
    flat = replace(right(0)[0], plane_depth_m=np.full((48, 64), 2.0))
    poses = [pose_of(about_z(np.pi / 2 * quarter + 1e-3) @ UPRIGHT) for quarter in range(4)]
    frames = [replace(flat, world_from_camera=pose) for pose in poses]
    assert Recording(frames, None, False).fit("transposed", AS_READ).share > 0.9  # Which is the trap.
    assert suspect(frames) is None


def test_long_recordings_are_thinned_and_may_be_read_only_once():
    repeated = (frame for frame in right(5) for _ in range(9))
    assert suspect(WRONG["transposed", AS_READ](frame) for frame in repeated).poses == "transposed"
