"""A phone's recording in a Blender file: what it becomes there, and the light that comes of it."""

from itertools import pairwise

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from addon_tests.pure.recordings import HALF, LAYOUTS, looking, seen, walk
from tiny_scenes import empty_scene

from xihe_blender.apply.sh_worlds import f_curves
from xihe_blender.capture.scanner import phone_camera
from xihe_blender.errors import UserError
from xihe_blender.footage.import_capture import import_capture
from xihe_blender.jobs import run_blocking
from xihe_blender.scene.phone_capture import frames_a_second, frames_of_times, remembered_capture
from xihenet.camera import project_points
from xihenet.captures import open_capture
from xihenet.records import Intrinsics
from xihenet.recording import SessionFacts, SessionRecorder

OFF_CENTRE = Intrinsics(64, 48, 50.0, 48.5, 30.2, 25.1)


def recorded(folder, frames):
    recorder = SessionRecorder(folder, SessionFacts(source="a test"))
    for frame in frames:
        recorder.record(frame)
    return folder


def imported(tmp_path, frames, **options):
    folder = recorded(tmp_path / "walk", frames)
    scene = empty_scene()
    return scene, run_blocking(import_capture(scene, folder, **options)), open_capture(folder)


# ------------------------------------------------------------------------------------------------------------- camera


@pytest.mark.parametrize("k", [Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0), OFF_CENTRE], ids=["square", "off centre"])
def test_blenders_camera_projects_as_the_phones_did(tmp_path, k):
    scene, made, capture = imported(tmp_path, walk(k))
    for number, captured in enumerate(capture.frames, start=1):
        scene.frame_set(number)
        points = np.array([tuple(vertex.co) for vertex in made.scan.data.vertices][::97], np.float64)
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


def test_a_lens_that_zooms_is_keyed_and_others_are_not(tmp_path):
    zooming = [Intrinsics(64, 48, 40.0 + i, 40.0 + i, 32.0, 24.0) for i in range(4)]
    frames = [seen(k, looking(0.1 * i, 0.0, (0, 0, 0)), 1 + i, i / 30) for i, k in enumerate(zooming)]
    scene, made, _ = imported(tmp_path, frames)
    assert {curve.data_path for curve in f_curves(made.camera.data)} == {"lens"}
    for number, k in enumerate(zooming, start=1):
        scene.frame_set(number)
        assert phone_camera(scene)[0].fx == pytest.approx(k.fx, abs=0.01)


def test_keys_are_linear_at_whole_frames_and_turns_do_not_flip(tmp_path):
    scene, made, _ = imported(tmp_path, walk(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0), 16))
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


# --------------------------------------------------------------------------------------------------------------- scan


def test_the_scan_lies_on_the_walls_and_faces_the_room(tmp_path):
    _, made, _ = imported(tmp_path, walk(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0), 12))
    mesh = made.scan.data
    points = np.array([tuple(vertex.co) for vertex in mesh.vertices])
    off_m = np.abs(HALF - np.abs(points)).min(axis=1)
    assert np.quantile(off_m, 0.99) < 0.015
    assert off_m.max() < 0.03  # In the corners between walls
    normals = np.array([tuple(face.normal) for face in mesh.polygons])
    centres = np.array([tuple(face.center) for face in mesh.polygons])
    assert ((normals * -centres).sum(axis=1) > 0).mean() > 0.999
    floor = np.abs(centres[:, 2] + HALF[2]) < 0.01
    assert floor.sum() > 500
    assert normals[floor].mean(axis=0) == pytest.approx((0, 0, 1), abs=0.02)
    assert made.scan.is_shadow_catcher


def test_the_scan_has_the_colours_that_were_seen(tmp_path):
    _, made, _ = imported(tmp_path, walk(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0), 12))
    mesh = made.scan.data
    points = np.array([tuple(vertex.co) for vertex in mesh.vertices])
    colours = np.array([tuple(colour.color_srgb)[:3] for colour in mesh.color_attributes[0].data]) * 255
    wall = (np.abs(points[:, 0] - HALF[0]) < 0.01) & (np.abs(points[:, 1]) < 1.2) & (np.abs(points[:, 2]) < 0.9)
    assert wall.sum() > 500
    np.testing.assert_allclose(colours[wall].mean(axis=0), (60, 160, 70), atol=3)
    shown = made.scan.active_material.node_tree.nodes
    assert any(node.type == "VERTEX_COLOR" and node.layer_name == mesh.color_attributes[0].name for node in shown)


