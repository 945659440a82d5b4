"""What the phone sees: plane depth, intrinsics, poses, exposure."""

import ctypes
import math
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Vector
from renders import captured
from tiny_scenes import (
    add,
    box,
    empty_scene,
    key,
    light_strength,
    material,
    phone,
    room_with_a_virtual_sphere,
    set_world,
)

from xihe_blender.capture import render
from xihe_blender.capture.cycles_device import DEVICE_VARIABLE
from xihe_blender.capture.render import RenderSettings, render_scene, working_scene
from xihe_blender.capture.scanner import METERING_SAMPLES, meter_exposure, open_scanner, phone_camera, sized_for
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihenet.camera import pixel_rays, unproject_frame
from xihenet.phone.metering import KEY_LUMINANCE

ROOT = Path(__file__).resolve().parents[2]

SMALL = RenderSettings((64, 48), samples=1, denoise=False)


def furnished():
    """Boxes at odd angles in a room, so that a wrong ray shows, and a phone."""
    scene = empty_scene()
    set_world(scene, (1.0, 1.0, 1.0))
    box(scene, "Room", (0, 0, 1.5), (5, 6, 3), inward=True)
    for k in range(5):
        item = box(scene, f"Box {k}", (k * 0.7 - 1.5, 0.4 * k, 0.3 + 0.2 * k), (0.5, 0.4, 0.6))
        item.rotation_euler = (0.3 * k, 0.2 * k, 0.5 * k)
    phone(scene, (-2, -2.5, 1.6), (0.5, 0.5, 0.8))
    return scene


def cast(scene, frame):
    """Ray distance through every pixel centre by Blender's own ray cast, without rendering."""
    depsgraph = scene.view_layers[0].depsgraph
    depsgraph.update()
    eye = frame.world_from_camera[:3, 3]
    one_metre = type(frame)(frame.srgb_u8, np.ones_like(frame.plane_depth_m), frame.intrinsics, frame.world_from_camera)
    distances = []
    for point in unproject_frame(one_metre).points_m.astype(float):
        hit, place, *_ = scene.ray_cast(depsgraph, Vector(eye), Vector(point - eye).normalized())
        distances.append((Vector(eye) - place).length if hit else np.nan)
    return np.array(distances).reshape(frame.plane_depth_m.shape)


def assert_depth_is_the_ray_cast(scene, size=(64, 48)):
    frame = captured(scene, size)
    error = np.abs(frame.plane_depth_m * np.linalg.norm(pixel_rays(frame.intrinsics), axis=-1) - cast(scene, frame))
    assert np.median(error) < 1e-4
    # A handful of pixels lie on an edge, where either surface is right.
    assert np.mean(error > 1e-3) < 0.01


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"shift_x": 0.2, "shift_y": -0.15},
        {"sensor_fit": "VERTICAL", "lens": 24},
        {"sensor_fit": "HORIZONTAL", "sensor_width": 20, "lens": 14},
        {"lens_unit": "FOV", "angle": math.radians(100)},
    ],
)
def test_plane_depth_is_the_ray_cast_for_any_lens(change):
    scene = furnished()
    for name, value in change.items():
        setattr(scene.camera.data, name, value)
    assert_depth_is_the_ray_cast(scene)


def test_plane_depth_is_the_ray_cast_for_a_portrait_phone():
    scene = furnished()
    scene.render.resolution_x, scene.render.resolution_y = 48, 64
    assert sized_for(scene, SMALL).size == (48, 64)
    assert_depth_is_the_ray_cast(scene, (48, 64))


@pytest.mark.parametrize("seed", range(3))
def test_plane_depth_is_the_ray_cast_for_a_rolled_and_tilted_phone(seed):
    scene = furnished()
    rng = np.random.default_rng(seed)
    scene.camera.location = rng.uniform([-2, -2.5, 1], [2, 2.5, 2.5])
    scene.camera.rotation_euler = rng.uniform(-3, 3, 3)
    assert_depth_is_the_ray_cast(scene)


def test_a_scaled_parent_does_not_bend_the_phone():
    scene = furnished()
    scene.camera.parent = add(scene, "Parent")
    scene.camera.parent.scale, scene.camera.parent.rotation_euler = (0.2, 0.2, 0.2), (0.1, 0.2, 0.3)
    assert_depth_is_the_ray_cast(scene)


def test_capture_leaves_virtual_objects_out():
    scene = room_with_a_virtual_sphere()
    with_ball = captured(scene)
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    without = captured(scene)
    np.testing.assert_array_equal(with_ball.plane_depth_m, without.plane_depth_m)
    np.testing.assert_array_equal(with_ball.srgb_u8, without.srgb_u8)


