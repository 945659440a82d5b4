"""The user's scene is as it was: after a run, an error in its middle, a stop, and after everything is removed."""

import contextlib
import os
import signal
from dataclasses import replace

import bpy
import pytest
from previs_runs import SMALL, run, run_some_steps, walk
from scene_snapshot import data_blocks, differences, snapshot
from tiny_scenes import box, key

from xihe_blender.apply.sh_worlds import remove_applied_light
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.previs import previs
from xihe_blender.scene.state import scene_kept

SHORT = replace(SMALL, samples=2, frames=(1, 4))


def lived_in_scene():
    """`walk` as somebody works on it: settings that differ from a run's, unkeyed edits, two scenes, selections."""
    scene = walk()
    bpy.data.scenes.new("Another")
    hidden = bpy.data.collections.new("Hidden")
    scene.collection.children.link(hidden)
    box(scene, "Put Aside", (1, 1, 0.2), (0.3, 0.3, 0.3), collection=hidden).hide_render = True
    scene.view_layers.new("Second").layer_collection.children["Hidden"].exclude = True
    scene.view_layers[0].layer_collection.children["Hidden"].holdout = True
    render, cycles = scene.render, scene.cycles
    render.resolution_percentage, render.use_border, render.border_max_x = 37, True, 0.6
    render.filepath, render.film_transparent, render.use_motion_blur = "//kept_", True, True
    render.image_settings.file_format, render.image_settings.color_depth = "PNG", "16"
    cycles.samples, cycles.seed, cycles.use_adaptive_sampling = 77, 5, True
    scene.view_settings.view_transform, scene.view_settings.exposure = "AgX", 0.5
    scene.timeline_markers.new("Mine", frame=2)
    scene["note"] = "of the user's"
    _move_without_keys(scene)
    return scene


def _move_without_keys(scene):
    """Edits that are nowhere but in the open file: of keyed, driven and plain properties."""
    table = bpy.data.objects["Table"]
    table["height"] = 0.5
    table.keyframe_insert('["height"]', frame=1)
    table.driver_add("location", 2).driver.expression = "0.5 + 0.01 * frame"
    scene.frame_set(2, subframe=0.25)
    scene.camera.location.x += 0.37
    table["height"] = 0.8
    table.rotation_euler.z = 0.2
    bpy.data.materials["Light"].node_tree.nodes["Emission"].inputs["Strength"].default_value = 3.25
    bpy.data.objects["Lamp"].select_set(True)
    bpy.context.view_layer.objects.active = table
    bpy.context.view_layer.update()


def assert_kept(before):
    assert differences(before, snapshot()) == ({}, [])
    # What rendering leaves to be evaluated later must not change it either.
    bpy.context.view_layer.update()
    assert differences(before, snapshot()) == ({}, [])


def test_the_snapshot_sees_what_a_render_does_to_edits_without_a_key():
    scene = lived_in_scene()
    before = snapshot()
    with working_scene(scene, "Xihe Test", RenderSettings((8, 6), samples=1)) as working:
        working.frame_set(4)
        render_passes(working)
    changed, new = differences(before, snapshot())
    assert "objects/Phone/location" in changed and new == ["images/Render Result"]


def test_the_snapshot_sees_lamps():
    scene = walk(1)
    for kind in ("POINT", "SUN", "SPOT", "AREA"):
        scene.collection.objects.link(bpy.data.objects.new(kind, bpy.data.lights.new(kind, kind)))
    before = snapshot()
    assert differences(before, snapshot()) == ({}, [])
    for lamp in bpy.data.lights:
        lamp.energy = 7
    assert set(differences(before, snapshot())[0]) == {f"lights/{lamp.name}/energy" for lamp in bpy.data.lights}


def test_the_scene_is_as_it_was_after_runs_and_after_what_they_added_is_removed(tmp_path):
    scene = lived_in_scene()
    before = snapshot()
    run(scene, tmp_path / "first")
    assert_kept(before)
    once = data_blocks(snapshot())
    assert once >= {"worlds/Xihe Ball", "worlds/Xihe Board", "node_groups/Xihe SH Radiance"}
    run(scene, tmp_path / "second", SHORT)
    assert data_blocks(snapshot()) == once
    remove_applied_light(scene)
    assert data_blocks(snapshot()) == data_blocks(before)
    assert_kept(before)
    assert [marker.name for marker in scene.timeline_markers] == ["Mine"]


