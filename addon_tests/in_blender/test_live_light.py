"""Live light: an object that is moved or added after a run gets the light of its new place, without a render."""

import json
import shutil
from types import SimpleNamespace
from unittest.mock import MagicMock

import bpy
import numpy as np
import pytest
from previs_runs import counted_renders
from shown_lights import keyed
from tiny_scenes import empty_scene, key, opened, saved, sphere

from xihe_blender.addon import live_light, panels
from xihe_blender.addon.results_in_blender import apply_results
from xihe_blender.apply.applied_lights import lights_of_scene
from xihe_blender.apply.datablocks import COMPARISON_NAME, FRAME, LightOf, image_named, lit_scene, moved_positions
from xihe_blender.apply.keys import f_curves
from xihe_blender.apply.lit_scene import ROOM_COPY, keep_added
from xihe_blender.cli.main import main
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_lights import LightsAsked, lights_asked
from xihe_blender.io.run_results import read_results
from xihe_blender.jobs import run_blocking
from xihe_blender.previs import kept_session
from xihe_blender.previs.better_path import looks_of_run
from xihe_blender.previs.kept_session import open_kept_session
from xihe_blender.scene.blend_file import ROOM, open_blend
from xihe_blender.scene.estimation_positions import named_positions
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.light.key_light import rest_of
from xihenet.panorama import evaluate_panorama


@pytest.fixture
def scene(lit_run):
    return opened(lit_run / "after.blend")


def misplaced(scene):
    return live_light.misplaced(scene, bpy.context.evaluated_depsgraph_get())


def curves(world):
    return {curve.data_path: [tuple(point.co) for point in curve.keyframe_points] for curve in f_curves(world)}


def test_nothing_happens_while_objects_are_where_the_run_saw_them(scene):
    before = keyed(bpy.data.worlds["Xihe Ball"])[0]
    assert misplaced(scene) == {}
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert all(np.array_equal(light, before[frame]) for frame, light in keyed(bpy.data.worlds["Xihe Ball"])[0].items())


def test_an_object_is_moved_by_a_centimetre_and_not_by_what_versions_of_blender_differ_in(scene):
    for nudge, moved in ((0.001, set()), (0.009, {"Ball"}), (-0.009, set())):
        bpy.data.objects["Ball"].location.x += nudge
        bpy.context.view_layer.update()
        assert misplaced(scene).keys() == moved


def test_the_points_of_a_long_path_are_not_kept_and_light_and_advice_are_the_same(scene, lit_run, monkeypatch):
    """They are three quarters of the memory, which for 2,000 frames is 3 GB."""
    place, found, advice = named_positions(bpy.data.objects["Ball"]), [], []
    for most in (kept_session.MOST_POINTS, 0):
        monkeypatch.setattr(kept_session, "MOST_POINTS", most)
        session = run_blocking(open_kept_session(lit_run))
        assert {one.points is None for one in session.frames} == {most == 0}
        found.append(run_blocking(session.find_light(place))["Ball"])
        advice.append(run_blocking(looks_of_run(lit_run, {"Ball": list(place.values())})))
    assert advice[0] == advice[1]
    assert found[0].coverage == found[1].coverage
    assert {frame: sh.tolist() for frame, sh in found[0].sh.items()} == {
        f: sh.tolist() for f, sh in found[1].sh.items()
    }


def test_an_object_that_is_moved_has_the_light_of_its_place_without_a_render(scene, lit_run):
    ball, world = bpy.data.objects["Ball"], bpy.data.worlds["Xihe Ball"]
    ball.location.x += 0.4
    bpy.context.view_layer.update()
    other = keyed(bpy.data.worlds["Xihe Board"])[0]
    with counted_renders() as renders:
        assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert renders == []
    place = named_positions(ball)
    found = run_blocking(run_blocking(open_kept_session(lit_run)).find_light(place))["Ball"]
    lights = keyed(world)[0]
    for frame, light in found.lights.items():
        in_use = lights[max(known for known in lights if known <= frame)]
        np.testing.assert_allclose(in_use, rest_of(light), atol=1e-6)
    last = max(found.sh)
    assert LightOf.read(world).live == {"Ball": [found.coverage[last], found.expected_error[last]]}
    # Its error there is not known, since the reference light is of the old place.
    assert curves(world).keys() == {'["Xihe coverage"]', '["Xihe expected error"]'}
    assert curves(world)['["Xihe coverage"]'] == [
        (frame, pytest.approx(share)) for frame, share in found.coverage.items()
    ]
    assert all(np.array_equal(light, other[k]) for k, light in keyed(bpy.data.worlds["Xihe Board"])[0].items())


