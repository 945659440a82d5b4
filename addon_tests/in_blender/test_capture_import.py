"""A phone's recording in a Blender file: what it becomes there, and the light that comes of it."""

import contextlib
import json
import re
import shutil
import sys
from dataclasses import asdict, replace
from functools import partial
from itertools import pairwise

import bpy
import numpy as np
import pytest
from addon_runs import poll_message, registered_addon
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from previs_runs import counted_renders
from results_schema import SCHEMA
from scene_snapshot import differences, nothing_changes, snapshot
from tiny_scenes import add, add_lamp, box, empty_scene, phone

from addon_tests.pure.commands import assert_refused, xihe_here
from addon_tests.pure.recordings import HALF, LAYOUTS, as_nerfstudio, layouts, looking, seen, walk
from xihe_blender.addon.panels import result_rows
from xihe_blender.addon.results_in_blender import apply_results, remove_everything, show_lit
from xihe_blender.apply.keys import f_curves
from xihe_blender.capture.scanner import phone_camera
from xihe_blender.cli.main import main
from xihe_blender.compare.side_by_side import read_picture
from xihe_blender.errors import UserError
from xihe_blender.footage.import_capture import (
    capture_of,
    import_capture,
    opened_capture,
    recording_at,
    steadied_frames,
)
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults, read_results
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.compare_path import LIT_BY
from xihe_blender.previs.kept_session import capture_path
from xihe_blender.previs.previs import previs
from xihe_blender.previs.recorded_run import recorded_session
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.mesh_arrays import array_of
from xihe_blender.scene.phone_capture import (
    CAPTURE,
    CAPTURE_WAS,
    IS_CAPTURED,
    ChosenCapture,
    frames_a_second,
    frames_of_times,
    remembered_capture,
    scan_of,
)
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet import estimators
from xihenet.camera import project_points, unproject_frame
from xihenet.captures import open_capture
from xihenet.captures.drift import steadied
from xihenet.captures.replay import REPLAY_TRIGGER, never_in_view, replay
from xihenet.captures.scan import Scan
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.io.recording import SessionFacts, SessionRecorder
from xihenet.records import Intrinsics
from xihenet.trigger import RULES

CENTRED = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
OFF_CENTRE = Intrinsics(64, 48, 50.0, 48.5, 30.2, 25.1)


SCAN = "xihe_blender.footage.import_capture.Scan"