def test_each_frame_is_rendered_from_its_own_place_on_the_path():
    scene = room_with_a_virtual_sphere()
    frames = []
    with open_scanner(scene, SMALL) as scanner:
        for number in (1, 3, 2):
            scanner.move_to(number)
            frames.append(scanner.acquire_environment_scan())
    assert [frame.frame for frame in frames] == [1, 3, 2]
    assert frames[1].time_s == pytest.approx(2 / 24)
    assert np.abs(frames[0].plane_depth_m - frames[1].plane_depth_m).mean() > 0.05
    assert frames[1].world_from_camera[0, 3] == pytest.approx(-0.6)


def test_a_constraint_moves_the_phone():
    scene = furnished()
    scene.camera.constraints.new("COPY_LOCATION").target = add(scene, "Rail", location=(1.0, -2.0, 1.2))
    assert_depth_is_the_ray_cast(scene)
    with open_scanner(scene, SMALL) as scanner:
        np.testing.assert_allclose(scanner.move_to(1)[1][:3, 3], (1.0, -2.0, 1.2), atol=1e-6)


def test_markers_switch_the_phone():
    scene = room_with_a_virtual_sphere()
    for frame, camera in ((1, scene.camera), (3, phone(scene, (1, 1, 1), (0, 0, 0.8), "Second"))):
        scene.timeline_markers.new("switch", frame=frame).camera = camera
    with open_scanner(scene, SMALL) as scanner:
        assert scanner.move_to(1)[1][0, 3] == pytest.approx(-1.2)
        assert scanner.move_to(3)[1][0, 3] == pytest.approx(1.0)


def test_no_camera_and_one_that_is_not_perspective_or_scaled_to_zero_are_refused():
    scene = furnished()
    for kind in ("ORTHO", "PANO"):
        scene.camera.data.type = kind
        with pytest.raises(UserError, match="must be perspective"):
            phone_camera(scene)
    scene.camera.data.type, scene.camera.scale = "PERSP", (1, 0, 1)
    with pytest.raises(UserError, match="scale of 0"):
        phone_camera(scene)
    scene.camera = None
    with (
        working_scene(scene, "Xihe Plan", RenderSettings((4, 4), samples=1)) as working,
        pytest.raises(UserError, match=f"scene '{scene.name}' has no camera"),
    ):
        phone_camera(working)


def test_sky_has_no_plane_depth_but_a_colour():
    scene = empty_scene()
    set_world(scene, (0.2, 0.4, 0.8))
    phone(scene, (0, 0, 1), (0, 1, 1))
    frame = captured(scene)
    assert frame.invalid == {"no_surface": 64 * 48}
    assert not frame.plane_depth_m.any()
    np.testing.assert_allclose(frame.ambient, (0.2, 0.4, 0.8), atol=5e-3)


def test_metering_brings_a_grey_world_to_the_key():
    scene = empty_scene()
    set_world(scene, (3.0, 3.0, 3.0))
    phone(scene, (0, 0, 1), (0, 1, 1))
    assert run_blocking(meter_exposure(scene, [1, 2, 3])) == pytest.approx(KEY_LUMINANCE / 3, rel=1e-3)


def test_highlights_in_view_are_protected():
    scene = room_with_a_virtual_sphere(1)
    box(scene, "Panel", (0, 0.3, 0.9), (0.3, 0.02, 0.3), material("Panel", (1, 1, 1), 3.0))
    with open_scanner(scene, SMALL) as scanner:
        scanner.exposure = run_blocking(meter_exposure(scene, [1], samples=METERING_SAMPLES))
        scanner.move_to(1)
        frame = scanner.acquire_environment_scan()
    assert scanner.exposure < run_blocking(meter_exposure(scene, [1], metering="key", samples=METERING_SAMPLES))
    assert (frame.srgb_u8 == 255).any(axis=-1).mean() <= 0.02


def test_a_lamp_that_is_off_at_first_does_not_blow_out_the_rest():
    scene = room_with_a_virtual_sphere()
    always = run_blocking(meter_exposure(scene, [1, 2, 3]))
    key(light_strength(), "default_value", {1: 0.0, 2: 6.0, 3: 6.0})
    assert always < run_blocking(meter_exposure(scene, [1, 2, 3])) < 15 * always


@pytest.mark.parametrize(("chosen", "device"), [("cpu", "CPU"), ("", "GPU")])
def test_the_environment_says_what_is_rendered_on_or_else_the_users_scene(monkeypatch, chosen, device):
    scene = empty_scene()
    scene.cycles.device = "GPU"
    monkeypatch.setenv(DEVICE_VARIABLE, chosen)
    with working_scene(scene, "Working", RenderSettings((8, 6), samples=1)) as working:
        assert working.cycles.device == device
    assert scene.cycles.device == "GPU"


