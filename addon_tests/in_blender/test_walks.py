"""Walks through rooms and scenes made by others: the same rooms, seen as someone who walks there sees them."""

import json
import zlib
from dataclasses import replace

import bpy
import numpy as np
import pytest
from scene_snapshot import nothing_changes
from small_rooms import SMALL, places_of, small_build
from tiny_scenes import add, key, light_strength, look_at, room_with_a_virtual_sphere, saved

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.capture.scanner import meter_exposure, phone_camera
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.rooms.build import build_dataset, rooms_held
from xihe_blender.lab.rooms.outline import Rect
from xihe_blender.lab.rooms.render_room import make_room
from xihe_blender.lab.rooms.room_data import Piece
from xihe_blender.lab.rooms.rooms import walk_generator
from xihe_blender.lab.rooms.scene import SCENE_REGIME, SCENE_SEED, SCENE_SETTINGS, add_scene
from xihe_blender.lab.rooms.store import load_room, room_path, stored_indices
from xihe_blender.lab.rooms.views import PHONE_CLEARANCE_M
from xihe_blender.lab.rooms.walk import HIGHEST_M, LOWEST_M, SPEED_M_S, sample_walk
from xihenet.camera import project_points
from xihenet.records import Intrinsics
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import SPLITS, split_of

FREE_VIEWS = {"format": 2, "seed": 5, "render": SMALL.numbers, "metering": "highlights", "software": "xihe 0.1.0"}
"""What the first version wrote into its folders."""

N_FRAMES = 24

FIRST = next(room for room in range(1000) if split_of((5, room)) == "test")
"""The first room of seed 5 that is for testing."""


def poses_of(walk):
    return np.stack([view.world_from_camera for view in walk])


@pytest.fixture(scope="module", params=range(6))
def walked(request):
    """Room, positions, walk, and how near anything comes to the phone in each frame."""
    room, rays, positions, views = places_of(request.param)
    walk = sample_walk(walk_generator(11, request.param), room, rays, positions, views, N_FRAMES)
    around = AnchorLattice(200).directions.astype(np.float64)
    nearest_m = [rays.cast(pose[:3, 3], around)[0].min() for pose in poses_of(walk)]
    return room, positions, walk, np.array(nearest_m)


def test_a_walker_stays_clear_of_walls_and_furniture(walked):
    room, _, walk, nearest_m = walked
    standing = [piece.footprint for piece in room.pieces if piece.size[2] >= 0.02 and piece.z < 1.0]
    for x, y, _ in poses_of(walk)[:, :3, 3]:
        assert room.outline.holds_rect(Rect.around((x, y), (0.2, 0.2)))
        assert not any(rect.x0 < x < rect.x1 and rect.y0 < y < rect.y1 for rect in standing)
    assert nearest_m.min() > 0.7 * PHONE_CLEARANCE_M


def test_a_walker_moves_as_people_do(walked):
    poses = poses_of(walked[2])
    places, ahead = poses[:, :3, 3], -poses[:, :3, 2]
    assert len(poses) == N_FRAMES
    assert places[:, 2].min() >= LOWEST_M
    assert places[:, 2].max() <= HIGHEST_M
    steps = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    assert steps.max() <= SPEED_M_S[1] + 1e-9
    assert steps.sum() > 1.0
    turns = np.degrees(np.arccos(np.clip((ahead[1:] * ahead[:-1]).sum(axis=1), -1, 1)))
    assert turns.max() < 40
    pitch = np.degrees(np.arcsin(ahead[:, 2]))
    assert -60 < pitch.min() < -20
    assert pitch.max() < 26
    assert np.abs(np.degrees(np.arcsin(poses[:, 2, 0]))).max() < 15, "roll"


def test_a_walker_looks_at_every_position_and_around(walked):
    _, positions, walk, _ = walked
    focal = 64 / np.tan(np.radians(walk[0].fov_deg) / 2)
    camera = Intrinsics(128, 96, focal, focal, 64, 48)
    seen = np.zeros((N_FRAMES, len(positions)), bool)
    for frame, pose in enumerate(poses_of(walk)):
        pixels, plane_depth_m = project_points(positions, camera, pose)
        seen[frame] = ((pixels > 0) & (pixels < [128, 96])).all(axis=1) & (plane_depth_m > 0)
    assert seen.sum(axis=0).min() >= 2
    assert seen.mean() > 0.12
    ahead = -poses_of(walk)[:, :2, 2]
    yaw = np.sort(np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])))
    assert np.diff(np.append(yaw, yaw[0] + 360)).max() < 200, "more than half of the room was never faced"