def test_where_to_look_is_forgotten_for_what_was_moved_and_for_nothing_else(scene):
    looks = bpy.context.window_manager.xihe.looks
    for name in ("Ball", "Board"):
        looks.add().name = name
    bpy.data.objects["Ball"].location.x += 0.4
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert [row.name for row in looks] == ["Board"]
    looks.clear()


def test_the_panel_tells_of_what_was_moved_until_it_is_renamed_or_deleted(scene):
    for name in ("Ball", "Board"):
        bpy.data.objects[name].location.x += 0.4
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert moved_positions(scene).keys() == {"Ball", "Board 1", "Board 2"}
    bpy.data.objects["Ball"].name = "Globe"
    assert moved_positions(scene).keys() == {"Board 1", "Board 2"}
    bpy.data.objects.remove(bpy.data.objects["Board"])
    assert moved_positions(scene) == {}


def test_an_object_that_is_put_back_has_the_light_and_the_errors_of_the_run_again(scene):
    ball, world = bpy.data.objects["Ball"], bpy.data.worlds["Xihe Ball"]
    lights, shown = keyed(world)[0], curves(world)
    for offset in (0.4, -0.4):
        ball.location.x += offset
        bpy.context.view_layer.update()
        assert bpy.ops.xihe.update_light() == {"FINISHED"}
    assert curves(world) == shown and not LightOf.read(world).live
    again = keyed(world)[0]
    for frame, light in lights.items():
        np.testing.assert_allclose(again[max(known for known in again if known <= frame)], light, atol=1e-6)
    assert bpy.ops.xihe.remove_light() == {"FINISHED"}
    assert [action.name for action in bpy.data.actions if action.name.startswith("Xihe")] == []


def test_an_object_that_is_added_is_lit_and_removed_with_the_rest(scene, lit_run):
    sphere(scene, "New", (0.3, 0.6, 1.2), 0.1, None, virtual_collection(scene))
    bpy.context.view_layer.update()
    assert misplaced(scene).keys() == {"New"}
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    light = np.array(list(keyed(bpy.data.worlds["Xihe New"])[0].values()))
    assert light[-1, 0].min() > 0.01
    assert bpy.ops.xihe.remove_light() == {"FINISHED"}
    blocks = (bpy.data.worlds, bpy.data.images, bpy.data.actions, bpy.data.node_groups)
    assert [block.name for kind in blocks for block in kind if block.name.startswith("Xihe")] == []


def test_an_object_that_becomes_virtual_is_lit_though_nothing_moves(scene, monkeypatch):
    monkeypatch.setattr(live_light, "_task", None)
    monkeypatch.setattr(live_light, "_begin", lambda: None)
    added = sphere(scene, "New", (0.3, 0.6, 1.2), 0.1, None)
    bpy.context.view_layer.update()
    changed = bpy.app.handlers.depsgraph_update_post
    changed.append(live_light._scene_changed)
    try:
        virtual_collection(scene).objects.link(added)
        bpy.context.view_layer.update()
    finally:
        changed.remove(live_light._scene_changed)
    live_light._task.join()
    assert live_light._task.found.keys() == {"New"}


def test_an_object_that_was_added_is_in_the_lit_scene_at_once(scene):
    sphere(scene, "New", (0.3, 0.6, 1.2), 0.1, None, virtual_collection(scene))
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    shown = lit_scene()
    assert shown.view_layers["Xihe New"].world_override == bpy.data.worlds["Xihe New"]
    behind = [item for item in shown.objects if ROOM_COPY in item]
    assert behind and all(item.hide_select for item in behind), "a click on the picture selects nothing"


def test_an_object_that_was_duplicated_in_the_lit_scene_is_virtual_in_the_room(scene):
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    ball = bpy.data.objects["Ball"]
    again = ball.copy()
    next(home for home in ball.users_collection if home.name.startswith("Xihe Lit")).objects.link(again)
    again.location.x += 0.3
    board = bpy.data.objects["Board"]
    virtual_collection(scene).objects.unlink(board)  # As Blender's Delete does in the room.
    before = set(bpy.data.objects)
    assert keep_added() == [again] and keep_added() == []
    if bpy.context.window is not None:
        bpy.context.window.scene = scene
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    assert set(virtual_collection(scene).objects) == {ball, again}
    assert lit_scene().view_layers[f"Xihe {again.name}"].world_override == bpy.data.worlds[f"Xihe {again.name}"]
    assert bpy.ops.xihe.remove_light() == {"FINISHED"}
    assert again in set(scene.objects) and before >= set(scene.objects)


