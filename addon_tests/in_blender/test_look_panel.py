"""Look Where? in the panel: the advice of the last run's frames, the camera that does it, and that both go again."""

import json

import bpy
import pytest
from previs_runs import counted_renders
from tiny_scenes import opened

from xihe_blender.addon.look_operators import advice_for, other_cameras
from xihe_blender.apply.datablocks import BETTER_PATH, better_path_camera
from xihe_blender.io.json_records import from_json
from xihe_blender.io.look_results import LookAway
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.better_path import looks_of_run
from xihe_blender.scene.estimation_positions import named_positions


@pytest.fixture
def scene(lit_run):
    return opened(lit_run / "after.blend")


def test_the_panel_says_what_the_function_says_without_a_render(scene, lit_run):
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    with counted_renders() as renders:
        assert bpy.ops.xihe.look_where() == {"FINISHED"}
    places = list(named_positions(bpy.data.objects["Ball"], bpy.context.evaluated_depsgraph_get()).values())
    (advice,) = run_blocking(looks_of_run(lit_run, {"Ball": places}))
    (row,) = advice_for(bpy.context)
    assert renders == [] and row.sentence == advice.sentence
    assert from_json(LookAway, json.loads(row.look)) == advice.look


def test_what_it_says_of_several_objects_is_no_longer_than_blenders_status_bar(scene, capfd):
    bpy.context.view_layer.objects.active = None
    bpy.ops.xihe.look_where()
    said = f"Info: The panel says where to look for {len(advice_for(bpy.context))} objects"
    assert said in capfd.readouterr().out.splitlines()


def test_asking_again_replaces_the_advice_and_another_file_forgets_it(scene, lit_run):
    for _ in range(2):
        bpy.ops.xihe.look_where()
    names = [row.name for row in advice_for(bpy.context)]
    assert "Ball" in names and len(names) == len(set(names)) == len(bpy.context.window_manager.xihe.looks)
    scene.xihe.run_folder = str(lit_run / "another")
    assert advice_for(bpy.context) == []
    bpy.ops.wm.open_mainfile(filepath=str(lit_run / "after.blend"), load_ui=False)
    assert len(bpy.context.window_manager.xihe.looks) == 0


def test_the_camera_comes_after_the_advice_and_goes_with_the_light(scene):
    assert not bpy.ops.xihe.add_better_camera.poll()
    bpy.ops.xihe.look_where()
    own = scene.camera
    assert bpy.ops.xihe.add_better_camera() == {"FINISHED"}
    assert better_path_camera().name == BETTER_PATH and scene.camera == own
    scene.camera = better_path_camera()
    cut = scene.timeline_markers.new("cut", frame=2)
    for cut.camera in (None, better_path_camera(), own):
        assert other_cameras(bpy.context) == (cut.camera == own)
    assert bpy.ops.xihe.remove_light() == {"FINISHED"}
    assert scene.camera == own and not other_cameras(bpy.context)
    assert better_path_camera() is None and BETTER_PATH not in bpy.data.cameras and BETTER_PATH not in bpy.data.actions