def test_the_same_seed_gives_the_same_walk():
    room, rays, positions, views = places_of(3)
    again = [poses_of(sample_walk(walk_generator(11, 3), room, rays, positions, views, 12)) for _ in range(2)]
    np.testing.assert_array_equal(*again)
    other = poses_of(sample_walk(walk_generator(11, 4), room, rays, positions, views, 12))
    assert not np.array_equal(again[0], other)


def test_where_there_is_no_floor_to_walk_on_one_stands_and_looks_around():
    room, rays, positions, views = places_of(0)
    bounds = room.outline.bounds
    size = (bounds.x1 - bounds.x0, bounds.y1 - bounds.y0, 0.5)
    full = replace(room, pieces=(Piece("podium", *bounds.centre, 0.0, 0.0, size, (), 0),))
    poses = poses_of(sample_walk(walk_generator(11, 0), full, rays, positions, views, N_FRAMES))
    assert (poses[:, :3, 3] == poses[0, :3, 3]).all()
    assert any((poses[0, :3, 3] == view.world_from_camera[:3, 3]).all() for view in views)
    assert len(np.unique(poses[:, :2, 2], axis=0)) == N_FRAMES


@pytest.fixture(scope="module")
def walk():
    """Room `FIRST` as a walk of three frames."""
    return make_room(small_build(1, walk=3), FIRST)


@pytest.mark.slow
def test_a_room_of_a_walk_or_of_more_views_is_the_room_of_the_free_views(walk):
    free, more = make_room(small_build(1), FIRST), make_room(small_build(1, views=9), FIRST)
    for name in ("positions_m", "seed"):
        assert getattr(free, name).tobytes() == getattr(walk, name).tobytes() == getattr(more, name).tobytes(), name
    assert more.srgb_u8.shape == (9, 24, 32, 3)
    assert len(np.unique(more.world_from_camera[:, :3, 3], axis=0)) == 9
    np.testing.assert_allclose(free.sh_hdr / free.exposure, more.sh_hdr / more.exposure, rtol=1e-6)
    np.testing.assert_allclose(free.sh_hdr / free.exposure, walk.sh_hdr / walk.exposure, rtol=1e-6)
    np.testing.assert_allclose(free.balls.astype(float), walk.balls.astype(float), rtol=2e-3, atol=1e-6)
    assert (free.kind, free.regime) == (walk.kind, walk.regime)
    np.testing.assert_array_equal(free.intrinsics, walk.intrinsics)
    assert walk.srgb_u8.shape == (3, 24, 32, 3)
    assert walk.is_in_view.shape == walk.is_unhidden.shape == (3, len(walk.positions_m))


# --------------------------------------------------------------------------------------------------------------- builds


def test_the_splits_share_all_rooms_out():
    wanted = {split: small_build(60, split=split).wanted() for split in SPLITS}
    assert sorted(room for rooms in wanted.values() for room in rooms) == list(range(60))
    assert all(split_of((5, room)) == split for split, rooms in wanted.items() for room in rooms)


@pytest.fixture(scope="module")
def walked_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walks")
    settings = small_build(FIRST + 1, walk=3, split="test")
    assert run_blocking(build_dataset(folder, settings)) == 1
    return folder, settings


@pytest.mark.slow
def test_a_build_of_walks_in_one_split_makes_these_alone(walked_folder, walk):
    folder, settings = walked_folder
    assert list(stored_indices(folder)) == settings.wanted() == [FIRST]
    made = load_room(room_path(folder, FIRST))
    np.testing.assert_array_equal(made.world_from_camera, walk.world_from_camera)
    np.testing.assert_array_equal(made.srgb_u8, walk.srgb_u8)
    assert run_blocking(build_dataset(folder, settings)) == 0