def test_a_kind_of_device_that_is_not_here_is_refused_before_anything_is_rendered(monkeypatch):
    monkeypatch.setenv(DEVICE_VARIABLE, "abacus")
    with (
        pytest.raises(UserError, match="'ABACUS' on this machine: choose one of CPU"),
        working_scene(empty_scene(), "Working", RenderSettings((8, 6), samples=1)),
    ):
        pass


def test_working_scenes_are_gone_after_an_error():
    scene = room_with_a_virtual_sphere()
    with pytest.raises(RuntimeError, match="on purpose"), open_scanner(scene, SMALL):
        raise RuntimeError("on purpose")
    assert [s.name for s in bpy.data.scenes] == [scene.name]


def test_what_the_users_own_renders_show_otherwise_does_not_reach_the_phone():
    """An override of materials; what is culled because it is far away or out of view; text burnt in, no view layer."""
    scene = room_with_a_virtual_sphere()
    box(scene, "Behind the phone", (-1.9, -1.9, 1.6), (0.05, 0.05, 1.0), material("Glow", emission=20.0))
    plain = captured(scene)
    scene.view_layers[0].material_override = material("Clay", (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(captured(scene).srgb_u8, plain.srgb_u8)
    scene.render.use_simplify = scene.cycles.use_camera_cull = scene.cycles.use_distance_cull = True
    scene.cycles.camera_cull_margin, scene.cycles.distance_cull_margin = 0.0, 0.1
    for item in scene.objects:
        item.cycles.use_camera_cull = item.cycles.use_distance_cull = True
    np.testing.assert_array_equal(captured(scene).srgb_u8, plain.srgb_u8)
    scene.render.use_stamp = scene.render.use_stamp_date = scene.render.use_stamp_note = True
    scene.render.stamp_font_size, scene.render.stamp_background = 30, (1, 0, 0, 1)
    scene.view_layers[0].use = False
    frame = captured(scene)
    np.testing.assert_array_equal(frame.srgb_u8, plain.srgb_u8)
    np.testing.assert_array_equal(frame.plane_depth_m, plain.plane_depth_m)
    assert scene.render.use_stamp and not scene.view_layers[0].use


@pytest.mark.slow
def test_memory_stays_flat_over_300_captures():
    scene = room_with_a_virtual_sphere(n_frames=8)
    page = os.sysconf("SC_PAGE_SIZE")
    resident = []
    with open_scanner(scene, RenderSettings((32, 24), samples=1, denoise=False)) as scanner:
        for k in range(301):
            scanner.move_to(1 + k % 8)
            scanner.acquire_environment_scan()
            if k % 100 == 0:
                resident.append(int(Path("/proc/self/statm").read_text().split()[1]) * page / 1e6)
    # The first hundred fill caches; after that a leak of one small picture per capture would be 1.8 MB.
    assert resident[3] - resident[1] < 1.0


def test_a_memory_folder_without_room_for_a_picture_is_not_needed(monkeypatch, tmp_path):
    save = render._save_render

    def cut_short_in_memory(scene, path):
        save(scene, path)
        if tmp_path in path.parents:
            os.truncate(path, path.stat().st_size // 2)

    scene = furnished()
    whole = captured(scene)
    monkeypatch.setattr(render, "MEMORY_FOLDER", tmp_path)
    monkeypatch.setattr(render, "_save_render", cut_short_in_memory)
    np.testing.assert_array_equal(captured(scene).plane_depth_m, whole.plane_depth_m)


def test_a_render_leaves_no_line_on_the_terminal_about_a_file_of_ours(capfd):
    captured(room_with_a_virtual_sphere())
    # What C has printed may be waiting.
    ctypes.CDLL(None).fflush(None)
    assert "passes.exr" not in capfd.readouterr().out


@pytest.mark.slow
@pytest.mark.wheel_only("a process of its own, since a crash would end this one, is made of the wheel's Python")
def test_another_thread_may_run_python_while_blender_renders():
    script = """
import os, threading, time, bpy
from xihe_blender.capture.render import RenderSettings, render_scene, working_scene
def wake():
    while True:
        time.sleep(1e-4)
threading.Thread(target=wake, daemon=True).start()
with working_scene(bpy.context.scene, "copy", RenderSettings((16, 16), samples=1, denoise=False)) as scene:
    for _ in range(1500):
        render_scene(scene)
os._exit(0)  # The wheel does not end beside a thread.
"""
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, timeout=100)
    assert done.returncode == 0, done.stderr[-2000:]


def test_a_render_is_of_the_scenes_own_frame_and_leaves_the_users():
    user = room_with_a_virtual_sphere(n_frames=8)
    user.frame_set(2)
    with working_scene(user, "copy", RenderSettings((16, 16), samples=1, denoise=False)) as scene:
        scene.frame_set(7)
        render_scene(scene)
        assert (scene.frame_current, user.frame_current, bpy.context.scene) == (7, 2, user)