@pytest.fixture(scope="module", autouse=True)
def few_faces():
    """Recordings are scanned three times as coarsely as they are for a user, at a fifth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SCAN, partial(Scan, voxel_m=0.06))
        yield


@pytest.fixture
def as_fine_as_for_a_user(monkeypatch):
    monkeypatch.setattr(SCAN, Scan)


def recorded(folder, frames):
    recorder = SessionRecorder(folder, SessionFacts(source="a test"))
    for frame in frames:
        recorder.record(frame)
    return folder


def imported(tmp_path, frames):
    folder = recorded(tmp_path / "walk", frames)
    scene = empty_scene()
    return scene, run_blocking(import_capture(scene, ChosenCapture(folder))), open_capture(folder)


# ------------------------------------------------------------------------------------------------------------- camera


@pytest.mark.parametrize("k", [CENTRED, OFF_CENTRE], ids=["square", "off centre"])
def test_blenders_camera_projects_as_the_phones_did(tmp_path, k):
    scene, made, capture = imported(tmp_path, walk(k))
    for number, captured in enumerate(capture.frames, start=1):
        scene.frame_set(number)
        points = array_of(made.scan.data.vertices, "co", np.float32, 3)[::11].astype(np.float64)
        expected, depth_m = project_points(points, captured.camera.intrinsics, captured.camera.world_from_camera)[:2]
        in_front = depth_m > 0.1
        views = [world_to_camera_view(scene, made.camera, Vector(point)) for point in points[in_front]]
        found = np.array([(view.x * k.width, (1 - view.y) * k.height) for view in views])
        assert in_front.sum() > 50
        # Far beside the picture a pixel is a small angle.
        is_near = (np.abs(expected[in_front]) < 200).all(axis=1)
        np.testing.assert_allclose(found[is_near], expected[in_front][is_near], atol=0.02)
        intrinsics, pose = phone_camera(scene)
        own = captured.camera.intrinsics
        for name in ("fx", "fy", "cx", "cy"):
            assert getattr(intrinsics, name) == pytest.approx(getattr(own, name), abs=0.01), name
        np.testing.assert_allclose(pose, captured.camera.world_from_camera, atol=1e-5)


@pytest.mark.parametrize(("away_m", "is_far"), [(1_000, False), (500_000, True)])
def test_a_recording_in_the_coordinates_of_a_map_is_said_to_be_too_far_away(tmp_path, away_m, is_far):
    frame = seen(CENTRED, looking(0, 0, (0.3, 0, 0)), 1)
    there = frame.world_from_camera.copy()
    there[:3, 3] += away_m
    _, made, _ = imported(tmp_path, [replace(frame, world_from_camera=there)])
    assert made.scan is not None
    assert ("500 km from the origin" in " ".join(made.said)) is is_far


@pytest.mark.usefixtures("as_fine_as_for_a_user")
def test_a_phone_that_loses_its_way_in_its_first_frame_still_scans_the_room(tmp_path):
    lost, *others = walk(CENTRED, 3)
    there = lost.world_from_camera.copy()
    there[:3, 3] += 50_000
    _, made, _ = imported(tmp_path, [replace(lost, world_from_camera=there), *others])
    assert (np.abs(array_of(made.scan.data.vertices, "co", np.float32, 3)) < 10).all()


def test_a_lens_that_zooms_is_keyed_and_others_are_not(tmp_path):
    zooming = [Intrinsics(64, 48, 40.0 + i, 40.0 + i, 32.0, 24.0) for i in range(4)]
    frames = [seen(k, looking(0.1 * i, 0.0, (0, 0, 0)), 1 + i, i / 30) for i, k in enumerate(zooming)]
    scene, made, _ = imported(tmp_path, frames)
    assert {curve.data_path for curve in f_curves(made.camera.data)} == {"lens"}
    for number, k in enumerate(zooming, start=1):
        scene.frame_set(number)
        assert phone_camera(scene)[0].fx == pytest.approx(k.fx, abs=0.01)


def test_keys_are_linear_at_whole_frames_and_turns_do_not_flip(tmp_path):
    scene, made, _ = imported(tmp_path, walk(CENTRED, 16))
    curves = f_curves(made.camera)
    assert len(curves) == 7
    for curve in curves:
        assert [point.co[0] for point in curve.keyframe_points] == list(range(1, 17))
        assert {point.interpolation for point in curve.keyframe_points} == {"LINEAR"}
    turns = sorted((curve.array_index, curve) for curve in curves if curve.data_path == "rotation_quaternion")
    keys = np.array([[point.co[1] for point in curve.keyframe_points] for _, curve in turns]).T
    assert all(before @ after > 0 for before, after in pairwise(keys))
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (1, 16, 30)


def test_times_become_whole_frames():
    assert frames_a_second([0.0, 1 / 60, 2 / 60, 3 / 60]) == 60
    assert frames_a_second([0.0, 0.5, 1.0]) == 2
    assert frames_a_second([3.0]) == 24
    assert frames_of_times([5.0, 5.033, 5.067, 5.2]) == {1: 0, 2: 1, 3: 2, 7: 3}
    # Two of the same moment: the later one is left out.
    assert frames_of_times([0.0, 0.1, 0.101, 0.2]) == {1: 0, 2: 1, 3: 3}
    # Of a few pictures a second none is lost to a rate that is rounded down, or to times that are uneven.
    assert list(frames_of_times([0.4 * i for i in range(9)]).values()) == list(range(9))
    assert frames_a_second([0.0, 0.5, 0.75, 1.25, 1.7, 2.2]) == 4
    assert len(frames_of_times([0.0, 0.5, 0.75, 1.25, 1.7, 2.2])) == 6


def test_times_in_other_units_or_of_a_clock_that_was_set_are_refused_before_files_are_written():
    nanoseconds = [5e8 * i for i in range(8)]
    with pytest.raises(UserError, match=r"5e\+08 s pass between pictures 1 and 2 of the recording: correct its times"):
        frames_of_times(nanoseconds)
    clock_was_set = [i / 30 + 86400 * (i > 40) for i in range(80)]
    with pytest.raises(UserError, match="86400 s pass between pictures 41 and 42"):
        frames_of_times(clock_was_set)
    an_hour_away = [i / 30 + 3600 * (i > 400) for i in range(900)]
    assert len(frames_of_times(an_hour_away)) == 900
    assert len(frames_of_times([900.0 * i for i in range(8)])) == 8  # A time lapse


# --------------------------------------------------------------------------------------------------------------- scan


@pytest.mark.usefixtures("as_fine_as_for_a_user")
def test_the_scan_lies_on_the_walls_faces_the_room_and_has_the_colours_that_were_seen(tmp_path):
    _, made, _ = imported(tmp_path, walk(CENTRED, 12))
    mesh = made.scan.data
    points = array_of(mesh.vertices, "co", np.float32, 3)
    off_m = np.abs(HALF - np.abs(points)).min(axis=1)
    assert np.quantile(off_m, 0.99) < 0.015
    assert off_m.max() < 0.03  # In the corners between walls
    normals = array_of(mesh.polygons, "normal", np.float32, 3)
    centres = array_of(mesh.polygons, "center", np.float32, 3)
    assert ((normals * -centres).sum(axis=1) > 0).mean() > 0.999
    floor = np.abs(centres[:, 2] + HALF[2]) < 0.01
    assert floor.sum() > 500
    assert normals[floor].mean(axis=0) == pytest.approx((0, 0, 1), abs=0.02)
    assert made.scan.is_shadow_catcher
    assert made.scan.active_material.diffuse_color[3] < 0.5, "in a solid view the pictures behind show through"
    colours = np.array([tuple(colour.color_srgb)[:3] for colour in mesh.color_attributes[0].data]) * 255
    wall = (np.abs(points[:, 0] - HALF[0]) < 0.01) & (np.abs(points[:, 1]) < 1.2) & (np.abs(points[:, 2]) < 0.9)
    assert wall.sum() > 500
    np.testing.assert_allclose(colours[wall].mean(axis=0), (60, 160, 70), atol=3)
    shown = made.scan.active_material.node_tree.nodes
    assert any(node.type == "VERTEX_COLOR" and node.layer_name == mesh.color_attributes[0].name for node in shown)


# ----------------------------------------------------------------------------------------------------------- the rest


def test_pictures_play_behind_the_camera_with_the_recordings_times(tmp_path):
    frames = [seen(CENTRED, looking(i, 0, (0, 0, 0)), i, time_s) for i, time_s in enumerate((0.0, 0.1, 0.2, 0.4))]
    scene, made, _ = imported(tmp_path, frames)
    behind = made.camera.data.background_images[0]
    assert made.camera.data.show_background_images
    assert behind.image.source == "SEQUENCE"
    assert (scene.render.resolution_x, scene.render.resolution_y) == (64, 48)
    assert (behind.image_user.frame_start, behind.image_user.frame_duration) == (1, 5)
    files = sorted(path.name for path in made.pictures.iterdir())
    assert files == [f"frame_{number:04d}.png" for number in range(1, 6)]
    contents = [(made.pictures / name).read_bytes() for name in files]
    assert contents[2] == contents[3]  # In the gap the earlier one stays
    assert len(set(contents)) == 4
    image = bpy.data.images.load(str(made.pictures / files[4]))
    pixels = np.array(image.pixels[:]).reshape(48, 64, 4)[::-1, :, :3]
    np.testing.assert_allclose(pixels * 255, frames[3].srgb_u8, atol=0.01)


@pytest.mark.usefixtures("as_fine_as_for_a_user")
def test_the_recordings_own_images_are_shown_where_it_has_some(tmp_path):
    layout, k = LAYOUTS["Nerfstudio"]
    layout(tmp_path / "scan", walk(k))
    scene = empty_scene()
    made = run_blocking(import_capture(scene, ChosenCapture(tmp_path / "scan")))
    own = sorted((tmp_path / "scan" / "images").iterdir())
    assert [path.read_bytes() for path in sorted(made.pictures.iterdir())] == [path.read_bytes() for path in own]
    assert len(made.scan.data.polygons) > 5000
    assert any("30 frames a second are assumed" in sentence for sentence in made.said)


IMPORTED = ("7-Scenes", "Nerfstudio", "Polycam", "Record3D, upright", "Stray Scanner")


# That every layout is read as it was seen is tested in `pure/test_captures.py`.
@pytest.mark.parametrize("name", [*IMPORTED, "plain folder, upright, poses in files"])
def test_every_kind_of_recording_becomes_a_scan_with_gravity_down(tmp_path, name):
    layout, k = LAYOUTS[name]
    scene, path = empty_scene(), layout(tmp_path / "scan", walk(k))
    made = run_blocking(import_capture(scene, ChosenCapture(path)))
    found, own = phone_camera(scene)[0], open_capture(path).frames[0].camera.intrinsics
    assert found.width / found.height == own.width / own.height
    assert (found.fx / found.width, found.cx / found.width, found.cy / found.height) == pytest.approx(
        (own.fx / own.width, own.cx / own.width, own.cy / own.height), abs=1e-4
    )
    points = array_of(made.scan.data.vertices, "co", np.float32, 3)
    # The world of 7-Scenes is that of a camera, whose height is not said.
    assert np.quantile(points[:, 2], 0.98) - np.quantile(points[:, 2], 0.02) == pytest.approx(2 * HALF[2], abs=0.1)
    floor = array_of(made.scan.data.polygons, "normal", np.float32, 3)[:, 2] > 0.9
    low = array_of(made.scan.data.polygons, "center", np.float32, 3)[floor, 2]
    assert np.median(low) < np.median(points[:, 2])


def test_a_file_or_folder_in_a_recording_stands_for_it(tmp_path):
    write, intrinsics = LAYOUTS["Polycam"]
    path = write(tmp_path / "walk", walk(intrinsics, 2))
    picture = next((path / "keyframes" / "images").iterdir())
    for chosen in (path, path / "keyframes", picture.parent, picture):
        assert recording_at(chosen) == path
    for other in (tmp_path, path / "gone"):
        assert recording_at(other) == other


@pytest.mark.parametrize("name", layouts(["Record3D", "Stray Scanner", "Nerfstudio"]))
def test_a_blender_without_packages_runs_on_the_frames_that_an_import_kept(tmp_path, monkeypatch, name):
    write, intrinsics = LAYOUTS[name]
    path = write(tmp_path / "walk", walk(intrinsics, 3))
    scene, chosen = empty_scene(), ChosenCapture(path, None, 2.0, 0.5)
    shares = []
    job = import_capture(scene, chosen, blend_folder=tmp_path, keeps_frames=True)
    made = run_blocking(job, lambda progress, _: shares.append(progress.done / progress.total))
    assert shares == sorted(shares) and shares[0] == 0 and 0.8 < shares[-1] < 1
    assert str(made.pictures / path.stem) in " ".join(made.said) and remembered_capture(scene).path.name == path.stem
    expected = {n: one.read() for n, one in steadied_frames(opened_capture(chosen)).items()}
    for package in ("PIL", "lzfse", "av"):
        monkeypatch.setitem(sys.modules, package, None)
    kept = capture_of(scene)
    assert name in kept.source
    found = {n: one.read() for n, one in steadied_frames(kept).items()}
    assert found.keys() == expected.keys()
    for number, frame in found.items():
        was = expected[number]
        assert (frame.srgb_u8 == was.srgb_u8).all() and (frame.plane_depth_m == was.plane_depth_m).all()
        np.testing.assert_array_equal(frame.world_from_camera, was.world_from_camera)
        np.testing.assert_array_equal(frame.white_balance, was.white_balance)
        assert (frame.exposure, frame.time_s, frame.intrinsics) == (was.exposure, was.time_s, was.intrinsics)


def test_what_is_set_by_hand_is_remembered(tmp_path):
    folder = recorded(tmp_path / "walk", walk(CENTRED))
    scene, chosen = empty_scene(), ChosenCapture(folder, scale=0.5, floor_m=-HALF[2] / 2)
    made = run_blocking(import_capture(scene, chosen))
    heights = array_of(made.scan.data.vertices, "co", np.float32, 3)[:, 2]
    assert (heights.min(), heights.max()) == pytest.approx((0, HALF[2]), abs=0.02)
    assert remembered_capture(scene) == chosen
    np.testing.assert_allclose(phone_camera(scene)[1], capture_of(scene).frames[0].camera.world_from_camera, atol=1e-5)


def test_the_recording_of_a_file_that_was_saved_on_windows_is_found(tmp_path):
    scene = empty_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    scene[CAPTURE], scene[CAPTURE_WAS] = "//phone\\walk", "C:\\phone\\walk"
    assert remembered_capture(scene).path == tmp_path / "phone" / "walk"


def test_the_first_look_is_marked(tmp_path):
    _, made, _ = imported(tmp_path, [seen(CENTRED, looking(0, 0, (0.5, 0.1, 0.2)))])
    assert made.looked_at.name == "Xihe looked here first"
    assert tuple(made.looked_at.location) == pytest.approx((HALF[0], 0.1, 0.2), abs=1e-5)


def test_lengths_follow_the_scenes_units(tmp_path):
    folder = recorded(tmp_path / "walk", walk(CENTRED))
    scene = empty_scene()
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.01
    made = run_blocking(import_capture(scene, ChosenCapture(folder)))
    _, pose = phone_camera(scene)
    np.testing.assert_allclose(pose, open_capture(folder).frames[0].camera.world_from_camera, atol=1e-5)
    assert max(made.scan.dimensions) == pytest.approx(200 * HALF.max(), abs=5)


def test_what_was_there_stays(tmp_path):
    folder = recorded(tmp_path / "walk", walk(CENTRED))
    scene = empty_scene()
    lamp, camera = add_lamp(scene), phone(scene, (0, 0, 1), (0, 1, 1))
    bpy.context.view_layer.update()
    before = snapshot()
    made = run_blocking(import_capture(scene, ChosenCapture(folder)))
    assert list(scene.collection.objects) == [lamp, camera]
    assert list(scene.collection.children) == [made.collection]
    assert camera.name == "Phone" and not camera.animation_data and camera.data.lens == 50
    own = ("scenes/Scene/objects#", "scenes/Scene/view_layers/0/")
    changed = {path for path in differences(before, snapshot())[0] if not path.startswith(own)}
    assert changed <= {f"scenes/Scene/{name}" for name in SET_BY_AN_IMPORT}
    assert "Set for it" in " ".join(made.said)
    remembered = remembered_capture(scene)
    assert remembered == ChosenCapture(folder.resolve())


@pytest.mark.parametrize("marked", [(-5, 1), (1, 6), (100, 200)])
def test_markers_with_other_cameras_do_not_take_over(tmp_path, marked):
    folder = recorded(tmp_path / "walk", walk(CENTRED))
    scene = empty_scene()
    for frame in marked:
        other = phone(scene, (0, 0, frame), (0, 1, 1))
        scene.timeline_markers.new(other.name, frame=frame).camera = other
    made = run_blocking(import_capture(scene, ChosenCapture(folder)))
    assert "its camera, with a marker" in " ".join(made.said)
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        assert scene.camera == made.camera
    kept = [marker.frame for marker in scene.timeline_markers if marker.camera not in (None, made.camera)]
    assert kept == [frame for frame in marked if not scene.frame_start <= frame <= scene.frame_end]


SET_BY_AN_IMPORT = {
    *("camera", "frame_start", "frame_end", "frame_step", "frame_current", "frame_current_final", "frame_float"),
    *("render/fps", "render/fps_base", "render/resolution_x", "render/resolution_y"),
    *("render/pixel_aspect_x", "render/pixel_aspect_y", "render/film_transparent"),
}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder: None, "is not there"),
        (lambda folder: folder.mkdir(), "holds no recording that is known"),
        (lambda folder: (folder.mkdir(), (folder / "session.json").write_text("{")), "session.json"),
        (lambda folder: break_a_frame(recorded(folder, walk(OFF_CENTRE))), "frame_000003.exr"),
        (lambda folder: break_the_last_depth(as_nerfstudio(folder, standing_still(OFF_CENTRE))), "depth.*png"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line_and_leaves_nothing(tmp_path, make, said):
    make(tmp_path / "walk")
    of_the_user = tmp_path / "walk_footage_frames"
    of_the_user.mkdir()
    scene = empty_scene()
    with nothing_changes(), pytest.raises(UserError, match=said) as caught:
        run_blocking(import_capture(scene, ChosenCapture(tmp_path / "walk")))
    assert "\n" not in str(caught.value)
    assert not bpy.data.objects and not bpy.data.collections and not bpy.data.meshes
    assert remembered_capture(scene) is None
    assert list(tmp_path.glob("*footage*")) == [of_the_user]


def standing_still(k):
    """The last frames show nothing new: they are not scanned, and their pictures are linked as they are."""
    first = walk(k)[0]
    return [replace(first, frame=1 + i, time_s=i / 30) for i in range(4)]


def break_the_last_depth(folder):
    path = max(path for path in folder.rglob("*.png") if "depth" in str(path))
    path.write_bytes(path.read_bytes()[:-200])


def break_a_frame(folder):
    path = folder / "frame_000003.exr"
    path.write_bytes(path.read_bytes()[:-200])


# ---------------------------------------------------------------------------------------------------------------- runs

LAMP_M = np.array([1.2, 0.0, HALF[2]])
"""Middle of the lamp in the ceiling of `lamp_room`."""


FOOT_M = np.array([-0.2, 0.5, -HALF[2]])
"""Where the virtual pillar stands: on the floor, seen from -Y at the end of `lamp_walk`."""


def lamp_room(k, pose, number, time_s, exposure):
    """The room of coloured walls, dim, with a lamp in its ceiling on the side of +X, seen with an exposure."""
    frame = seen(k, pose, number, time_s)
    points_m = unproject_frame(frame).points_m.reshape(k.height, k.width, 3)
    is_lamp = np.linalg.norm(points_m - LAMP_M, axis=-1) < 0.45
    srgb = linear_to_srgb(srgb_to_linear(frame.srgb_u8 / 255) * 0.15 * exposure)
    srgb_u8 = np.where(is_lamp[..., None], 255, srgb * 255).astype(np.uint8)
    return replace(frame, srgb_u8=srgb_u8, exposure=exposure)


def lamp_walk(k, n=8):
    """A look around, at the lamp too, that ends on the floor; the exposure drifts at its end."""
    turns = 2 * np.pi * np.arange(n - 2) / (n - 2)
    poses = [looking(turn, 0.5 * np.cos(turn), (0.9, 0.1 * np.sin(turn), 0.4)) for turn in turns]
    poses += [looking(np.pi / 2, pitch, (-0.2, -1.2, 0.1)) for pitch in (-0.6, -0.55)]
    exposures = [1.0] * (n - 1) + [1.3]
    together = enumerate(zip(poses, exposures, strict=True))
    return [lamp_room(k, pose, 40 + i, 2.0 + i / 30, exposure) for i, (pose, exposure) in together]


def with_a_pillar(scene):
    """A virtual pillar on the floor, in view at the end of `lamp_walk`."""
    middle_m = FOOT_M + [0, 0, 0.25]
    return box(scene, "Pillar", tuple(middle_m), (0.2, 0.2, 0.5), collection=virtual_collection(scene, create=True))


def run_on(scene, out, **settings):
    """The results of a run on the recording of `scene`."""
    return from_json(RunResults, run_blocking(previs(scene, out, PrevisSettings(preset="draft", **settings))))


@pytest.fixture(scope="module")
def recorded_run(tmp_path_factory):
    """A run on a recording, with a lens that is off centre: its folder, the recording's, and what was rendered."""
    folder = tmp_path_factory.mktemp("recorded")
    recording = recorded(folder / "walk", lamp_walk(OFF_CENTRE))
    scene = scene_of(recording, folder)
    with counted_renders() as renders:
        results = run_blocking(previs(scene, folder / "out", PrevisSettings(preset="draft")))
    SCHEMA.validate(json.loads(json.dumps(results)))
    assert as_json(from_json(RunResults, results)) == results
    return folder / "out", recording, renders