def test_folders_without_a_walk_go_on_as_free_views_and_are_written_so(tmp_path):
    (tmp_path / "dataset.json").write_text(json.dumps(FREE_VIEWS))
    for folder in (tmp_path, tmp_path / "new"):
        with rooms_held(folder, small_build(3).provenance):
            pass
        written = json.loads((folder / "dataset.json").read_text())
        assert list(written) == list(FREE_VIEWS) and {**written, "software": FREE_VIEWS["software"]} == FREE_VIEWS


@pytest.mark.parametrize(
    ("there", "wanted"),
    [
        ({}, small_build(3, seed=6)),
        ({}, small_build(3, walk=24)),
        ({"walk": 3}, small_build(3)),
        ({"walk": 3}, small_build(3, walk=4)),
        ({"walk": None, "views": 9}, small_build(3, views=8)),
        ({"metering": None}, small_build(3)),  # As it was in the old way.
        ({"seed": None, "scenes": True}, small_build(3)),
    ],
)
def test_a_folder_holds_rooms_of_one_kind_alone(there, wanted, tmp_path):
    content = {name: value for name, value in {**FREE_VIEWS, **there}.items() if value is not None}
    (tmp_path / "dataset.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match="another folder"):
        run_blocking(build_dataset(tmp_path, wanted))


# --------------------------------------------------------------------------------------------------------------- scenes


def added(scene, name, folder, **options):
    path = run_blocking(add_scene(scene, name, folder, SMALL, **options))
    return path, load_room(path)


def test_a_scene_is_stored_as_its_camera_path_saw_it(tmp_path):
    scene = room_with_a_virtual_sphere(2)
    path, room = added(scene, "tiny", tmp_path)
    assert path == room_path(tmp_path, 0)
    assert (room.kind, room.regime) == ("tiny", SCENE_REGIME)
    assert room.seed.tolist() == [SCENE_SEED, zlib.crc32(b"tiny")]
    assert room.exposure == run_blocking(meter_exposure(scene, [1, 2]))
    np.testing.assert_allclose(room.positions_m, [[0, 0, 0.85]], atol=1e-6)
    assert room.balls.shape == (1, 8, 8, 3)
    for frame, pose in enumerate(room.world_from_camera, start=1):
        scene.frame_set(frame)
        np.testing.assert_allclose(pose, phone_camera(scene)[1], atol=1e-6)
    assert room.is_in_view.all()
    assert room.is_unhidden.all(), "the virtual sphere itself hides nothing"


def test_virtual_objects_are_in_no_picture_of_a_scene(tmp_path):
    _, with_ball = added(room_with_a_virtual_sphere(), "with", tmp_path, frames=[1])
    scene = room_with_a_virtual_sphere()
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    add(scene, "Mark", location=(0, 0, 0.85))
    _, without = added(scene, "without", tmp_path, at=["Mark"], frames=[1])
    np.testing.assert_array_equal(with_ball.radiance, without.radiance)
    np.testing.assert_array_equal(with_ball.balls, without.balls)
    np.testing.assert_array_equal(with_ball.sh_hdr, without.sh_hdr)


def test_positions_of_a_scene_are_where_the_named_objects_are(tmp_path):
    scene = room_with_a_virtual_sphere()
    add(scene, "On the table", location=(0.4, 0.2, 0.8))
    add(scene, "Under the table", location=(0.0, 0.0, 0.4))
    _, room = added(scene, "marked", tmp_path, at=["Under the table", "On the table"], frames=[1, 3])
    np.testing.assert_allclose(room.positions_m, [[0, 0, 0.4], [0.4, 0.2, 0.8]], atol=1e-6)
    assert len(room.srgb_u8) == 2
    np.testing.assert_array_equal(room.is_unhidden, [[False, True]] * 2)


def test_a_scene_takes_its_own_place_again_and_others_the_next(tmp_path):
    scene = room_with_a_virtual_sphere()
    first, _ = added(scene, "one", tmp_path, frames=[1])
    second, _ = added(scene, "two", tmp_path, frames=[1])
    again, room = added(scene, "one", tmp_path, frames=[1, 2])
    assert (first, second, again) == (room_path(tmp_path, 0), room_path(tmp_path, 1), room_path(tmp_path, 0))
    assert len(room.srgb_u8) == 2
    assert list(stored_indices(tmp_path)) == [0, 1]


@pytest.mark.slow
def test_a_scene_is_not_added_to_a_folder_of_rooms(walked_folder):
    with pytest.raises(UserError, match="another folder"):
        added(room_with_a_virtual_sphere(), "tiny", walked_folder[0], frames=[1])


def test_a_camera_that_zooms_is_refused(tmp_path):
    scene = room_with_a_virtual_sphere(2)
    key(scene.camera.data, "lens", {1: 30.0, 2: 60.0})
    with pytest.raises(UserError, match="zooms before frame 2"):
        added(scene, "zoom", tmp_path)
    assert not list(stored_indices(tmp_path))


@pytest.mark.parametrize("strength", [1e-5, 1e9])
def test_a_scene_whose_light_half_floats_cannot_hold_is_refused(tmp_path, strength):
    scene = room_with_a_virtual_sphere(1)
    light_strength().default_value = strength
    with pytest.raises(UserError, match="which a data set cannot hold: bring its lights between"):
        run_blocking(add_scene(scene, "room", tmp_path, SMALL))


def test_a_lamp_and_a_position_that_are_no_numbers_are_refused_for_named_positions_too(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    strength = light_strength()
    strength.default_value = float("nan")
    with pytest.raises(UserError, match="'Light' has nan as its strength"):
        run_blocking(add_scene(scene, "room", tmp_path, SMALL, at=["Ball"]))
    strength.default_value = 6.0
    bpy.data.objects["Ball"].location.x = float("nan")
    with pytest.raises(UserError, match="'Ball' has no finite position"):
        run_blocking(add_scene(scene, "room", tmp_path, SMALL, at=["Ball"]))


def test_a_scene_added_leaves_the_open_file_as_it_was(tmp_path):
    scene = room_with_a_virtual_sphere()
    look_at(scene.camera, (1.0, 1.0, 1.2), (0, 0, 0.8))
    with nothing_changes():
        added(scene, "tiny", tmp_path, frames=[2])


@pytest.mark.slow
def test_the_command_adds_a_scene_and_says_where(tmp_path, monkeypatch):
    assert (SCENE_SETTINGS.view_size, SCENE_SETTINGS.probe_size) == ((128, 96), 160)
    small = replace(SCENE_SETTINGS, view_size=(32, 24), probe_size=48)
    monkeypatch.setattr("xihe_blender.lab.rooms.scene.SCENE_SETTINGS", small)
    room_with_a_virtual_sphere()
    blend = saved(tmp_path / "tiny.blend")
    done = xihe_here("dataset", "scene", blend, "--out", tmp_path / "scenes", "--frames", "1:3:2")
    assert (done.returncode, done.stdout.strip()) == (0, str(room_path(tmp_path / "scenes", 0)))
    assert "The reference light has a noise of at most" in done.stderr
    room = load_room(room_path(tmp_path / "scenes", 0))
    assert room.kind == "tiny"
    assert room.srgb_u8.shape == (2, 24, 32, 3)
    assert room.balls.shape == (1, 24, 24, 3)
    assert (room.sh_noise > 0).all() and (room.sh_noise <= SCENE_SETTINGS.noise_target).all()


@pytest.mark.parametrize(
    ("removed", "arguments", "words"),
    [
        ("", ("--at", "Ball,Nobody"), "no object 'Nobody'"),
        ("", ("--at", ","), "--at"),
        ("", ("--frames", "1:9"), "choose frames within it"),
        ("Phone", (), "has no camera"),
        ("Phone", ("--at", "Ball"), "has no camera"),
        ("Ball", (), "--at A,B"),
    ],
)
def test_a_scene_that_cannot_be_added_is_refused_in_one_line(removed, arguments, words, tmp_path):
    room_with_a_virtual_sphere()
    if removed:
        bpy.data.objects.remove(bpy.data.objects[removed])
    blend = saved(tmp_path / "tiny.blend")
    assert_refused(xihe_here("dataset", "scene", blend, "--out", tmp_path / "scenes", *arguments), words)
    assert not (tmp_path / "scenes").exists()
