"""Where to look for a second, in box rooms whose walls are known, and what a look is."""

import itertools
import weakref

import numpy as np
import pytest

from addon_tests.pure.made import UPRIGHT, about_z, frame_of, pose_of
from xihenet.buffers import merge
from xihenet.camera import pixel_rays, unproject_frame
from xihenet.camera_path.better_path import (
    BELOW,
    FREE_M,
    LEAST_GAIN,
    KnownRoom,
    choose_look,
    guess_unseen,
    likely_radiance,
    shown_by,
)
from xihenet.camera_path.looks import Look, LookSettings, direction_words, looks_of, random_looks, turned_view
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.completeness import share_from_behind
from xihenet.records import Intrinsics, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

CAMERA = Intrinsics(48, 40, 24.0, 24.0, 24.0, 20.0)
"""90 degrees wide: four of them see all around."""

LATTICE = AnchorLattice(640)
HALF_M = np.array([2.5, 2.0, 1.4])
PLACE = np.array([0.1, -0.1, 0.0])
OBJECT = np.array([0.3, 0.4, -0.6])
SETTINGS = LookSettings()


def facing(yaw_deg, pitch_deg=0.0, place=PLACE):
    """A pose whose heading is `yaw_deg` to the left of +Y."""
    return turned_view(pose_of(UPRIGHT, place), yaw_deg, pitch_deg)


def box_frame(pose, room=None, frame=1):
    """A frame of a box around the origin, turned by `room` (3, 3)."""
    room = np.eye(3) if room is None else room
    rays = pixel_rays(CAMERA) @ pose[:3, :3].T @ room
    place = room.T @ pose[:3, 3]
    # A ray along a wall never meets it.
    with np.errstate(divide="ignore"):
        depth = np.where(rays > 0, (HALF_M - place) / rays, (-HALF_M - place) / rays).min(axis=-1)
    return frame_of(depth, CAMERA, pose, frame=frame)


def known_by(clouds):
    return KnownRoom.of_frames(clouds, sum(len(cloud.points_m) for cloud in clouds))


def advice(poses, room=None, thing=OBJECT):
    """The best look after frames at `poses` in the box."""
    frames = [box_frame(pose, room, number) for number, pose in enumerate(poses, start=1)]
    clouds = [unproject_frame(frame) for frame in frames]
    known = known_by(clouds)
    cloud = UnitSphereCloud.empty(LATTICE.n)
    for points in clouds:
        cloud = merge(cloud, sample_unit_sphere(points, thing, LATTICE))
    unseen = guess_unseen(cloud, thing, known.hull_m(LATTICE), LATTICE)
    looks = looks_of([(frame.frame, frame.world_from_camera) for frame in frames], SETTINGS)
    return choose_look(looks, [unseen], known, CAMERA, LATTICE, SETTINGS)


ALL_AROUND = [facing(yaw, pitch) for yaw in (0, 90, 180, -90) for pitch in (-45, 0, 45)] + [
    facing(0, 90),
    facing(0, -90),
]


def test_the_points_of_a_path_are_not_kept_to_know_its_room():
    alive, most = weakref.WeakSet(), []

    def clouds():
        for number in range(5):
            alive.add(cloud := unproject_frame(box_frame(facing(72 * number))))
            yield cloud
            most.append(len(alive))

    assert len(KnownRoom.of_frames(clouds(), 5 * 48 * 40).points_m) == 5 * 48 * 40
    assert max(most) <= 2


@pytest.mark.parametrize("missing_deg", [0, 90, 180, -90])
def test_in_a_room_seen_but_for_one_side_the_advice_looks_at_that_side(missing_deg):
    towards = -facing(missing_deg)[:3, 2]
    seen = [pose for pose in ALL_AROUND if -pose[:3, 2] @ towards < 0.3]
    best = advice(seen)
    assert best.is_worth_it and -best.look.end[:3, 2] @ towards > 0.6


def test_turning_the_room_about_the_vertical_turns_the_advice():
    seen = [pose for pose in ALL_AROUND if pose[0, 2] > -0.5]
    turn = about_z(np.radians(40))
    whole = np.eye(4)
    whole[:3, :3] = turn
    here, there = advice(seen), advice([whole @ pose for pose in seen], turn, turn @ OBJECT)
    assert there.gain == pytest.approx(here.gain, rel=0.15)
    assert (turn @ here.look.end[:3, 2]) @ there.look.end[:3, 2] > 0.8


def test_a_path_that_saw_everything_says_that_nothing_would_help():
    best = advice(ALL_AROUND)
    assert best.gain < LEAST_GAIN and not best.is_worth_it


