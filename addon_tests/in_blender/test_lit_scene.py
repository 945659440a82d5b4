"""The scene `Xihe Lit` in the open file: it plays, it renders what the run's pictures show, and it goes again."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from addon_runs import poll_message, registered_addon
from mathutils import Matrix
from previs_runs import LOOKS_AWAY, N_FRAMES, SMALL, run, walk
from scene_snapshot import data_blocks, snapshot

from xihe_blender.addon.results_in_blender import remove_everything, show_lit
from xihe_blender.apply.datablocks import LIT_SCENE, has_anything, lit_scene
from xihe_blender.errors import UserError
from xihe_blender.io.run_results import read_results

SETTINGS = replace(SMALL, estimator="projection", samples=64)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Where a run is, and the scene before and after."""
    out = tmp_path_factory.mktemp("lit") / "out"
    scene = walk()
    bpy.context.view_layer.update()
    before = snapshot()
    run(scene, out, SETTINGS)
    bpy.ops.wm.save_as_mainfile(filepath=str(out / "after.blend"))
    return out, before


@pytest.fixture
def shown(ran):
    """The lit scene of the run, its file open."""
    bpy.ops.wm.open_mainfile(filepath=str(ran[0] / "after.blend"), load_ui=False)
    return show_lit(bpy.context.scene, read_results(ran[0]), ran[0], "Board")


def picture_of(path):
    image = bpy.data.images.load(str(path))
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    shape = image.size[1], image.size[0], -1
    bpy.data.images.remove(image)
    return pixels.reshape(shape)[::-1]


def test_rendering_it_gives_the_picture_of_the_estimate(ran, shown, tmp_path):
    results = read_results(ran[0])
    frame, compared = next(iter(results.compared_frames.items()))
    estimate, captured = (picture_of(ran[0] / compared.pictures[kind])[..., :3] for kind in ("projection", "captured"))
    assert (shown.render.resolution_x, shown.render.resolution_y) == (64, 48)
    shown.render.resolution_x, shown.render.resolution_y = results.settings.size
    shown.cycles.samples, shown.render.filepath = 64, str(tmp_path / "lit.png")
    shown.render.image_settings.file_format = "PNG"
    shown.frame_set(frame)
    bpy.ops.render.render(write_still=True, scene=shown.name)
    lit = picture_of(tmp_path / "lit.png")[..., :3]
    is_object = np.abs(estimate - captured).max(axis=-1) > 0.02
    assert 10 < is_object.sum() < is_object.size / 2
    np.testing.assert_allclose(lit[is_object].mean(axis=0), estimate[is_object].mean(axis=0), rtol=0.03)
    np.testing.assert_allclose(lit[~is_object].mean(axis=0), captured[~is_object].mean(axis=0), atol=0.01)


def test_a_larger_picture_is_opaque_and_as_bright_along_its_rim_as_inside(shown, tmp_path):
    shown.cycles.samples, shown.render.filepath = 1, str(tmp_path / "lit.png")
    shown.render.image_settings.file_format, shown.render.image_settings.color_mode = "PNG", "RGBA"
    bpy.ops.render.render(write_still=True, scene=shown.name)
    lit = picture_of(tmp_path / "lit.png")
    assert lit.shape == (48, 64, 4) and (lit[..., 3] == 1).all()
    for rim, inside in ((lit[0], lit[1]), (lit[-1], lit[-2]), (lit[:, 0], lit[:, 1]), (lit[:, -1], lit[:, -2])):
        np.testing.assert_allclose(rim.mean(axis=0), inside.mean(axis=0), rtol=0.1)


def test_each_frame_has_what_the_phone_saw_last(ran, shown):
    phone = shown.camera.data
    behind = phone.background_images[0]
    assert phone.show_background_images and behind.image.source == "SEQUENCE"
    assert (behind.image_user.frame_start, behind.image_user.frame_duration) == (1, N_FRAMES)
    files = sorted((ran[0] / "lit").iterdir())
    assert [file.name for file in files] == [f"frame_{i:04d}.png" for i in range(1, N_FRAMES + 1)]
    assert files[LOOKS_AWAY - 1].read_bytes() == files[LOOKS_AWAY - 2].read_bytes() != files[LOOKS_AWAY].read_bytes()


def test_its_worlds_are_keyed_and_its_camera_is_a_copy(shown):
    assert shown.world.name == "Xihe Board" and shown.world.node_tree.animation_data.action is not None
    assert {layer.world_override.name for layer in shown.view_layers} == {"Xihe Ball", "Xihe Board"}
    room = bpy.data.scenes["Scene"]
    assert shown.camera != room.camera and not room.camera.data.background_images
    for frame in (1, N_FRAMES):
        room.frame_set(frame)
        shown.frame_set(frame)
        depsgraphs = [(scene.camera, scene.view_layers[0].depsgraph) for scene in (room, shown)]
        placed = [camera.evaluated_get(depsgraph).matrix_world for camera, depsgraph in depsgraphs]
        assert placed[0] == placed[1] != Matrix()


def test_it_is_saved_with_the_file_and_shown_again_in_place_of_itself(ran, shown, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"), load_ui=False)
    assert lit_scene().name == LIT_SCENE and len(lit_scene().view_layers) == 2
    show_lit(bpy.data.scenes["Scene"], read_results(ran[0]), ran[0])
    assert sorted(scene.name for scene in bpy.data.scenes) == ["Scene", LIT_SCENE]
    assert len([image for image in bpy.data.images if image.name.startswith(LIT_SCENE)]) == 1


@pytest.mark.parametrize("asked_from_the_lit_scene", [True, False])
def test_removing_the_light_takes_it_away(ran, shown, asked_from_the_lit_scene):
    assert has_anything(shown)
    remove_everything(shown if asked_from_the_lit_scene else bpy.data.scenes["Scene"])
    bpy.context.view_layer.update()
    assert data_blocks(snapshot()) == data_blocks(ran[1])


def test_pictures_that_are_gone_are_named(ran, tmp_path):
    bpy.ops.wm.open_mainfile(filepath=str(ran[0] / "after.blend"), load_ui=False)
    with pytest.raises(UserError, match=r"captured_0001\.png is gone: run again"):
        show_lit(bpy.context.scene, read_results(ran[0]), tmp_path)
    assert lit_scene() is None


def test_the_buttons_go_there_and_back(ran):
    with registered_addon():
        bpy.ops.wm.open_mainfile(filepath=str(ran[0] / "after.blend"), load_ui=False)
        bpy.context.scene.xihe.run_folder = str(ran[0])
        assert "This is the room" in poll_message(bpy.ops.xihe.show_room)
        assert bpy.ops.xihe.show_lit() == {"FINISHED"}
        if bpy.context.window is not None:
            assert bpy.context.scene == lit_scene()
            assert "go back to the room" in poll_message(bpy.ops.xihe.run)
            assert bpy.ops.xihe.show_room() == {"FINISHED"}
        assert bpy.context.scene.name == "Scene"