def test_an_object_that_moves_along_the_path_keeps_the_light_of_the_run(scene):
    ball = bpy.data.objects["Ball"]
    key(ball, "location", {1: (0, 0, 1), 5: (1, 0, 1)})
    bpy.context.view_layer.update()
    assert misplaced(scene) == {}


def test_a_moving_object_of_the_run_is_not_followed_even_once_it_stands(scene, lit_run):
    LightOf({"Ball": (0.0, 0.0, 0.0)}, moves=True).write(bpy.data.worlds["Xihe Ball"])
    assert misplaced(scene) == {}


def test_frames_that_are_gone_are_told_in_one_line_and_the_light_stays(scene, lit_run, tmp_path):
    shutil.copytree(lit_run, tmp_path, dirs_exist_ok=True)
    for frame in read_results(lit_run).captured_frames:
        RunOutputs(tmp_path).capture(frame.frame).unlink()
    scene.xihe.run_folder = str(tmp_path)
    bpy.data.objects["Ball"].location.x += 0.4
    bpy.context.view_layer.update()
    before = keyed(bpy.data.worlds["Xihe Ball"])[0]
    with pytest.raises(RuntimeError, match=r"The captures of the last run are gone or damaged .*: run again"):
        bpy.ops.xihe.update_light()
    assert keyed(bpy.data.worlds["Xihe Ball"])[0].keys() == before.keys()


def test_apply_brings_back_the_light_of_the_run(scene, lit_run):
    bpy.data.objects["Ball"].location.x += 0.4
    bpy.context.view_layer.update()
    bpy.ops.xihe.update_light()
    apply_results(scene, lit_run)
    assert not LightOf.read(bpy.data.worlds["Xihe Ball"]).live
    assert misplaced(scene).keys() == {"Ball"}


def test_a_render_begins_when_the_thread_that_finds_light_has_ended(scene, lit_run, monkeypatch):
    bpy.data.objects["Ball"].location.x += 0.4
    bpy.context.view_layer.update()
    task, alive = live_light.Task(lit_run, misplaced(scene)), []
    monkeypatch.setattr(live_light, "_task", task)
    handlers = bpy.app.handlers.render_init
    added = [live_light.HANDLERS["render_init"], lambda *_: alive.append(task.is_alive())]
    handlers.extend(added)
    try:
        task.start()
        bpy.ops.render.render()
    finally:
        for called in added:
            handlers.remove(called)
    assert alive == [False] and task.found.keys() == {"Ball"}


def test_export_light_has_moved_and_added_objects_also_from_the_lit_scene(scene, lit_run, tmp_path):
    folder = shutil.copytree(lit_run, tmp_path / "out")
    scene.xihe.run_folder = str(folder)
    bpy.data.objects["Ball"].location.x += 0.4
    sphere(scene, "New", (0.3, 0.6, 1.2), 0.1, None, virtual_collection(scene))
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.update_light() == bpy.ops.xihe.show_lit() == {"FINISHED"}
    written = []
    for shown in (scene, lit_scene()):
        with bpy.context.temp_override(scene=shown):
            assert bpy.ops.xihe.export_light(target="three") == {"FINISHED"}
        content = json.loads((folder / "exports" / "three" / "three.json").read_text())
        written.append({light["object"]: light["sh"] for light in content["lights"]})
    of_room, of_lit = written
    assert of_room == of_lit and of_room.keys() == {"Ball", "Board", "New"}
    at_run = lights_asked(read_results(folder), folder, LightsAsked(scene.frame_current, objects=("Ball",)))
    assert np.abs(np.reshape(of_lit["Ball"], (9, 3)) - at_run[0].light.sh).max() > 0.01


def test_export_light_without_an_engine_says_what_to_give(scene):
    with pytest.raises(RuntimeError, match=r"No engine is chosen: give target one of .*unity"):
        bpy.ops.xihe.export_light()


