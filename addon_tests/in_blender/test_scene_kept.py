"""The user's scene is as it was: after a run, an error in its middle, a stop, and after everything is removed."""

from dataclasses import replace

import bpy
import pytest
from addon_runs import registered_addon
from previs_runs import SMALL, run, run_some_steps, walk, with_renders_of
from scene_snapshot import data_blocks, differences, nothing_changes, snapshot
from tiny_scenes import add_lamp, box, empty_scene, key, light_strength, phone

from xihe_blender.addon.modal_job import ModalJob, RunUnderWay
from xihe_blender.addon.results_in_blender import remove_everything
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.jobs import Progress, run_blocking
from xihe_blender.scene.state import animated_paths, look_through_own_cameras, scene_kept

SHORT = replace(SMALL, samples=2, frames=(1, 4))


def lived_in_scene():
    """`walk` as somebody works on it: settings that differ from a run's, unkeyed edits, two scenes, selections."""
    scene = walk()
    bpy.data.scenes.new("Another")
    bpy.data.images.new("Painted", 4, 4)
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
    table, lamp = bpy.data.objects["Table"], bpy.data.objects["Lamp"]
    for frame in (1, 5):
        table["my.height"] = 0.1 * frame
        table.keyframe_insert('["my.height"]', frame=frame)
    table.driver_add("location", 2).driver.expression = "0.5 + 0.01 * frame"
    table.shape_key_add(name="Basis")
    shape = table.shape_key_add(name='Bent "up"')
    key(shape, "value", {1: 0.0, 5: 1.0})
    _strip(lamp, "location", {1: (1.9, 0, 1.6), 5: (1.9, 0, 1.8)})
    _key_that_leads_nowhere(lamp)
    scene.frame_set(2, subframe=0.25)
    scene.camera.location.x += 0.37
    table["my.height"], shape.value, lamp.location = 0.8, 0.3, (1.8, 0.2, 1.7)
    table.rotation_euler.z = 0.2
    light_strength().default_value = 3.25
    lamp.select_set(True)
    bpy.context.view_layer.objects.active = table
    bpy.context.view_layer.update()


def _strip(item, name, value_by_frame):
    """Keys as a strip of the NLA."""
    key(item, name, value_by_frame)
    animation = item.animation_data
    animation.nla_tracks.new().strips.new("Strip", 1, animation.action)
    animation.action = None


def _key_that_leads_nowhere(item):
    modifier = item.modifiers.new("Bevel", "BEVEL")
    key(modifier, "width", {1: 0.01, 5: 0.02})
    item.modifiers.remove(modifier)


def assert_kept(before):
    assert differences(before, snapshot()) == ({}, [])
    # What rendering leaves to be evaluated later must not change it either.
    bpy.context.view_layer.update()
    assert differences(before, snapshot()) == ({}, [])


def render_tiny(scene, frame):
    with working_scene(scene, "Xihe Test", RenderSettings((8, 6), samples=1)) as working:
        working.frame_set(frame)
        render_passes(working)


def test_the_snapshot_sees_what_a_render_does_to_edits_without_a_key():
    scene = lived_in_scene()
    before = snapshot()
    render_tiny(scene, 4)
    changed, new = differences(before, snapshot())
    edited = {"objects/Phone/location", "objects/Lamp/location", "objects/Table/[my.height]"}
    assert {*edited, "shape_keys/Key/key_blocks/1/value"} <= set(changed) and new == ["images/Render Result"]


def test_the_snapshot_sees_lamps():
    scene = walk(1)
    for kind in ("POINT", "SUN", "SPOT", "AREA"):
        add_lamp(scene, kind)
    before = snapshot()
    assert differences(before, snapshot()) == ({}, [])
    for lamp in bpy.data.lights:
        lamp.energy = 7
    assert set(differences(before, snapshot())[0]) == {f"lights/{lamp.name}/energy" for lamp in bpy.data.lights}


def test_edits_without_a_key_are_put_back_after_a_render():
    scene = lived_in_scene()
    before = snapshot()
    with scene_kept():
        render_tiny(scene, 5)
    assert_kept(before)


def test_keys_of_the_users_settings_leave_a_working_scene_alone():
    scene = lived_in_scene()
    scene["height"] = 0.0
    for frame, (samples, height) in {1: (77, 1.0), 5: (7, 5.0)}.items():
        scene.cycles.samples, scene["height"] = samples, height
        for path in ("cycles.samples", '["height"]'):
            scene.keyframe_insert(path, frame=frame)
    scene.driver_add("view_settings.exposure").driver.expression = "frame"
    with nothing_changes(), working_scene(scene, "Working", RenderSettings((8, 6), samples=3)) as working:
        working.view_settings.exposure = 0.25
        working.frame_set(4)
        rendered = working.view_layers[0].depsgraph.scene_eval
        assert (rendered.cycles.samples, rendered.view_settings.exposure) == (3, 0.25)
        assert rendered["height"] == pytest.approx(4.0, abs=0.5)


def put_into_another_strip(track):
    """Blender makes such strips in its editor alone."""
    track.select = track.strips[0].select = True
    (area, *_), window = bpy.context.window.screen.areas, bpy.context.window
    kind, area.type = area.type, "NLA_EDITOR"
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        bpy.ops.nla.meta_add()
    area.type = kind
    assert [strip.type for strip in track.strips] == ["META"]


