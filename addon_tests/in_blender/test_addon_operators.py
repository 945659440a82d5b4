"""Each operator does what its function does, and says why when it cannot."""

import re
from pathlib import Path

import bpy
import numpy as np
import pytest
from addon_runs import enable_preferences, poll_message, registered_addon, small_panel_runs, walk_for_the_panel
from previs_runs import counted_renders, walk
from scene_snapshot import snapshot
from tiny_scenes import add, box, empty_scene, memberships, room_with_a_virtual_sphere

from addon_tests.pure.test_old_runs import FIRST, SECOND, THIRD, make_run
from xihe_blender.addon.planning_operators import known_times
from xihe_blender.addon.preferences import own_folder, runs_folder
from xihe_blender.addon.run_settings import previs_settings, required_effects
from xihe_blender.addon.runs_folder import new_run_folder
from xihe_blender.io.old_runs import old_runs, runs_in
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport.overrides import remembered_overrides
from xihe_blender.previs.required_effects import effects_of_run
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.virtual_objects import make_room, make_virtual, virtual_objects
from xihenet.trigger import RULES


@pytest.fixture(autouse=True)
def addon():
    with registered_addon():
        yield


def select(*names):
    # Blender 5.2 lists what was linked only after an update.
    bpy.context.view_layer.update()
    for item in bpy.context.view_layer.objects:
        item.select_set(item.name in names)
    bpy.context.view_layer.update()


def everything():
    """The open file; what is selected, and where in memory something lies, left out."""
    bpy.context.view_layer.update()
    table = snapshot()
    return {p: value for p, value in table.items() if not p.startswith("context/") and "address=0x" not in str(value)}


# ------------------------------------------------------------------------------------------------------------- objects


@pytest.mark.parametrize(
    ("operator", "function", "selected", "moved"),
    [
        ("add_virtual_objects", make_virtual, ("Table", "Lamp", "Phone"), {"Table", "Lamp"}),
        ("remove_virtual_objects", make_room, ("Ball", "Table"), {"Ball"}),
    ],
)
def test_an_operator_of_objects_equals_its_function(operator, function, selected, moved):
    scene = walk()
    select(*selected)
    assert {item.name for item in function(scene, bpy.context.selected_objects)} == moved
    by_function = everything()
    walk()
    select(*selected)
    assert getattr(bpy.ops.xihe, operator)() == {"FINISHED"}
    assert everything() == by_function
    assert {item.name for item in bpy.context.selected_objects} == set(selected)


@pytest.mark.parametrize("data", [None, "Rig"])
def test_a_model_whose_empty_or_armature_alone_is_selected_is_added_and_taken_back_with_its_parts(data):
    scene = room_with_a_virtual_sphere()
    root = add(scene, "Model", data and bpy.data.armatures.new(data))
    inner, lamp = add(scene, "Inner", None), add(scene, "Bulb", bpy.data.lights.new("Bulb", "POINT"))
    body, wheel = (box(scene, name, (0, 0, 1), (0.1, 0.1, 0.1)) for name in ("Body", "Wheel"))
    inner.parent, lamp.parent, body.parent, wheel.parent = root, root, root, inner
    shade = box(scene, "Shade", (0, 0, 1), (0.1, 0.1, 0.1))
    shade.parent = bpy.data.objects["Phone"]
    before = memberships()
    select("Phone")
    assert "has a surface to light" in poll_message(bpy.ops.xihe.add_virtual_objects), "a camera is no model"
    select("Model")
    assert bpy.ops.xihe.add_virtual_objects() == {"FINISHED"}
    assert {item.name for item in virtual_objects(scene)} == {"Ball", "Body", "Wheel"}
    assert {name: homes for name, homes in memberships().items() if name not in ("Body", "Wheel")} == {
        name: homes for name, homes in before.items() if name not in ("Body", "Wheel")
    }
    assert poll_message(bpy.ops.xihe.add_virtual_objects) == "The selected objects are virtual already"
    assert bpy.ops.xihe.remove_virtual_objects() == {"FINISHED"}
    assert memberships() == before