def test_a_run_has_the_light_of_replay_to_the_last_bit(recorded_run):
    out, recording, _ = recorded_run
    found = read_results(out)
    positions = {probe.name: np.array(probe.position_m) for probe in found.probes}
    capture = open_capture(recording)
    estimator = estimators.load(found.settings.estimator, target=found.settings.target)
    own = {"trigger": capture.trigger or REPLAY_TRIGGER, "reference_exposure": capture.reference_exposure}
    unseen = never_in_view(capture, positions)
    steps = replay(capture, positions, estimator, has_key_light=True, never_in_view=unseen, **own)
    by_time = {step.time_s: step.lights for step in steps}
    n = 0
    for entry in found.frames:
        for probe in entry.probes:
            if probe.light_frame is not None:
                assert np.array_equal(np.array(probe.sh), by_time[entry.time_s][probe.name].sh)
                n += 1
    assert n > 0
    assert found.settings.reference_exposure == 1.0
    assert [entry.time_s for entry in found.frames] == [one.time_s for one in capture.frames]


def test_what_drifted_unsaid_is_followed_as_replay_does_it(tmp_path):
    layout, _ = LAYOUTS["Nerfstudio"]
    # With fewer pixels too few surfaces are seen again.
    layout(tmp_path / "scan", lamp_walk(Intrinsics(64, 48, 50.0, 50.0, 32.0, 24.0)))
    found = run_on(scene_of(tmp_path / "scan", tmp_path), tmp_path / "out")
    capture, drift = steadied(open_capture(tmp_path / "scan"))
    assert drift.gains[-1].mean() > 1.1
    positions = {probe.name: np.array(probe.position_m) for probe in found.probes}
    estimator = estimators.load(found.settings.estimator, target=found.settings.target)
    unseen = never_in_view(capture, positions)
    steps = list(replay(capture, positions, estimator, has_key_light=True, never_in_view=unseen))
    last = found.frames[-1].probes[-1]
    assert np.array_equal(np.array(last.sh), steps[-1].lights[last.name].sh)