@pytest.mark.parametrize("n_steps", [2, 4, 7])
def test_the_scene_is_as_it_was_after_a_stop(tmp_path, n_steps):
    scene = lived_in_scene()
    before = snapshot()
    assert not run_some_steps(scene, tmp_path / "out", n_steps, SHORT)
    assert_kept(before)


@pytest.mark.parametrize("place", ["radiance", "pictures", "untitled_lit.blend"])
def test_the_scene_is_as_it_was_after_an_error(tmp_path, place):
    scene = lived_in_scene()
    before = snapshot()
    run_some_steps(scene, tmp_path, 2, SHORT)
    in_the_way = tmp_path / place
    # A folder where a file belongs, or the other way round: neither can be written.
    in_the_way.mkdir() if in_the_way.suffix else in_the_way.write_text("in the way")
    with pytest.raises(OSError, match=in_the_way.name):
        run(scene, tmp_path, SHORT)
    assert_kept(before)
    assert not (tmp_path / "results.json").exists()


def test_the_scene_is_as_it_was_after_ctrl_c(tmp_path):
    scene = lived_in_scene()
    before = snapshot()

    def press(progress, _elapsed_s):
        if progress.doing == "capturing frame 4":
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run_blocking(previs(scene, tmp_path / "out", SHORT), press)
    assert_kept(before)
    assert not (tmp_path / "out" / "results.json").exists()


# ------------------------------------------------------------------------------------------- what is put back, by kind


@contextlib.contextmanager
def rendered_within(scene, frame):
    """Render `frame` inside `scene_kept`, then run the block."""
    with scene_kept(), working_scene(scene, "Xihe Test", RenderSettings((8, 6), samples=1)) as working:
        working.frame_set(frame)
        render_passes(working)
    yield


def test_an_edited_shape_key_is_put_back():
    scene = walk()
    table = bpy.data.objects["Table"]
    table.shape_key_add(name="Basis")
    keys = table.shape_key_add(name='Bent "up"').id_data
    key(keys.key_blocks[1], "value", {1: 0.0, 5: 1.0})
    keys.key_blocks[1].value = 0.3
    with rendered_within(scene, 5):
        assert keys.key_blocks[1].value == pytest.approx(0.3)


def test_an_edit_under_an_nla_strip_is_put_back():
    scene = walk()
    table = bpy.data.objects["Table"]
    key(table, "location", {1: (0, 0, 0.7), 5: (0, 0, 0.9)})
    animation = table.animation_data
    animation.nla_tracks.new().strips.new("Rise", 1, animation.action)
    animation.action = None
    table.location = (0.1, 0.2, 0.3)
    with rendered_within(scene, 5):
        assert tuple(table.location) == pytest.approx((0.1, 0.2, 0.3))


def test_an_edited_custom_property_is_put_back():
    scene = walk()
    table = bpy.data.objects["Table"]
    for frame, value in ((1, 0.0), (5, 1.0)):
        table["my.own"] = value
        table.keyframe_insert('["my.own"]', frame=frame)
    table["my.own"] = 0.4
    with rendered_within(scene, 5):
        assert table["my.own"] == pytest.approx(0.4)


def test_a_path_that_leads_nowhere_is_left_alone():
    scene = walk()
    table = bpy.data.objects["Table"]
    modifier = table.modifiers.new("Bevel", "BEVEL")
    key(modifier, "width", {1: 0.01, 5: 0.02})
    table.modifiers.remove(modifier)
    with rendered_within(scene, 5):
        assert not table.modifiers


def test_a_render_result_that_was_there_stays():
    scene = walk()
    with working_scene(scene, "Xihe Test", RenderSettings((8, 6), samples=1)) as working:
        render_passes(working)
    with rendered_within(scene, 2):
        assert [image.type for image in bpy.data.images] == ["RENDER_RESULT"]