@pytest.mark.parametrize("place", ["a strip", "a strip within another", "a strip that is being tweaked"])
def test_strips_of_the_nla_move_custom_properties_of_a_working_scene_alone(place):
    scene = empty_scene()
    scene["height"] = 0.0
    for frame, height in {1: 1.0, 5: 5.0}.items():
        scene.cycles.samples, scene["height"] = 10 * frame, height
        for path in ("cycles.samples", '["height"]'):
            scene.keyframe_insert(path, frame=frame)
    animation = scene.animation_data
    track = animation.nla_tracks.new()
    track.strips.new("Strip", 1, animation.action)
    animation.action = None
    if place == "a strip within another":
        put_into_another_strip(track)
    if place == "a strip that is being tweaked":
        track.select, animation.nla_tracks.active = True, track
        track.strips[0].select = animation.use_tweak_mode = True
        assert animation.action is not None
    assert animated_paths(scene) == {"cycles.samples", '["height"]'}
    with nothing_changes(), working_scene(scene, "Working", RenderSettings((8, 6), samples=3)) as working:
        working.frame_set(4)
        rendered = working.view_layers[0].depsgraph.scene_eval
        assert rendered.cycles.samples == 3 and rendered["height"] == pytest.approx(4.0, abs=0.5)


def test_a_render_result_that_was_there_stays():
    scene = walk(2)
    render_tiny(scene, 1)
    with scene_kept():
        render_tiny(scene, 2)
    assert [image.type for image in bpy.data.images] == ["RENDER_RESULT"]


def test_a_camera_that_a_marker_brings_at_the_rendered_frame_does_not_stay():
    scene = walk(4)
    usual, other = scene.camera, phone(scene, (0, -1, 1), (0, 0, 1), "Other")
    for frame, camera in ((1, usual), (3, other)):
        scene.timeline_markers.new("switch", frame=frame).camera = camera
    scene.frame_set(1)
    with scene_kept():
        render_tiny(scene, 4)
    assert scene.camera == usual


def test_views_look_through_their_scenes_camera_though_a_copy_has_come_to_a_marker_with_another():
    scene = walk(4)
    usual, other = scene.camera, phone(scene, (0, -1, 1), (0, 0, 1), "Other")
    for frame, camera in ((1, usual), (3, other)):
        scene.timeline_markers.new("switch", frame=frame).camera = camera
    scene.frame_set(1)
    usual.location.x += 0.37
    (view,) = (area.spaces.active for area in bpy.context.window.screen.areas if area.type == "VIEW_3D")
    assert view.camera == usual

    def job():
        with working_scene(scene, "Working", RenderSettings((8, 6), samples=1)) as working:
            working.frame_set(4)
            assert working.camera == other
            yield Progress(0, 1, "rendering")

    with nothing_changes():
        run_blocking(job())
    assert view.camera == usual
    with registered_addon():
        run = RunUnderWay(bpy.context, job())
        run.step()
        assert view.camera == usual and not run.is_over
        run.end()


def test_a_job_ends_with_the_add_on_and_is_not_under_way_when_that_comes_back():
    def job():
        yield Progress(0, 1, "rendering")

    with registered_addon():
        run = RunUnderWay(bpy.context, job())
        run.step()
        assert bpy.context.window_manager.xihe.is_running
    with registered_addon():
        assert run.is_over and not bpy.context.window_manager.xihe.is_running


def test_a_job_ends_where_ctrl_c_meets_a_script_that_waits_for_it(monkeypatch):
    def interrupted(_seconds):
        raise KeyboardInterrupt

    def job():
        yield Progress(0, 1, "rendering")

    waiting = ModalJob()
    waiting.start_job = lambda _context: job()
    monkeypatch.setattr("time.sleep", interrupted)
    with registered_addon():
        with pytest.raises(KeyboardInterrupt):
            waiting.execute(bpy.context)
        assert not bpy.context.window_manager.xihe.is_running


def test_a_view_in_local_view_keeps_its_camera_and_a_job_under_way_does_not_redraw_it_for_that():
    scene, window = walk(4), bpy.context.window
    (area,) = (area for area in window.screen.areas if area.type == "VIEW_3D")
    (region,) = (region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        scene.objects[0].select_set(True)
        assert bpy.ops.view3d.localview() == {"FINISHED"}
        scene.camera = phone(scene, (0, -1, 1), (0, 0, 1), "Other")
        window.view_layer.update()
        assert area.spaces.active.camera != scene.camera
        updates, noted = [], lambda scene, _: updates.append(scene)
        bpy.app.handlers.depsgraph_update_post.append(noted)
        look_through_own_cameras()
        window.view_layer.update()
        bpy.app.handlers.depsgraph_update_post.remove(noted)
        bpy.ops.view3d.localview()
    assert not updates


@pytest.mark.slow
def test_the_scene_is_as_it_was_after_runs_and_after_what_they_added_is_removed(tmp_path):
    scene = lived_in_scene()
    before = snapshot()
    settings = replace(SMALL, frames=SHORT.frames)
    run(scene, tmp_path / "first", settings)
    assert_kept(before)
    once = data_blocks(snapshot())
    assert once >= {"worlds/Xihe Ball", "worlds/Xihe Board", "node_groups/Xihe SH Radiance"}
    run(scene, with_renders_of(tmp_path / "first", tmp_path / "second"), replace(settings, estimator="projection"))
    assert data_blocks(snapshot()) == once
    remove_everything()
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
    one_frame = replace(SHORT, frames=(1,))
    run_some_steps(scene, tmp_path, 2, one_frame)
    in_the_way = tmp_path / place
    # A folder where a file belongs, or the other way round: neither can be written.
    in_the_way.mkdir() if in_the_way.suffix else in_the_way.write_text("in the way")
    with pytest.raises(OSError, match=in_the_way.name):
        run(scene, tmp_path, one_frame)
    assert_kept(before)
    assert not (tmp_path / "results.json").exists()