def test_a_run_renders_the_objects_alone_and_says_that_there_is_no_truth(recorded_run):
    out, _, renders = recorded_run
    found = read_results(out)
    assert set(renders) <= {"Xihe Effects", "Xihe Lit", "Xihe Film"}
    assert found.recording.said == IS_CAPTURED
    assert IS_CAPTURED in found.notes
    assert not found.comparison and not found.compared_frames
    assert all(probe.sh_truth is None and probe.shc_rmse is None for probe in found.probes)
    assert found.summary.mean_shc_rmse is None
    page = (out / "report.html").read_text()
    assert "there is no ground truth" in page
    assert set(re.findall(r'<img data-kind="(\w+)"', page)) == {"captured", found.settings.estimator}
    assert "nan" not in re.findall(r">([^<]*)<", page)
    assert (out / "composited.mp4").stat().st_size > 1000
    assert (out / "untitled_lit.blend").exists()


def test_the_pillar_is_in_the_picture_with_its_shadow_away_from_the_lamp(recorded_run):
    out, recording, _ = recorded_run
    found = read_results(out)
    captured = list(open_capture(recording))[-1]
    picture = srgb_to_linear(read_picture(out / found.frames[-1].composited[found.settings.estimator]))
    before = srgb_to_linear(captured.srgb_u8 / 255.0)

    def around(point_m):
        place, _ = project_points(np.array([point_m]), captured.intrinsics, captured.world_from_camera)[:2]
        column, row = place[0].astype(int)
        return slice(row - 1, row + 2), slice(column - 1, column + 2)

    # The lamp is on the side of +X, so that the shadow falls towards -X.
    away, toward = around(FOOT_M - [0.17, 0, 0]), around(FOOT_M + [0.22, 0, 0])
    assert picture[away].mean() < 0.8 * before[away].mean()
    assert picture[toward].mean() > 0.9 * before[toward].mean()
    pillar = around(FOOT_M + [0, -0.1, 0.25])
    assert np.abs(picture[pillar] / before[pillar] - 1).mean() > 0.2
    # What is far from it is the recording, byte for byte.
    assert np.array_equal(
        read_picture(out / found.frames[-1].composited["lattice"])[:7], np.float32(captured.srgb_u8[:7] / 255)
    )