def test_grease_pencil_that_was_selected_with_a_model_is_said_to_stay_in_the_room(capfd):
    scene = walk()
    pencils = getattr(bpy.data, "grease_pencils_v3", bpy.data.grease_pencils)  # Up to Blender 4.5, and since.
    drawing = add(scene, "Drawing", pencils.new("Drawing"))
    for names, said in (
        (["Table", "Drawing"], "1 object is virtual now. Grease Pencil has no surface"),
        (["Lamp"], ""),
    ):
        select(*names)
        capfd.readouterr()
        assert bpy.ops.xihe.add_virtual_objects() == {"FINISHED"}
        out = capfd.readouterr().out
        assert said in out and ("Grease Pencil" in out) == bool(said)
    assert drawing not in virtual_objects(scene)


def test_an_error_stays_in_the_panel_until_something_succeeds():
    empty_scene()
    state = bpy.context.window_manager.xihe
    with pytest.raises(RuntimeError, match="No recording is chosen"):
        bpy.ops.xihe.import_capture()
    assert "No recording is chosen" in state.error
    assert bpy.ops.xihe.add_sphere_rig() == {"FINISHED"} and state.error == ""


def test_the_rig_stands_at_the_cursor():
    scene = empty_scene()
    scene.cursor.location = (1, 2, 3)
    assert bpy.ops.xihe.add_sphere_rig(radius_m=0.1) == {"FINISHED"}
    rig = virtual_objects(scene)
    assert len(rig) == 3
    np.testing.assert_allclose(np.mean([item.location for item in rig], axis=0), (1, 2, 3.1), atol=1e-6)


# ------------------------------------------------------------------------------------------------------------- effects


def rows(scene):
    return {row.name: (row.state, "auto" if row.override == "AUTO" else "user") for row in scene.xihe.effects}


def assert_rows_are_those_of_a_run(scene, **settings):
    effects = run_blocking(effects_of_run(scene, PrevisSettings(**settings), is_measured=False))
    assert rows(scene) == {name: (effect.state, effect.origin) for name, effect in effects.items()}
    return effects


def test_the_rows_of_effects_are_those_of_the_command_line():
    scene = walk()
    scene.xihe.use_own_frames, scene.xihe.frame_start, scene.xihe.frame_end = True, 2, 4
    assert bpy.ops.xihe.plan_effects() == {"FINISHED"}
    effects = assert_rows_are_those_of_a_run(scene, frames=(2, 3, 4))
    assert [row.reason for row in scene.xihe.effects] == [effect.reason for effect in effects.values()]


def test_effects_are_looked_for_a_frame_at_a_time():
    scene = walk()
    with counted_renders() as looks:
        seen = [len(looks) for _ in required_effects(scene)]
    assert seen[:3] == [0, 1, 2]


def test_an_override_is_kept_in_the_file_and_outlasts_another_look():
    scene = walk()
    bpy.ops.xihe.plan_effects()
    scene.xihe.effects["denoising"].override = "OFF"
    scene.xihe.effects["volumes"].override = "ON"
    assert remembered_overrides(scene) == {"denoising": "off", "volumes": "on"}
    for _ in range(2):
        assert_rows_are_those_of_a_run(scene)
        bpy.ops.xihe.plan_effects()
    scene.xihe.effects["denoising"].override = "AUTO"
    assert remembered_overrides(scene) == {"volumes": "on"}


def test_the_phone_has_rows_of_its_own_which_go_when_another_is_chosen():
    scene = walk()
    scene.xihe.phone, scene.xihe.network = "ipad_pro_lidar", "lte"
    bpy.ops.xihe.plan_effects()
    assert_rows_are_those_of_a_run(scene, phone="ipad_pro_lidar", network="lte")
    switchable = {row.name for row in scene.xihe.effects if row.is_switchable}
    assert {"edge_bleeding", "network", "volumes"} <= switchable and "quantisation" not in switchable
    scene.xihe.effects["noise"].override = "OFF"
    scene.xihe.phone = "iphone_lidar"
    assert not scene.xihe.effects
    bpy.ops.xihe.plan_effects()
    assert rows(scene)["noise"] == ("off", "user") == (remembered_overrides(scene)["noise"], "user")
    scene.xihe.network = "NONE"
    assert not scene.xihe.effects


