"""Where to look in a small room: the advice, its captures, its camera, and that nothing else is changed."""

import contextlib
import json
import shutil
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest
from previs_runs import CAPTURED, counted_renders, files_below, unfinished_files
from scene_snapshot import nothing_changes
from tiny_scenes import opened, phone, saved

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.apply.datablocks import BETTER_PATH, better_path_camera, has_anything
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.capture.turned_camera import turned_camera
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.look_results import LookAway, LookResults, ObjectAdvice
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.better_camera import (
    add_better_camera,
    check_camera_file,
    poses_with_look,
    remove_better_camera,
    save_better_path,
)
from xihe_blender.previs.better_path import THE_MAP, LookWishes, better_path, render_looks
from xihenet.camera_path.looks import Look, LookSettings, turned_view


def looked(scene, out, settings=CAPTURED, wishes=None):
    return run_blocking(better_path(scene, out, settings, wishes or LookWishes(), blend_file=out.parent / "room.blend"))


def looked_in(folder, room_file, **wishes):
    """The advice for the room, in the folder `out` of `folder`."""
    shutil.copy(room_file, folder)
    return looked(opened(room_file), folder / "out", wishes=LookWishes(**wishes))


@pytest.fixture(scope="module")
def advice(room_file, tmp_path_factory):
    return looked_in(tmp_path_factory.mktemp("look"), room_file).objects


@pytest.fixture(scope="module")
def verified(room_file, tmp_path_factory):
    """The folder of a verified advice, which nothing may change, and what it says of objects."""
    folder = tmp_path_factory.mktemp("verified")
    return folder / "out", looked_in(folder, room_file, is_verified=True).objects


def test_the_advice_is_written_and_leaves_the_scene_as_it_was(scene, out):
    with nothing_changes():
        results = looked(scene, out, wishes=LookWishes(is_verified=True, n_random=2))
        bpy.context.view_layer.update()
    written = json.loads((out / "look.json").read_text())
    assert as_json(results) == written and from_json(LookResults, written) == results
    (ball,) = results.objects
    assert ball.name == "Ball" and ball.look.frame in results.frames
    assert ball.predicted_coverage > ball.coverage and f"at frame {ball.look.frame}" in ball.sentence
    true = ball.true_errors
    assert true.coverage_after > ball.coverage and len(true.random_after) == len(true.random_looks) == 2
    page = (out / "report.html").read_text()
    assert "A better path: room.blend" in page and page.count("data:image/png") == 1
    assert unfinished_files(out) == []


def test_the_sentence_says_what_a_look_takes_and_rounds_no_gain_up():
    turn = {"frame": 31, "words": "left", "yaw_deg": 61.0, "pitch_deg": 0.0, "turn_deg": 61.0}
    look = LookAway(**turn, hold_s=1, whole_s=2.6, place_m=(0.0, 0.0, 1.4), direction=(0.0, 1.0, 0.0))
    of_ball = {"positions_m": ((0.0, 0.0, 0.0),), "coverage": 0.94, "gain": 0.05, "predicted_coverage": 0.97}
    of_ball["from_behind"] = 0.1
    ball = ObjectAdvice(name="Ball", look=look, expected_error=0.0260, predicted_error=0.0249, **of_ball)
    assert ball.sentence == (
        "look left for 1 second at frame 31, 2.6 s with the turns. The share of directions that are seen rises from "
        "94 % to 97 %, and the expected error falls from 0.026 to 0.025 if the new ones have the light that was guessed"
    )
    without = replace(ball, look=None)
    assert without.sentence == "no look away from this path would add much: it shows 94 % of all directions"
    inside = replace(without, from_behind=0.56).sentence
    assert "Check the places: 56 % of the surfaces" in inside
    assert "the camera or the object seems to be inside" in inside
    advice = "Lead the path around the object or closer to it, or move the object"
    assert replace(without, coverage=0.011).sentence.endswith(advice)


def test_the_advice_goes_by_what_the_path_has_not_shown(scene, advice):
    (ball,) = advice
    # The phone looks down along +Y: what it shows newly is elsewhere.
    ahead = -_pose(scene, scene.camera, 1)[:3, 2]
    assert ball.gain > 0.05 and np.array(ball.look.direction) @ ahead < 0.95
    np.testing.assert_allclose(ball.look.place_m, _pose(scene, scene.camera, ball.look.frame)[:3, 3], atol=1e-5)


def test_asking_again_costs_no_render(scene, out, verified):
    shutil.copytree(verified[0], out)
    kept = files_below(out / "work")
    with counted_renders() as renders:
        again = looked(scene, out, wishes=LookWishes(objects=("Ball",), is_verified=True))
    assert renders == [] and files_below(out / "work") == kept
    assert again.objects == verified[1]