def test_a_path_that_saw_nothing_has_an_advice_all_the_same():
    black = frame_of(np.zeros((40, 48)), CAMERA, facing(0))
    known = known_by([unproject_frame(black)])
    assert known.hull_m(LATTICE) == pytest.approx(LATTICE.directions @ PLACE + FREE_M)
    # Where the phone was the room is free, whatever it saw.
    seen = KnownRoom(np.zeros((1, 3)), known.places_m)
    assert (seen.hull_m(LATTICE) >= known.hull_m(LATTICE)).all()
    unseen = guess_unseen(UnitSphereCloud.empty(LATTICE.n), OBJECT, known.hull_m(LATTICE), LATTICE)
    assert np.isfinite(unseen.points_m).all() and unseen.weight.sum() == pytest.approx(1)
    looks = looks_of([(1, facing(0))], SETTINGS)
    assert choose_look(looks, [unseen], known, CAMERA, LATTICE, SETTINGS).is_worth_it


@pytest.mark.parametrize(
    ("pitch_deg", "thing"), [(-90, (-2.0, 1.5, 0.8)), (-90, (-2.3, -1.8, -1.3)), (0, (2.0, -1.5, -0.5))]
)
def test_an_object_far_from_all_that_was_seen_has_a_look_and_of_its_directions_about_as_many_as_it_shows(
    pitch_deg, thing
):
    best = advice([facing(0, pitch_deg)], thing=np.array(thing))
    shown = sample_unit_sphere(unproject_frame(box_frame(best.look.end)), np.array(thing), LATTICE).is_set
    assert best.is_worth_it and best.shown.mean() == pytest.approx(shown.mean(), abs=0.15)


def test_behind_a_wall_the_surfaces_that_were_seen_turn_their_other_side_to_the_object():
    points = unproject_frame(box_frame(facing(0)))
    inside, behind = (sample_unit_sphere(points, np.array([0.0, y, 0.0]), LATTICE) for y in (1.0, 2.5))
    assert share_from_behind(inside) == 0 and share_from_behind(behind) > 0.5
    assert share_from_behind(UnitSphereCloud.empty(LATTICE.n)) == 0


def test_a_view_that_is_walled_off_by_known_geometry_adds_nothing():
    cloud = UnitSphereCloud.empty(LATTICE.n)
    unseen = guess_unseen(cloud, np.array([0.0, 3.0, 0.0]), np.full(LATTICE.n, 4.0), LATTICE)
    nothing = np.zeros(LATTICE.n)
    assert shown_by([facing(0)], unseen, nothing, CAMERA, LATTICE).sum() > 50
    # A screen 0.5 m before the phone, as a frame of it shows.
    screen = known_by([unproject_frame(frame_of(np.full((40, 48), 0.5), CAMERA, facing(0)))])
    walled = screen.nearest_m(PLACE, LATTICE)
    assert shown_by([facing(0)], unseen, walled, CAMERA, LATTICE).sum() < 5


def test_what_is_behind_the_phone_is_not_shown():
    unseen = guess_unseen(UnitSphereCloud.empty(LATTICE.n), PLACE, np.full(LATTICE.n, 2.0), LATTICE)
    shown = shown_by([facing(0)], unseen, np.zeros(LATTICE.n), CAMERA, LATTICE)
    assert shown.any() and (LATTICE.directions[shown] @ (0, 1, 0) > 0.5).all()


def test_in_a_room_that_was_seen_the_guess_of_a_distance_is_the_wall():
    frames = [unproject_frame(box_frame(pose)) for pose in ALL_AROUND]
    unseen = guess_unseen(UnitSphereCloud.empty(LATTICE.n), np.zeros(3), known_by(frames).hull_m(LATTICE), LATTICE)
    wall_m = (HALF_M / np.maximum(np.abs(LATTICE.directions), 1e-9)).min(axis=1)
    guessed_m = np.linalg.norm(unseen.points_m, axis=1)
    assert np.median(np.abs(guessed_m / wall_m - 1)) < 0.15


def test_what_a_look_shows_is_set_in_the_guessed_cloud_and_all_else_stays():
    frame = box_frame(facing(0))
    cloud = sample_unit_sphere(unproject_frame(frame), OBJECT, LATTICE)
    known = known_by([unproject_frame(frame)])
    unseen = guess_unseen(cloud, OBJECT, known.hull_m(LATTICE), LATTICE)
    shown = LATTICE.directions[:, 2] > 0.5
    after = unseen.with_shown(shown, OBJECT)
    np.testing.assert_array_equal(after.is_set, cloud.is_set | shown)
    np.testing.assert_array_equal(after.srgb[cloud.is_set], cloud.srgb[cloud.is_set])
    np.testing.assert_allclose(
        after.srgb[shown & ~cloud.is_set], linear_to_srgb(unseen.radiance[shown & ~cloud.is_set]), atol=1e-6
    )
    seen_m = (OBJECT + LATTICE.directions * after.distance_m[:, None])[after.is_set]
    np.testing.assert_allclose(seen_m, unseen.points_m[after.is_set], atol=1e-5)