def test_in_the_lit_scene_the_panel_has_the_switch_of_the_room(scene, monkeypatch):
    assert bpy.ops.xihe.show_lit() == {"FINISHED"}
    monkeypatch.setattr(panels, "is_narrow", lambda _context: False)
    layout = MagicMock()
    with bpy.context.temp_override(scene=lit_scene()):
        panels.XIHE_PT_apply.draw(SimpleNamespace(layout=layout), bpy.context)
    (switch,) = layout.row.return_value.row.return_value.prop.call_args_list
    assert switch.args == (scene.xihe, "follows_objects")


def test_a_wipe_in_the_lit_scene_stays_at_its_frame(scene):
    assert bpy.ops.xihe.show_comparison() == bpy.ops.xihe.show_lit() == {"FINISHED"}
    lit, picture = lit_scene(), image_named(COMPARISON_NAME)
    scene.frame_set(1)
    lit.frame_set(5)
    for shown, frame in ((lit, 5), (scene, 1)):
        with bpy.context.temp_override(scene=shown):
            scene.xihe.wipe = 0.1 * frame
        assert picture[FRAME] == frame


def test_pictures_of_the_light_of_moved_and_added_objects_stay_those_of_their_place(scene):
    bpy.data.objects["Ball"].location.x += 0.4
    sphere(scene, "New", (0.3, 0.6, 1.2), 0.1, None, virtual_collection(scene))
    bpy.context.view_layer.update()
    assert bpy.ops.xihe.update_light() == {"FINISHED"}
    scene.frame_set(0)
    assert bpy.ops.xihe.go_to_trigger(direction="NEXT") == {"FINISHED"}
    lights = lights_of_scene(scene, LightsAsked(scene.frame_current, units="scene"))
    assert [light.object_name for light in lights] == ["Ball", "Board", "New"]
    for light in lights:
        picture = np.array(bpy.data.images[f"Xihe Light {light.object_name}"].pixels).reshape(-1, 4)
        assert picture[:, :3].mean() == pytest.approx(evaluate_panorama(light.light.sh, 64, 128).mean(), rel=1e-3)
    bpy.data.worlds["Xihe New"].node_tree.nodes.clear()  # It is the user's file.
    assert bpy.ops.xihe.go_to_trigger(direction="NEXT") == {"FINISHED"}


def test_a_file_that_was_saved_in_the_lit_scene_is_exported_as_one_saved_in_the_room(scene, tmp_path):
    files, written = [], []
    for action, name in (("show_lit", "lit"), ("show_room", "room")):
        assert getattr(bpy.ops.xihe, action)() == {"FINISHED"}
        assert (bpy.context.scene.name == "Xihe Lit") is (name == "lit")
        files.append(saved(tmp_path / f"{name}.blend"))
    for file in files:
        assert open_blend(file) == bpy.context.scene != bpy.data.scenes["Xihe Lit"]
        assert main(["export", "--from", str(file), "--to", "three", "--out", str(file.with_suffix(""))]) == 0
        written.append((file.with_suffix("") / "three.json").read_text())
    assert written[0] == written[1]


def test_a_file_that_was_saved_in_the_lit_scene_is_opened_there_where_its_room_was_deleted(tmp_path):
    empty_scene()
    lit, room = bpy.data.scenes.new("Xihe Lit"), bpy.data.scenes.new("Room")
    bpy.context.window.scene, lit[ROOM] = lit, room
    bpy.data.scenes.remove(room)
    assert open_blend(saved(tmp_path / "lit.blend")).name == "Xihe Lit"


def test_show_lit_has_the_light_of_its_own_run_where_a_copy_of_the_scene_has_had_another(scene, lit_run, tmp_path):
    before = keyed(bpy.data.worlds["Xihe Ball"])[0]
    folder = shutil.copytree(lit_run, tmp_path / "brighter")
    results = json.loads((folder / "results.json").read_text())
    for change in results["lights"]["Ball"]:
        change["sh"] = (3 * np.array(change["sh"])).tolist()
    (folder / "results.json").write_text(json.dumps(results))
    apply_results(scene.copy(), folder)  # A linked copy, with another path: it shares the objects.
    assert not np.allclose(keyed(bpy.data.worlds["Xihe Ball"])[0][1], before[1])
    for _ in range(2):
        assert bpy.ops.xihe.show_lit() == {"FINISHED"}
        shown = keyed(bpy.data.worlds["Xihe Ball"])[0]
        assert shown.keys() == before.keys() and all(np.allclose(shown[frame], before[frame]) for frame in before)
        assert bpy.ops.xihe.show_room() == {"FINISHED"}