def test_an_effect_that_nothing_switches_goes_back_to_auto_and_says_why():
    scene = walk()
    bpy.ops.xihe.plan_effects()
    row = scene.xihe.effects["hair"]
    assert not row.is_switchable
    row.override = "ON"
    assert row.override == "AUTO" and "cannot be switched" in bpy.context.window_manager.xihe.error
    assert remembered_overrides(scene) == {}


def test_an_override_of_an_older_version_in_the_file_is_said_when_an_effect_is_switched(capfd):
    scene = walk()
    row = scene.xihe.effects.add()
    scene["xihe_effects"], row.name = {"dark_holes": "on"}, "volumes"
    row.override = "ON"
    assert row.override == "AUTO" and "of an older version" in bpy.context.window_manager.xihe.error
    assert "RecursionError" not in capfd.readouterr().err


# -------------------------------------------------------------------------------------------------------- what is grey


def test_grey_buttons_without_anything_say_what_to_do(tmp_path):
    empty_scene()
    enable_preferences().cache_folder = str(tmp_path)
    nothing_virtual = "Make an object virtual first: select it, and add it above"
    no_results = "There are no results yet: run first"
    assert {name: poll_message(getattr(bpy.ops.xihe, name)) for name in dir(bpy.ops.xihe)} == {
        "add_sphere_rig": "",
        "import_capture": "",
        "plan_effects": "",
        "add_virtual_objects": "Select the objects that the phone should insert",
        "remove_virtual_objects": "Select virtual objects first",
        "measure_run": nothing_virtual,
        "measure_budget": nothing_virtual,
        "calibrate": nothing_virtual,
        "run": nothing_virtual,
        "cancel_run": "No run is under way",
        "resume_run": "No run of this file is left to go on with",
        "discard_run": "No run of this file is left to go on with",
        "apply_light": no_results,
        "update_light": no_results,
        "remove_light": "No run has added anything to this file",
        "show_lit": "There are no results yet: run first",
        "show_room": "This is the room: press Show Lit to see the objects lit",
        "go_to_trigger": "There are no triggers on the timeline: run first, or apply the last run",
        "show_comparison": no_results,
        "save_side_by_side": no_results,
        "save_viewer": no_results,
        "export_light": no_results,
        "open_report": no_results,
        "explain": "",
        "look_where": no_results,
        "add_better_camera": "Add a camera and animate it as the phone's path",
        "map_places": no_results,
        "go_to_place": "There is no map yet: press Map Room first",
        "remove_map": "There is no map yet: press Map Room first",
        "remove_old_runs": f"There are no runs in {tmp_path}",
    }


def test_while_a_run_lasts_nothing_else_can_be_done():
    walk()
    bpy.context.window_manager.xihe.is_running = True
    changing = set(dir(bpy.ops.xihe)) - {"cancel_run", "explain", "open_report"}
    for name in changing:
        assert poll_message(getattr(bpy.ops.xihe, name)) == "A run is under way: wait for it, or cancel it", name
    assert bpy.ops.xihe.cancel_run() == {"FINISHED"}
    assert bpy.context.window_manager.xihe.is_cancel_wanted


def test_while_a_run_lasts_in_the_background_the_results_of_the_one_before_are_at_hand():
    walk()
    job = bpy.context.window_manager.xihe
    job.is_running, job.works_here = True, False
    reading = ("export_light", "go_to_trigger", "save_side_by_side", "save_viewer", "show_comparison")
    said = {name: poll_message(getattr(bpy.ops.xihe, name)) for name in (*reading, "show_lit", "show_room")}
    assert [name for name in said if "under way" in said[name]] == ["show_lit"]


def test_grey_buttons_of_objects():
    scene = walk()
    select("Ball")
    bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
    bpy.ops.object.mode_set(mode="EDIT")
    for operator in (bpy.ops.xihe.add_virtual_objects, bpy.ops.xihe.add_sphere_rig, bpy.ops.xihe.run):
        assert poll_message(operator) == "Go to Object Mode first"
    bpy.ops.object.mode_set(mode="OBJECT")
    camera, scene.camera = scene.camera, None
    for operator in (bpy.ops.xihe.measure_run, bpy.ops.xihe.calibrate, bpy.ops.xihe.run):
        assert poll_message(operator) == "Add a camera and animate it as the phone's path"
    # One that only a marker chooses is one.
    scene.timeline_markers.new("Phone", frame=1).camera = camera
    assert poll_message(bpy.ops.xihe.run) == ""