def test_a_run_is_taken_up_again_and_then_done(recorded_run):
    out, recording, _ = recorded_run
    scene = scene_of(recording, out.parent / "again")
    before = read_results(out)
    with counted_renders() as renders:
        results = run_blocking(previs(scene, out, PrevisSettings(preset="draft")))
    assert not renders
    assert results == as_json(before)


def test_a_damaged_capture_is_read_from_the_recording_again_and_not_rendered(recorded_run, tmp_path):
    out, recording, _ = recorded_run
    copied = RunOutputs(shutil.copytree(out, tmp_path / "out"), "walk")
    copied.results.unlink()
    whole = copied.capture(3).read_bytes()
    copied.capture(3).write_bytes(whole[:-100])
    scene = scene_of(recording, tmp_path / "again")
    with counted_renders() as renders:
        run_on(scene, copied.folder)
    assert "Xihe Capture" not in renders
    assert copied.capture(3).read_bytes() == whole


def test_pictures_of_another_light_than_an_edge_service_gives_after_a_stop_are_made_again(recorded_run, tmp_path):
    out, recording, _ = recorded_run
    copied = RunOutputs(shutil.copytree(out, tmp_path / "out"), "walk")
    copied.results.unlink()
    last = read_results(out).frames[-1].frame
    picture, noted = copied.picture("lattice", last), json.loads(copied.compared(last).read_text())
    whole = picture.read_bytes()
    picture.write_bytes(copied.picture("captured", last).read_bytes())
    for sh in noted[LIT_BY].values():
        sh[0][0] += 0.1
    copied.compared(last).write_text(json.dumps(noted))
    scene = scene_of(recording, tmp_path / "again")
    with counted_renders() as renders:
        run_on(scene, copied.folder)
    assert renders.count("Xihe Lit") == 1 and picture.read_bytes() == whole