# ----------------------------------------------------------------------------------------------------------- the rest


def test_pictures_play_behind_the_camera_with_the_recordings_times(tmp_path):
    k = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
    frames = [seen(k, looking(i, 0, (0, 0, 0)), i, time_s) for i, time_s in enumerate((0.0, 0.1, 0.2, 0.4))]
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


def test_the_recordings_own_images_are_shown_where_it_has_some(tmp_path):
    layout, k = LAYOUTS["Nerfstudio"]
    layout(tmp_path / "scan", walk(k))
    scene = empty_scene()
    made = run_blocking(import_capture(scene, tmp_path / "scan"))
    own = sorted((tmp_path / "scan" / "images").iterdir())
    assert [path.read_bytes() for path in sorted(made.pictures.iterdir())] == [path.read_bytes() for path in own]
    assert len(made.scan.data.polygons) > 5000
    assert any("30 frames a second are assumed" in sentence for sentence in made.said)


def test_the_first_look_is_marked(tmp_path):
    k = Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)
    _, made, _ = imported(tmp_path, [seen(k, looking(0, 0, (0.5, 0.1, 0.2)))])
    assert made.looked_at.name == "Xihe looked here first"
    assert tuple(made.looked_at.location) == pytest.approx((HALF[0], 0.1, 0.2), abs=1e-5)


def test_lengths_follow_the_scenes_units(tmp_path):
    folder = recorded(tmp_path / "walk", walk(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)))
    scene = empty_scene()
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 0.01
    made = run_blocking(import_capture(scene, folder))
    _, pose = phone_camera(scene)
    np.testing.assert_allclose(pose, open_capture(folder).frames[0].camera.world_from_camera, atol=1e-5)
    assert max(made.scan.dimensions) == pytest.approx(200 * HALF.max(), abs=5)


def test_what_was_there_stays(tmp_path):
    folder = recorded(tmp_path / "walk", walk(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0)))
    scene = empty_scene()
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    camera = bpy.data.objects.new("Phone", bpy.data.cameras.new("Phone"))
    for item in (lamp, camera):
        scene.collection.objects.link(item)
    scene.camera, before = camera, settings_of(scene)
    made = run_blocking(import_capture(scene, folder))
    assert list(scene.collection.objects) == [lamp, camera]
    assert list(scene.collection.children) == [made.collection]
    assert camera.name == "Phone" and not camera.animation_data and camera.data.lens == 50
    changed = {name for name, value in settings_of(scene).items() if value != before[name]}
    assert changed <= SET_BY_AN_IMPORT
    assert "Set for it" in " ".join(made.said)
    remembered = remembered_capture(scene)
    assert (remembered.folder, remembered.up) == (folder.resolve(), None)


SET_BY_AN_IMPORT = {
    *("scene.camera", "scene.frame_start", "scene.frame_end", "scene.frame_step", "scene.frame_current"),
    *("scene.frame_current_final", "scene.frame_float"),
    *("render.fps", "render.fps_base", "render.resolution_x", "render.resolution_y"),
    *("render.pixel_aspect_x", "render.pixel_aspect_y", "render.film_transparent"),
}


def settings_of(scene):
    owners = {"scene": scene, "render": scene.render, "cycles": scene.cycles, "view": scene.view_settings}
    return {
        f"{name}.{described.identifier}": value
        for name, owner in owners.items()
        for described in owner.bl_rna.properties
        if described.type != "COLLECTION" and isinstance(value := getattr(owner, described.identifier), PLAIN)
    } | {"scene.camera": scene.camera}


PLAIN = (bool, int, float, str, bpy.types.Object, bpy.types.World)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda folder: None, "is no folder"),
        (lambda folder: folder.mkdir(), "holds no recording that is known"),
        (lambda folder: (folder.mkdir(), (folder / "session.json").write_text("{")), "session.json"),
        (lambda folder: break_a_frame(recorded(folder, walk(OFF_CENTRE))), "frame_000003.exr"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line_and_leaves_nothing(tmp_path, make, said):
    make(tmp_path / "walk")
    scene = empty_scene()
    with pytest.raises(UserError, match=said) as caught:
        run_blocking(import_capture(scene, tmp_path / "walk"))
    assert "\n" not in str(caught.value)
    assert not scene.objects and not bpy.data.collections and not bpy.data.meshes
    assert remembered_capture(scene) is None
    assert not list(tmp_path.glob("*footage*"))


def break_a_frame(folder):
    path = folder / "frame_000003.exr"
    path.write_bytes(path.read_bytes()[:-200])