def test_a_look_that_two_objects_share_is_rendered_and_counted_once(scene, out, monkeypatch):
    monkeypatch.setattr("xihe_blender.previs.better_path.open_scanner", lambda *_: contextlib.nullcontext(MagicMock()))
    poses, kept = [], set()
    capture = contextlib.nullcontext(lambda _frame, pose: poses.append(pose))
    monkeypatch.setattr("xihe_blender.previs.better_path.turned_camera", lambda _scanner: capture)
    monkeypatch.setattr("xihe_blender.previs.better_path.read_kept", lambda path, _read: path if path in kept else None)
    monkeypatch.setattr("xihe_blender.previs.better_path.save_frame", lambda path, _frame: kept.add(path))
    monkeypatch.setattr("xihe_blender.previs.better_path.load_frame", lambda path: path)
    look, settings = Look(2, 60.0, 0.0, np.eye(4), turned_view(np.eye(4), 60.0, 0.0)), LookSettings()
    captured = SimpleNamespace(run=MagicMock(outputs=RunOutputs(out)))
    seen = run_blocking(render_looks(captured, [look, replace(look)], settings))
    assert len(poses) == len(kept) == len(list(look.poses(settings)))
    assert [len(frames) for frames in seen.values()] == [len(poses)]


@pytest.mark.slow
def test_a_stopped_advice_leaves_nothing_half_written_and_goes_on(scene, out, verified):
    wishes = LookWishes(is_verified=True)
    with contextlib.closing(better_path(scene, out, CAPTURED, wishes, blend_file=out.parent / "room.blend")) as job:
        for progress in job:
            if "rendering a look" in progress.doing and progress.done:
                break
    assert not (out / "look.json").exists() and unfinished_files(out) == []
    assert looked(scene, out, wishes=wishes).objects == verified[1]


@pytest.mark.slow
def test_the_map_needs_no_virtual_object(scene, out, monkeypatch):
    monkeypatch.setattr("xihe_blender.previs.better_path.MAP_PLACES", 10)
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    (one,) = looked(scene, out, wishes=LookWishes(is_for_map=True)).objects
    assert one.name == THE_MAP and len(one.positions_m) > 1 and one.look is not None


def test_senseless_wishes_are_refused_before_anything_is_written(scene, out):
    with pytest.raises(UserError, match="choose lattice"):
        looked(scene, out, replace(CAPTURED, estimator="truth"))
    with pytest.raises(UserError, match="there is no virtual object 'Vase'"):
        looked(scene, out, wishes=LookWishes(objects=("Vase",)))
    with pytest.raises(UserError, match="--random"):
        LookWishes(n_random=-1)
    assert not out.exists()


# -------------------------------------------------------------------------------------------------------------- cameras


def test_a_turned_camera_that_is_not_turned_sees_what_the_phone_sees(scene):
    with open_scanner(scene, RenderSettings((32, 24), samples=1)) as scanner:
        scanner.move_to(2)
        own = scanner.acquire_environment_scan()
        with turned_camera(scanner) as capture:
            turned = capture(2, own.world_from_camera)
        assert scanner.scene.camera == scene.camera
    np.testing.assert_allclose(turned.world_from_camera, own.world_from_camera, atol=1e-6)
    np.testing.assert_allclose(turned.plane_depth_m, own.plane_depth_m, rtol=1e-3)
    assert turned.intrinsics == own.intrinsics and not [o for o in bpy.data.objects if o.name.startswith("Xihe Turned")]


def test_a_turned_camera_has_the_lens_that_the_path_has_there(scene):
    cameras = [phone(scene, (0, -1, 1), (0, 0, 0.85), name) for name in ("First", "Hidden", "Last", "Never")]
    cameras[1].hide_render = True
    for camera, lens, frame in zip(cameras, (20, 30, 40, 50), (2, 3, 4, 4), strict=True):
        camera.data.lens = lens
        scene.timeline_markers.new("", frame=frame).camera = camera
    with open_scanner(scene, RenderSettings((32, 24), samples=1)) as scanner:
        own = [scanner.move_to(frame)[0] for frame in (1, 2, 3, 4)]
        with turned_camera(scanner) as capture:
            turned = [capture(frame, np.eye(4)).intrinsics for frame in (1, 2, 3, 4)]
    assert turned == own and own[0] == own[2] != own[3]


@pytest.fixture
def away(advice):
    return advice[0].look


def test_the_better_camera_goes_the_path_looks_away_and_comes_back(scene, away):
    scene.render.fps = 10
    camera, last = add_better_camera(scene, replace(away, frame=2))
    assert camera.data.animation_data is None
    path = {frame: _pose(scene, scene.camera, frame) for frame in (1, 2, 3)}
    poses = {frame: _pose(scene, camera, frame) for frame in range(1, last + 1)}
    np.testing.assert_allclose(poses[1], path[1], atol=1e-4)
    np.testing.assert_allclose(poses[2], path[2], atol=1e-4)
    np.testing.assert_allclose(poses[last], path[3], atol=1e-4)
    np.testing.assert_allclose(poses[last - 1], path[2], atol=1e-4)
    ahead = np.array([-pose[:3, 2] for pose in poses.values()])
    looking = (ahead @ np.array(away.direction) > 0.99).sum()
    assert looking >= 10, "a second at 10 frames a second"
    speed = np.degrees(np.arccos(np.clip((ahead[1:] * ahead[:-1]).sum(axis=1), -1, 1))) * 10
    assert speed.max() < 120