def test_objects_that_no_frame_sees_are_asked_about_in_every_frame(tmp_path):
    recording = recorded(tmp_path / "walk", lamp_walk(SMALL)[:2])
    found = run_on(scene_of(recording, tmp_path), tmp_path / "out")
    assert [entry.active for entry in found.frames] == [True, True]


def test_the_trigger_is_the_recordings_own_unless_another_is_chosen(recorded_run, tmp_path):
    out, recording, _ = recorded_run
    scene = scene_of(recording, tmp_path)
    own, every = read_results(out), run_on(scene, tmp_path / "out", trigger=RULES["every-frame"])
    assert own.settings.trigger == asdict(REPLAY_TRIGGER)
    assert every.settings.trigger == asdict(RULES["every-frame"])
    chosen = recorded_session(scene, PrevisSettings(trigger=RULES["split"]))
    assert chosen.settings.trigger == RULES["split"]
    assert own.summary.n_estimates < every.summary.n_estimates == every.summary.n_active_frames


def test_gaps_and_chosen_frames(tmp_path):
    frames = [replace(frame, time_s=time_s) for frame, time_s in zip(lamp_walk(SMALL), GAPPED_S, strict=True)]
    scene = scene_of(recorded(tmp_path / "walk", frames), tmp_path)
    assert scene.frame_end == 10
    found = run_on(scene, tmp_path / "out", frames=(6, 7, 8, 9))
    assert [entry.frame for entry in found.frames] == [6, 9]
    with pytest.raises(UserError, match="none of these frames"):
        run_blocking(previs(scene, tmp_path / "out", PrevisSettings(frames=(7, 8))))


