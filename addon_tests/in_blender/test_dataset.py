"""The data set of rooms: what is stored is whole, the same every time, and true to the room."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import bpy
import numpy as np
import pytest
from previs_runs import files_below
from small_rooms import SMALL, places_of, small_build

from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.rooms import render_room
from xihe_blender.lab.rooms.build import LEFT_BEHIND_S, build_dataset, missing_rooms, rooms_held
from xihe_blender.lab.rooms.build_room import build_room
from xihe_blender.lab.rooms.contact_sheet import contact_sheet
from xihe_blender.lab.rooms.render_room import make_room
from xihe_blender.lab.rooms.room_data import LAMP_KINDS
from xihe_blender.lab.rooms.rooms import room_generator, sample_room
from xihe_blender.lab.rooms.settings import RoomRenderSettings
from xihe_blender.lab.rooms.statistics import light_statistics, panorama_faults, statistics_table
from xihe_blender.lab.rooms.store import load_room, room_path, save_room, stored_indices
from xihe_blender.lab.rooms.varied_rooms import sample_varied_room
from xihe_blender.lab.rooms.views import BY_LAMP_M, MIN_CLEARANCE_M, N_POSITIONS, N_SUNLIT, N_VIEWS
from xihe_blender.lab.workers import one_core
from xihenet.camera import project_points, unproject_frame
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import frames_of


@pytest.fixture(scope="module")
def rooms():
    """Two, the second one made first."""
    second = make_room(small_build(2), 1)
    return [make_room(small_build(2), 0), second]


@pytest.fixture(scope="module")
def room(rooms):
    return rooms[0]


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms")
    assert run_blocking(build_dataset(folder, small_build(2))) == 2
    return folder


@pytest.mark.slow
def test_a_room_has_the_same_bytes_in_any_process_and_order(rooms, built, tmp_path):
    for index, room in enumerate(rooms):
        save_room(tmp_path / "here.npz", room)
        assert (tmp_path / "here.npz").read_bytes() == room_path(built, index).read_bytes()


def test_a_stored_room_comes_back_as_it_was(room, tmp_path):
    path = tmp_path / "room.npz"
    save_room(path, room)
    back = load_room(path)
    assert back.__dict__.keys() == room.__dict__.keys()
    for name, value in room.__dict__.items():
        np.testing.assert_array_equal(getattr(back, name), value, err_msg=name)


def test_a_file_that_is_no_room_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", other=1)
    (tmp_path / "short.npz").write_bytes(b"PK but cut short")
    for name in ("other.npz", "short.npz"):
        with pytest.raises(ValueError, match="not a room"):
            load_room(tmp_path / name)


def test_a_room_whose_bytes_changed_is_refused_or_read_and_nothing_else(room, tmp_path):
    path, rng = tmp_path / "room_000000.npz", np.random.default_rng(0)
    save_room(path, room)
    right, n_refused = path.read_bytes(), 0
    for offset in rng.integers(0, len(right), 200):
        path.write_bytes(right[:offset] + bytes([right[offset] ^ int(rng.integers(1, 256))]) + right[offset + 1 :])
        try:
            load_room(path)
        except ValueError as error:
            n_refused += path.name in str(error)
    assert n_refused > 100


def test_a_room_holds_its_views_and_its_light(room):
    assert room.srgb_u8.shape == (N_VIEWS, 24, 32, 3)
    assert room.radiance.shape == (N_VIEWS, 24, 32, 3)
    assert room.plane_depth_m.shape == (N_VIEWS, 24, 32)
    assert room.balls.shape == (N_POSITIONS, 8, 8, 3)
    assert np.isfinite(room.balls).all()
    assert room.sh_ldr.shape == room.sh_hdr.shape == (N_POSITIONS, 9, 3)
    assert (room.sh_ldr[:, 0] > 0).all() and (room.sh_noise < 0.5).all()
    assert np.isfinite(room.radiance).all()
    assert panorama_faults(room) == []
    black = replace(room, balls=np.zeros_like(room.balls))
    assert len(panorama_faults(black)) == N_POSITIONS


def test_pairs_that_count_project_into_the_picture(room):
    for frame, is_in_view in zip(frames_of(vars(room)), room.is_in_view, strict=True):
        pixels, plane_depth_m = project_points(room.positions_m, frame.intrinsics, frame.world_from_camera)
        inside = (pixels > 0).all(axis=1) & (pixels < [32, 24]).all(axis=1) & (plane_depth_m > 0)
        np.testing.assert_array_equal(is_in_view, inside)


def test_a_position_in_plain_sight_is_in_front_of_the_seen_surface(room):
    frames = frames_of(vars(room))
    for view, place in zip(*np.nonzero(room.is_in_view & room.is_unhidden), strict=True):
        camera = frames[view].intrinsics, frames[view].world_from_camera
        pixel, plane_depth_m = project_points(room.positions_m[[place]], *camera)
        x, y = pixel[0].astype(int)
        around = room.plane_depth_m[view, max(0, y - 1) : y + 2, max(0, x - 1) : x + 2].astype(float)
        seen = np.where(around == 0, np.inf, around)
        assert seen.max() > plane_depth_m[0] - 0.01


def test_the_views_see_the_room_they_stand_in(room):
    points = np.concatenate([unproject_frame(frame).points_m for frame in frames_of(vars(room))])
    points = points[np.isfinite(points).all(axis=1)]
    plan = sample_room(room_generator(5, 0))
    bounds = plan.outline.bounds.grown(0.5)
    inside = (points[:, 0] > bounds.x0) & (points[:, 0] < bounds.x1) & (points[:, 1] > bounds.y0)
    assert (inside & (points[:, 2] > -0.02) & (points[:, 2] < plan.height + 0.02)).mean() > 0.99


DRAWN = {}
"""What `places` has drawn, by index; rays are cast in the room that was drawn last alone."""


@pytest.fixture(scope="module", params=range(6))
def places(request):
    DRAWN[request.param] = drawn = places_of(request.param)
    return drawn


def test_positions_float_just_above_a_surface_and_clear_of_everything(places):
    room, rays, positions, _ = places
    down, everywhere = np.array([[0.0, 0.0, -1.0]]), AnchorLattice(500).directions.astype(np.float64)
    for position in positions:
        below, _ = rays.cast(position, down)
        assert 0.05 - 1e-4 <= below[0] <= 0.1 + 1e-4
        distances, from_behind = rays.cast(position, everywhere)
        assert distances.min() > 0.8 * MIN_CLEARANCE_M
        assert from_behind.mean() < 0.15, "inside a thing every surface is met from behind"
        assert room.outline.holds((position[0], position[1]))


@pytest.mark.parametrize("index", [0, 2, 15])
def test_where_the_sun_shines_in_half_of_the_positions_are_in_it(index):
    room, rays, positions, _ = places_of(index, by_day=True)
    assert room.daylight.sun is not None
    to_sun = np.array(rays.scene.objects["Sun"].matrix_world.col[2][:3])
    np.testing.assert_allclose(room.daylight.sun.towards, to_sun, atol=1e-6)
    are_sunlit = [bool(np.isinf(rays.cast(position, to_sun[None])[0][0])) for position in positions]
    assert are_sunlit[:N_SUNLIT] == [True] * N_SUNLIT


@pytest.mark.slow
def test_the_last_position_is_by_a_lit_lamp():
    near, drawn = [], 0
    for index in range(12):
        room, _, positions, _ = DRAWN.get(index) or places_of(index)
        lit = np.array([(lamp.x, lamp.y) for lamp in room.lamps if lamp.watts > 0])
        if len(lit):
            drawn += 1
            near.append(np.abs(positions[-1, :2] - lit).max(axis=1).min() <= BY_LAMP_M + 1e-9)
    assert drawn >= 6
    assert np.mean(near) >= 0.8, "where no surface near a lamp is free, the position is elsewhere"


@pytest.mark.slow
def test_a_room_that_is_nearly_black_is_drawn_again(rooms, monkeypatch):
    index, first = max(enumerate(rooms), key=lambda room: room[1].exposure)
    drawn = []

    def noted(rng, **how):
        drawn.append(sample_room(rng, **how))
        return drawn[-1]

    monkeypatch.setattr(render_room, "sample_room", noted)
    monkeypatch.setattr(render_room, "MAX_EXPOSURE", first.exposure * 0.99)
    assert make_room(small_build(2), index).exposure < first.exposure
    assert len(drawn) > 1 and drawn[0] == sample_room(room_generator(5, index))


def test_the_phone_is_held_as_by_a_person_and_inside_nothing(places):
    room, rays, _, views = places
    for view in views:
        pose = view.world_from_camera
        x, y, z = pose[:3, 3]
        assert room.outline.holds((x, y))
        assert 1.0 <= z <= 1.8
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert abs(np.degrees(np.arcsin(pose[2, 0]))) < 20, "roll"
        distances, _ = rays.cast(pose[:3, 3], AnchorLattice(200).directions.astype(np.float64))
        assert distances.min() > 0.1


def test_nothing_piles_up_from_room_to_room():
    def n_blocks():
        return sum(len(getattr(bpy.data, kind)) for kind in ("meshes", "materials", "objects", "lights", "images"))

    build_room(sample_room(room_generator(5, 0)))
    first = n_blocks()
    for i in range(3):
        build_room(sample_room(room_generator(5, i)))
    build_room(sample_room(room_generator(5, 0)))
    assert n_blocks() == first


@pytest.mark.slow
def test_all_that_a_varied_room_holds_is_built_and_visible_lamps_are_seen():
    rooms = [sample_varied_room(room_generator(8, i)) for i in range(4)]
    assert {piece.kind for room in rooms for piece in room.pieces} >= {"post", "stairs", "partition"}
    assert {hole.covering for room in rooms for hole in room.windows} >= {"slats"}
    for room in rooms:
        items = build_room(room).objects
        for i, piece in enumerate(room.pieces):
            assert piece.kind in LAMP_KINDS or any(item.name.startswith(f"{piece.kind} {i}") for item in items)
        lights = {item.name.split(" light")[0]: item.visible_camera for item in items if item.type == "LIGHT"}
        lit = {f"{lamp.kind} lamp {i}": lamp.is_visible for i, lamp in enumerate(room.lamps) if lamp.watts > 0}
        assert lit.items() <= lights.items()


@pytest.mark.slow
def test_a_second_build_makes_what_is_missing_alone(built):
    before = files_below(built)
    assert run_blocking(build_dataset(built, small_build(2))) == 0 and files_below(built) == before
    content = room_path(built, 0).read_bytes()
    room_path(built, 0).unlink()
    assert run_blocking(build_dataset(built, replace(small_build(2), n_workers=2))) == 1
    assert room_path(built, 0).read_bytes() == content
    assert {name for name, time in files_below(built).items() if before[name] != time} == {room_path(built, 0).name}


def test_a_room_is_there_once_all_of_it_is_written(room, tmp_path, monkeypatch):
    there, save = [], np.savez_compressed

    def noted(path, **arrays):
        save(path, **arrays)
        there.extend(stored_indices(tmp_path))

    monkeypatch.setattr(np, "savez_compressed", noted)
    save_room(room_path(tmp_path, 0), room)
    assert there == [] and list(stored_indices(tmp_path)) == [0]


@pytest.mark.slow
def test_a_closed_build_ends_its_workers_and_leaves_whole_files(tmp_path, monkeypatch):
    killed = []
    monkeypatch.setattr(subprocess.Popen, "kill", lambda process: killed.append(process.pid) or process.send_signal(9))
    n_rooms = 60_000  # Whose numbers are too long for a command line.
    job = build_dataset(tmp_path, small_build(n_rooms))
    for progress in job:
        if progress.done:
            break
    job.close()
    there = len(list(stored_indices(tmp_path)))
    time.sleep(0.5)
    assert len(list(stored_indices(tmp_path))) == there
    assert not killed
    assert missing_rooms(tmp_path, range(n_rooms))
    assert not list(tmp_path.glob(".room_*"))


def test_what_a_killed_worker_left_is_cleared_and_what_one_is_writing_is_not(tmp_path):
    left, written = (tmp_path / f".room_00000{k}.99.npz" for k in (1, 2))
    for path in (left, written):
        path.touch()
    long_ago = time.time() - LEFT_BEHIND_S - 1
    os.utime(left, (long_ago, long_ago))
    with rooms_held(tmp_path, small_build(3).provenance):
        pass
    assert written.exists() and not left.exists()


def test_a_room_that_was_cut_short_is_named(room, tmp_path):
    path = room_path(tmp_path, 0)
    save_room(path, room)
    assert run_blocking(build_dataset(tmp_path, small_build(1))) == 0
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(UserError, match=r"room_000000\.npz is damaged: delete it and build again"):
        run_blocking(build_dataset(tmp_path, small_build(1)))


def test_a_process_that_does_not_end_when_told_to_is_killed(monkeypatch):
    monkeypatch.setattr(one_core, "ENDS_WITHIN_S", 0.3)
    deaf = "from signal import *; import time; signal(SIGTERM, SIG_IGN); print('ready', flush=True); time.sleep(99)"
    with one_core.process_on_one_core([sys.executable, "-c", deaf], stdout=subprocess.PIPE) as (process, _):
        assert process.stdout.readline() == b"ready\n"
    assert process.returncode == -signal.SIGKILL
    process.stdout.close()


def test_only_training_rooms_are_lit_by_fewer_rays():
    settings = RoomRenderSettings()
    assert settings.probe("train").size == 80 and {settings.probe(s).size for s in ("validation", "test")} == {160}
    assert settings.numbers == [128, 96, 4, 160, 2, 80]


@pytest.mark.slow
def test_what_a_failing_worker_said_is_passed_on(tmp_path):
    with pytest.raises(UserError, match=r"BuildSettings\.render\.view_size: .* does not belong there"):
        run_blocking(build_dataset(tmp_path, replace(small_build(1), render=replace(SMALL, view_size=(32,)))))


def test_a_contact_sheet_shows_every_room(room):
    sheet = contact_sheet([room] * 5, n_columns=3)
    assert sheet.shape == (2 * (24 + 16 + 4), 3 * (32 + 4), 3)
    np.testing.assert_array_equal(sheet[:40, :32], sheet[44:84, 36:68])


def test_the_statistics_of_constant_light_are_known(room):
    grey = np.zeros_like(room.sh_ldr)
    grey[:, 0] = 0.25 * np.sqrt(4 * np.pi)
    statistics = light_statistics([replace(room, sh_ldr=grey)], n_anchors=64)
    np.testing.assert_allclose(statistics.mean_l00, 0.25 * np.sqrt(4 * np.pi), rtol=2e-3)
    assert max(spread.max() for spread in statistics.spread.values()) < 1e-3
    assert statistics.n_pairs == room.is_in_view.sum()
    assert statistics_table(statistics).count("\n") == 11