def test_a_last_run_that_is_gone_says_so(tmp_path):
    scene = walk()
    scene.xihe.run_folder = str(tmp_path / "gone")
    for operator in (bpy.ops.xihe.apply_light, bpy.ops.xihe.show_comparison, bpy.ops.xihe.open_report):
        assert poll_message(operator).endswith("put the folder xihe_runs beside this file, or run again")
    scene.xihe.run_folder = str(tmp_path)
    (tmp_path / "results.json").write_text("{}")
    assert poll_message(bpy.ops.xihe.show_comparison) == "The last run compared no frame: no virtual object was in view"
    assert poll_message(bpy.ops.xihe.open_report) == "The last run's report is gone: run again"
    with pytest.raises(RuntimeError, match="is not from a run of this version: run again"):
        bpy.ops.xihe.apply_light()


def test_without_cycles_the_buttons_say_which_add_on_to_enable():
    walk()
    bpy.ops.preferences.addon_disable(module="cycles")
    try:
        for operator in (bpy.ops.xihe.run, bpy.ops.xihe.measure_run, bpy.ops.xihe.plan_effects):
            assert poll_message(operator) == "Enable the add-on Cycles Render Engine in Blender's preferences"
    finally:
        bpy.ops.preferences.addon_enable(module="cycles")


# ------------------------------------------------------------------------------------------------------------ settings


def test_the_panel_is_at_first_a_run_without_options_and_every_setting_reaches_the_run(tmp_path):
    assert previs_settings(walk()) == PrevisSettings()
    (tmp_path / "mine.toml").write_text('name = "Mine"\nsummary = "A phone of my own."\n')
    scene = walk_for_the_panel(
        tmp_path, estimator="projection", target="hdr", use_own_frames=True, frame_start=2, frame_end=5, frame_step=2,
        phone="FILE", phone_file=str(tmp_path / "mine.toml"), network="lte", use_own_exposure=True, exposure=0.5,
        metering="key", seed=7, carries_light=False, others={"xihenet", "lattice"}, trigger="light",
    )  # fmt: skip
    assert previs_settings(scene) == PrevisSettings(
        estimator="projection", preset="draft", target="hdr", size=(32, 24), frames=(2, 4), exposure=0.5,
        metering="key", seed=7, phone=str(tmp_path / "mine.toml"), network="lte", between_estimates="kept",
        others=("xihenet", "lattice"), trigger=RULES["light"],
    )  # fmt: skip
    # The phone of the preferences is that of a scene without one.
    scene, user = walk(), enable_preferences()
    user.phone, user.phone_file = "FILE", str(tmp_path / "mine.toml")
    assert previs_settings(scene).phone == str(tmp_path / "mine.toml")
    # And a path may begin in the folder of the .blend, as Linux or as Windows writes it.
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    (tmp_path / "phones").mkdir()
    (tmp_path / "mine.toml").rename(tmp_path / "phones" / "mine.toml")
    for written in ("//phones/mine.toml", "//phones\\mine.toml"):
        scene.xihe.phone, scene.xihe.phone_file = "FILE", written
        assert previs_settings(scene).phone == str(tmp_path / "phones" / "mine.toml")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"use_own_frames": True, "frame_start": 3, "frame_end": 2}, "end at 2, before they start at 3"),
        ({"use_own_frames": True, "frame_start": 3, "frame_end": 9}, "3 to 9 go beyond the scene's range 1 to 5"),
        ({"phone": "FILE"}, "no file is chosen"),
        ({"phone": "FILE", "phone_file": "/nowhere.toml"}, "Phone: /nowhere.toml: there is no such file"),
    ],
)
def test_settings_that_cannot_be_run_are_said_in_the_panels_words(tmp_path, settings, said):
    walk_for_the_panel(tmp_path / "runs", **settings)
    for operator in (bpy.ops.xihe.run, bpy.ops.xihe.measure_run):
        with pytest.raises(RuntimeError, match=said):
            operator()
    assert said in bpy.context.window_manager.xihe.error
    assert not (tmp_path / "runs").exists()