GAPPED_S = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.8, 0.9]


def test_a_recording_with_a_lens_off_centre_is_composited_where_it_should(recorded_run):
    out, recording, _ = recorded_run
    found = read_results(out)
    captured = list(open_capture(recording))[-1]
    picture = read_picture(out / found.frames[-1].composited[found.settings.estimator])
    changed = np.abs(picture - captured.srgb_u8 / 255.0).max(axis=-1) > 0.1
    top_m = np.array([FOOT_M + [x, y, 0.5] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    foot_m = np.array([FOOT_M + [x, -0.1, 0] for x in (-0.1, 0.1)])
    places, _ = project_points(np.concatenate([top_m, foot_m]), captured.intrinsics, captured.world_from_camera)[:2]
    rows, columns = np.nonzero(changed)
    # The top is bright; the foot may be as dark as the floor.
    assert rows.min() == pytest.approx(places[:, 1].min(), abs=1.5)
    assert np.median(columns[rows < places[:4, 1].max()]) + 0.5 == pytest.approx(places[:4, 0].mean(), abs=1.0)


SMALL = Intrinsics(32, 24, 25.0, 25.0, 16.0, 12.0)


def scene_of(recording, folder):
    """A new scene with `recording`, and a virtual pillar in it."""
    scene = empty_scene()
    folder.mkdir(exist_ok=True)
    run_blocking(import_capture(scene, ChosenCapture(recording), blend_folder=folder))
    with_a_pillar(scene)
    return scene


def test_what_does_not_fit_the_recording_is_said(tmp_path):
    scene = scene_of(recorded(tmp_path / "walk", lamp_walk(SMALL)), tmp_path)
    scene.camera.parent = add(scene, "Moved", location=(0.5, 0, 0))
    with pytest.raises(UserError, match="is not where the phone was") as moved:
        run_blocking(previs(scene, tmp_path / "out", PrevisSettings()))
    scene["xihe_capture"] = scene["xihe_capture_was"] = "/gone"
    with pytest.raises(UserError, match="gone from") as gone:
        run_blocking(previs(scene, tmp_path / "out", PrevisSettings()))
    assert not any("\n" in str(caught.value) for caught in (moved, gone))
    assert not (tmp_path / "out").exists()


def test_what_renders_a_room_refuses_a_recording(tmp_path):
    scene = scene_of(recorded(tmp_path / "walk", lamp_walk(SMALL)), tmp_path)
    with contextlib.ExitStack() as held, pytest.raises(UserError, match="cannot be rendered from elsewhere"):
        file = tmp_path / "a.blend"
        run_blocking(capture_path(scene, tmp_path / "out", PrevisSettings(), "a map", held, blend_file=file))
    with pytest.raises(UserError, match="`truth` is rendered"):
        run_blocking(previs(scene, tmp_path / "out", PrevisSettings(estimator="truth")))


# ------------------------------------------------------------------------------------------- panel and command line


def test_the_operator_imports_and_undo_takes_it_back(tmp_path):
    recording = recorded(tmp_path / "walk", walk(SMALL))
    scene = empty_scene()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    with registered_addon():
        n_items = len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize())
        bpy.ops.ed.undo_push(message="Start")
        assert bpy.ops.xihe.import_capture("EXEC_DEFAULT", True, filepath=str(recording / "session.json")) == {
            "FINISHED"
        }
        scene = bpy.context.scene
        assert scene["xihe_capture"] == "//walk"
        assert scene.camera.data.background_images[0].image.filepath.startswith("//walk_footage")
        assert bpy.context.active_object == scene.camera
        assert "Captured by a phone" in poll_message(bpy.ops.xihe.add_better_camera), "no run would go its path"
        # A copy of the file elsewhere, as a run in the background has one, still finds the recording.
        (tmp_path / "runs").mkdir()
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "runs" / "copy.blend"))
        assert remembered_capture(bpy.context.scene).path == recording
        bpy.ops.ed.undo()
        scene = bpy.context.scene
        assert not scene.objects and "xihe_capture" not in scene
        assert not bpy.data.collections
        with pytest.raises(RuntimeError, match="holds no recording that is known"):
            bpy.ops.xihe.import_capture(filepath=str(tmp_path / "runs"))
        assert not scene.objects
    assert len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize()) == n_items - 1