@pytest.mark.parametrize("is_zoom", [True, False])
def test_the_better_camera_has_the_lens_of_the_path_and_holds_it_during_the_look(scene, away, is_zoom):
    cameras, lenses = [scene.camera], (20.0, 35.0, 50.0)
    if not is_zoom:
        cameras += [phone(scene, (0, -1, 1), (0, 0, 0.85), name) for name in ("Second", "Third")]
    for number, lens in enumerate(lenses):
        data = cameras[0 if is_zoom else number].data
        data.lens = lens
        if is_zoom:
            data.keyframe_insert("lens", frame=number + 1)
        else:
            scene.timeline_markers.new("", frame=number + 1).camera = cameras[number]
    scene.frame_set(1)
    with nothing_changes():
        camera, last = add_better_camera(scene, replace(away, frame=2))
        found = []
        for frame in range(1, last + 1):
            scene.frame_set(frame)
            found.append(camera.evaluated_get(bpy.context.view_layer.depsgraph).data.lens)
        scene.frame_set(1)
        remove_better_camera()
    np.testing.assert_allclose(found, [20.0] + [35.0] * (last - 2) + [50.0], rtol=1e-5)


def test_remove_light_takes_the_better_camera_away(scene, away):
    with nothing_changes():
        add_better_camera(scene, away)
        add_better_camera(scene, away)
        assert better_path_camera().name == BETTER_PATH and has_anything(scene)
        scene.camera = better_path_camera()
        remove_better_camera()
    assert better_path_camera() is None and not has_anything(scene)


def test_a_copy_with_the_better_camera_is_saved_and_the_file_stays(scene, away, tmp_path):
    with nothing_changes():
        save_better_path(scene, away, tmp_path / "better.blend")
    assert unfinished_files(tmp_path) == []
    copy = opened(tmp_path / "better.blend")
    assert copy.camera.name == BETTER_PATH and copy.frame_end > 3
    end, before = copy.frame_end, [_pose(copy, copy.camera, frame) for frame in (1, copy.frame_end)]
    with nothing_changes():
        save_better_path(copy, away, tmp_path / "two_looks.blend")
    second = opened(tmp_path / "two_looks.blend")
    after = [_pose(second, second.camera, frame) for frame in (1, second.frame_end)]
    assert second.camera == better_path_camera() and second.frame_end > end
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_a_camera_file_must_be_another_blend(tmp_path):
    with pytest.raises(UserError, match=r"is no \.blend"):
        check_camera_file(tmp_path / "camera.mp4", tmp_path / "room.blend")
    room, same = tmp_path / "room.blend", tmp_path / "ROOM.BLEND"  # As on a disk that takes both for one name.
    room.touch()
    same.hardlink_to(room)
    for path in (room, same):
        with pytest.raises(UserError, match="another file"):
            check_camera_file(path, room)
    check_camera_file(tmp_path / "camera.BLEND", room)


def test_a_camera_file_replaces_that_of_an_earlier_look_and_no_other(scene, away, tmp_path):
    room, other, earlier = (tmp_path / f"{name}.blend" for name in ("room", "other", "earlier"))
    room.touch()
    saved(other)
    save_better_path(scene, away, earlier)
    check_camera_file(earlier, room)
    with pytest.raises(UserError, match="is there already"):
        check_camera_file(other, room)


def test_a_look_is_for_objects_or_for_the_map(room_file, tmp_path):
    asked = xihe_here("look", room_file, "--map", "--objects", "Ball", "--out", tmp_path / "out")
    assert_refused(asked, "give either --objects, or --map")
    assert not (tmp_path / "out").exists()


def test_a_look_takes_at_least_a_frame_each_way(away):
    poses = poses_with_look([np.eye(4), np.eye(4)], 0, away, frames_per_s=0.1)
    assert len(poses) >= 2 + 3
    np.testing.assert_array_equal(poses[0], poses[-2])


def _pose(scene, camera, frame):
    scene.frame_set(frame)
    return np.array(camera.matrix_world)


def test_a_turn_too_small_for_any_look_is_told(scene, out):
    wishes = LookWishes(looks=LookSettings(largest_turn_deg=1.0))
    with pytest.raises(UserError, match="no look is within 1 degrees of the path: give a larger --turn"):
        looked(scene, out, wishes=wishes)