def test_own_frames_begin_with_the_scenes_range():
    scene = walk()
    scene.frame_start, scene.frame_end, scene.frame_step = 2, 40, 3
    scene.xihe.use_own_frames = True
    assert (scene.xihe.frame_start, scene.xihe.frame_end, scene.xihe.frame_step) == (2, 40, 3)


@pytest.mark.parametrize("is_known", [True, False], ids=["of one Blender", "another Blender makes one at that moment"])
def test_folders_of_runs_are_new_each_time(tmp_path, monkeypatch, is_known):
    scene = walk_for_the_panel(tmp_path / "deep" / "runs")
    if not is_known:
        monkeypatch.setattr(Path, "exists", lambda _: False)
    folders = [new_run_folder(scene) for _ in range(4)]
    assert len(set(folders)) == 4 and all(folder.is_dir() for folder in folders)
    assert {folder.parent for folder in folders} == {tmp_path / "deep" / "runs"}
    assert all(folder.name.startswith("untitled_") for folder in folders)


def test_runs_lie_beside_the_saved_file_and_never_where_blender_deletes_them_with_the_extension(tmp_path):
    walk_for_the_panel("")
    assert runs_folder() == Path(bpy.utils.user_resource("DATAFILES")) / "xihe_runs"
    assert not runs_folder().is_relative_to(own_folder())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "room.blend"))
    assert runs_folder() == tmp_path / "xihe_runs"


def test_a_runs_folder_that_cannot_be_made_names_the_preference(tmp_path):
    (tmp_path / "file").write_text("in the way")
    walk_for_the_panel(tmp_path / "file")
    with pytest.raises(RuntimeError, match="choose another Runs Folder in the add-on's preferences"):
        bpy.ops.xihe.run()


def test_remove_old_runs_equals_its_function_and_keeps_what_any_scene_shows(tmp_path):
    runs = [make_run(tmp_path, name) for name in (THIRD, FIRST, SECOND)]
    scene, other = empty_scene(), bpy.data.scenes.new("Other")
    enable_preferences().cache_folder = str(tmp_path)
    scene.xihe.run_folder, other.xihe.run_folder = str(runs[0]), str(runs[1])
    assert old_runs(tmp_path, runs[:2]) == [runs[2]]
    assert bpy.ops.xihe.remove_old_runs() == {"FINISHED"}
    assert runs_in(tmp_path) == runs[:2]
    assert poll_message(bpy.ops.xihe.remove_old_runs) == "This file shows every run: there is none to remove"
    scene.xihe.run_folder = other.xihe.run_folder = ""
    assert bpy.ops.xihe.remove_old_runs() == {"FINISHED"} and tmp_path.exists(), "the user made it"
    ours = make_run(tmp_path / "xihe_runs", FIRST).parent
    enable_preferences().cache_folder = str(ours)
    assert bpy.ops.xihe.remove_old_runs() == {"FINISHED"} and not ours.exists()


@small_panel_runs()
def test_how_long_says_the_time_of_the_run(tmp_path):
    walk_for_the_panel(tmp_path, use_own_frames=True, frame_end=1)
    assert bpy.ops.xihe.measure_run() == {"FINISHED"}
    state = bpy.context.window_manager.xihe
    for said in (state.run_estimate, state.budget_estimate):
        assert re.fullmatch(r"about \d+ (s|min|h).*", said)
    chosen, known = bpy.context.scene.xihe, (state.run_estimate, state.budget_estimate)
    for name, other in (
        ("preset", "accurate"),
        ("frame_end", 3),
        ("others", {"projection"}),
        ("phone_file", "slow.toml"),
        ("target", "ldr"),
        ("metering", "key"),
    ):
        before = getattr(chosen, name)
        assert known_times(bpy.context) == known
        setattr(chosen, name, other)
        assert known_times(bpy.context) == ("", ""), f"measured before {name} was {other}"
        setattr(chosen, name, before)
    effect = chosen.effects.add()
    effect.name = "denoising"
    assert known_times(bpy.context) == known
    effect.override = "OFF"
    assert known_times(bpy.context) == ("", "")