@pytest.mark.slow
def test_the_command_makes_a_file_that_previs_runs_on(tmp_path, capfd):
    recording, blend = recorded(tmp_path / "walk", lamp_walk(SMALL, 4)), tmp_path / "room.blend"
    assert main(["import", str(recording), "--out", str(blend)]) == 0
    assert "Imported 4 frames" in capfd.readouterr().out
    assert_refused(xihe_here("import", recording, "--out", blend), "is there already")
    assert_refused(xihe_here("import", tmp_path, "--out", tmp_path / "other.blend"), f"give {recording}")
    assert not (tmp_path / "other.blend").exists()
    assert_refused(
        xihe_here("import", recording, "--out", tmp_path / f"{249 * 'a'}.blend"), "too long", after_progress=True
    )
    assert {path.name for path in tmp_path.iterdir()} == {"room.blend", "walk", "walk_footage"}
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    scene = bpy.context.scene
    image = scene.camera.data.background_images[0].image
    assert image.filepath == "//walk_footage/frame_0001.png"
    assert (scene["xihe_capture"], scene.render.engine) == ("//walk", "CYCLES")
    with_a_pillar(scene)
    bpy.ops.wm.save_mainfile()
    assert main(["previs", str(blend), "--out", str(tmp_path / "out"), "--preset", "draft"]) == 0
    assert "4 frames" in capfd.readouterr().out
    assert (tmp_path / "out" / "composited.mp4").exists()
    assert_refused(xihe_here("video", tmp_path / "out"), "composited.mp4")


def test_the_light_is_shown_over_the_recording_with_its_shadow_on_the_scan(recorded_run, tmp_path):
    out, recording, _ = recorded_run
    with registered_addon():
        scene = scene_of(recording, tmp_path)
        apply_results(scene, out)
        lit = show_lit(scene, out, "Pillar")
        names = {item.name for item in lit.objects}
        assert "Phone Scan" not in " ".join(names)
        catcher = next(item for item in lit.objects if item.type == "MESH" and item.is_shadow_catcher)
        n_faces = sum(len(face.vertices) - 2 for face in scan_of(scene).data.polygons)
        assert len(catcher.data.polygons) == n_faces
        assert scan_of(scene).data != catcher.data
        remove_everything()
        assert scan_of(scene) is not None and len(scan_of(scene).data.polygons) > 0
        assert result_rows(read_results(out))


@pytest.mark.parametrize("light", ["sh", "sh+key+reflections"])
def test_other_estimators_and_parts_of_light_are_composited_too_and_the_film_shows_the_chosen_one(
    tmp_path, light, monkeypatch
):
    films = []
    monkeypatch.setattr("xihe_blender.previs.compare_path.save_film", lambda pictures, *_: films.append(pictures))
    scene = scene_of(recorded(tmp_path / "walk", lamp_walk(SMALL)), tmp_path)
    choices = {"others": ("projection",), "captured": "in-view", "network": "wifi"}
    found = run_on(scene, tmp_path / "out", light=light, **choices)
    last = found.frames[-1]
    assert set(last.composited) == {"lattice", "projection"}
    ((*_, at_the_end),) = (film.values() for film in films)
    assert at_the_end == tmp_path / "out" / last.composited["lattice"]
    pictures = [read_picture(tmp_path / "out" / last.composited[name]) for name in ("lattice", "projection")]
    assert np.abs(pictures[0] - pictures[1]).max() > 0.01
    assert found.settings.light == light
    assert found.phone.shc_rmse is None
    assert (found.lights["Pillar"][-1].reflections is not None) == (light == "sh+key+reflections")