def test_light_that_is_likely_is_a_mean_of_what_was_seen_that_of_the_same_side_first():
    is_set, up = np.random.default_rng(0).random(LATTICE.n) < 0.1, LATTICE.directions[:, 2] > 0
    sides = np.where(up[:, None], [0.9, 0.5, 0.2], [0.1, 0.5, 0.7])
    likely = srgb_to_linear(sides)
    found = likely_radiance(UnitSphereCloud(sides * is_set[:, None], 2.0 * is_set, is_set), LATTICE)
    np.testing.assert_allclose(found[is_set], likely[is_set], rtol=1e-6)
    np.testing.assert_allclose(found[:, 1], likely[0, 1], rtol=1e-6)
    far = np.abs(LATTICE.directions[:, 2]) > 0.7
    np.testing.assert_allclose(found[far], likely[far], atol=0.2)
    assert not likely_radiance(UnitSphereCloud.empty(LATTICE.n), LATTICE).any()
    even = UnitSphereCloud(np.full((LATTICE.n, 3), 0.5), np.ones(LATTICE.n), np.ones(LATTICE.n, bool))
    weight = guess_unseen(even, OBJECT, np.full(LATTICE.n, 4.0), LATTICE).weight
    assert weight[~up] == pytest.approx(BELOW * weight[up].max()) and weight.sum() == pytest.approx(1)


# --------------------------------------------------------------------------------------------------------------- looks


def test_a_look_turns_in_place_in_small_steps_and_ends_where_it_should():
    start = facing(20, -25)
    look = Look(7, 80.0, 30.0, start, turned_view(start, 80, 30))
    poses = [start, *look.poses(SETTINGS)]
    np.testing.assert_array_equal(poses[-1], look.end)
    for first, last in itertools.pairwise(poses):
        np.testing.assert_allclose(last[:3, :3] @ last[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_array_equal(last[:3, 3], start[:3, 3])
        step = Look(7, 0.0, 0.0, first, last).turn_deg
        assert step == pytest.approx(look.turn_deg / (len(poses) - 1)) and step <= SETTINGS.frame_step_deg


def test_a_half_turn_and_no_turn_are_turns_too():
    start = facing(0)
    assert Look(1, 180.0, 0.0, start, turned_view(start, 180, 0)).turn_deg == pytest.approx(180)
    still = Look(1, 0.0, 0.0, start, start)
    assert still.turn_deg == 0 and len(still.poses(SETTINGS)) == 1
    half_way = Look(1, 180.0, 0.0, start, turned_view(start, 180, 0)).pose(0.5)
    assert abs(half_way[:3, 2] @ start[:3, 2]) < 1e-6


def test_a_turned_view_is_level_and_looks_where_it_is_said():
    for yaw, pitch in ((0, 0), (30, 40), (-120, -60), (10, 90)):
        pose = turned_view(facing(15, -20), yaw, pitch)
        assert -pose[2, 2] == pytest.approx(np.sin(np.radians(pitch)))
        assert pose[2, 0] == pytest.approx(0, abs=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


@pytest.mark.parametrize(
    ("yaw_deg", "pitch_deg", "words"),
    [
        (40, 30, "up left"),
        (-40, 0, "right"),
        (0, 40, "up"),
        (0, -40, "down"),
        (170, 0, "back"),
        (10, 80, "straight up"),
        (0, 0, "ahead"),
    ],
)
def test_a_look_is_said_in_words_as_seen_from_the_phone(yaw_deg, pitch_deg, words):
    assert direction_words(yaw_deg, pitch_deg, facing(0)) == words
    if pitch_deg < 60:
        assert direction_words(yaw_deg, pitch_deg - 40, facing(90, -40)) == words


def test_looks_are_within_reach_and_at_frames_of_the_path():
    path = [(frame, facing(3 * frame, -30)) for frame in range(40)]
    narrow = LookSettings(largest_turn_deg=60.0, most_frames=5)
    for looks in (looks_of(path, narrow), random_looks(path, 50, np.random.default_rng(1), narrow)):
        assert looks and all(look.turn_deg <= 60.001 and look.frame < 40 for look in looks)
    assert len({look.frame for look in looks_of(path, narrow)}) == 5
    all_around = random_looks(path, 200, np.random.default_rng(1), LookSettings(largest_turn_deg=180.0))
    sines = np.sin(np.radians([look.pitch_deg for look in all_around]))
    assert np.abs(sines).mean() == pytest.approx(0.5, abs=0.05)


def test_the_same_seed_gives_the_same_random_looks():
    path = [(1, facing(0)), (2, facing(10))]
    first, again, other = (random_looks(path, 4, np.random.default_rng(seed), SETTINGS) for seed in (3, 3, 4))
    assert [look.yaw_deg for look in first] == [look.yaw_deg for look in again] != [look.yaw_deg for look in other]


@pytest.mark.parametrize(
    "senseless",
    [{"hold_s": 0.0}, {"turn_deg_per_s": -1.0}, {"largest_turn_deg": 181.0}, {"largest_turn_deg": float("nan")},
     {"frame_step_deg": float("inf")}, {"most_frames": 0}],
    ids=str,
)  # fmt: skip
def test_senseless_looks_are_refused(senseless):
    with pytest.raises(ValueError, match="expected"):
        LookSettings(**senseless)


def test_without_a_look_or_a_position_there_is_nothing_to_choose():
    with pytest.raises(ValueError, match="expected looks and positions"):
        choose_look([], [], known_by([]), CAMERA, LATTICE, SETTINGS)
