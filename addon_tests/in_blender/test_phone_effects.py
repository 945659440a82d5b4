"""Which effects of a phone a session shows, what they know of the room, and which are announced before a run."""

import json
import shutil
from dataclasses import replace

import bpy
import numpy as np
import pytest
from effect_scenes import shader_look
from planned_effects import plan_light_transport
from previs_runs import IPAD, SMALL
from scene_snapshot import nothing_changes
from tiny_scenes import (
    add,
    add_instance,
    add_lamp,
    box,
    empty_scene,
    key,
    light_strength,
    node_of,
    room_with_a_virtual_sphere,
)

from addon_tests.pure.made import frame_of
from xihe_blender.capture.phone_surfaces import load_surfaces
from xihe_blender.cli.effects import format_effects
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import remember_overrides
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import prepare_run
from xihe_blender.previs.required_effects import effects_of_run, plan_phone_effects, positions_in
from xihe_blender.previs.run_chain import run_chain
from xihe_blender.previs.settings import load_estimators
from xihe_blender.previs.simulated_phone import SURFACE_EFFECTS, choose_phone, facts_of_capture, simulate_phone
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.effects import effects_as_json
from xihenet.io.recording import load_frame
from xihenet.phone import PHONE_EFFECTS, SurfaceFacts

SESSION = replace(SMALL, phone="ipad_pro_lidar", network="lte")


def planned(scene, out, settings):
    """The phone of a small run of few samples after the chain has run, the capture of its first frame, its files.

    What an earlier run has left in `out` goes.
    """
    shutil.rmtree(out, ignore_errors=True)
    files = RunOutputs(out, "untitled")
    settings = replace(settings, size=(32, 24), samples=2, exposure=1.0)
    plan = plan_previs(scene, settings)
    survey, estimator = run_blocking(survey_path(scene, plan)), load_estimators(settings)
    run = run_blocking(prepare_run(scene, plan, survey, files, settings, estimator))
    return run_blocking(run_chain(run)).phone, load_frame(files.capture(plan.frames[0])), files


def before_captures(scene, settings):
    """The phone as the survey of the path alone has it."""
    survey = run_blocking(survey_path(scene, plan_previs(scene, settings)))
    return simulate_phone(choose_phone(scene, survey, settings), {}, exposure=1.0)


def state(phone, name):
    return phone.effects[name].state


def principled(name, **inputs):
    return shader_look(name, "BsdfPrincipled", **inputs)


def pane(scene, look):
    """A board between the phone and the room, turned, in the middle of the picture of frame 1."""
    item = box(scene, "Pane", (-0.7, -0.9, 1.28), (0.5, 0.02, 0.5), look)
    item.rotation_euler = (0, 0, 0.3)
    return item


@pytest.fixture(scope="module")
def as_it_is(tmp_path_factory):
    """Of the room as it is."""
    return planned(room_with_a_virtual_sphere(), tmp_path_factory.mktemp("as_it_is"), IPAD)


def test_range_is_cut_in_a_large_room_and_not_in_a_small_one(as_it_is, tmp_path):
    assert state(as_it_is[0], "range") == "off"
    scene = room_with_a_virtual_sphere()
    bpy.data.objects["Room"].scale = (4, 4, 2)
    large, captured, files = planned(scene, tmp_path, IPAD)
    assert state(large, "range") == "on"
    _, n_lost = replace(large, of_camera=frozenset({"range"})).see(captured, files)
    assert n_lost["range"] == np.count_nonzero(captured.plane_depth_m > 5)


def test_an_effect_that_was_left_out_would_have_changed_nothing(as_it_is, tmp_path):
    by_itself, captured, beside = as_it_is
    choices = {"range": "on", "transparent_dropout": "on"}
    forced, again, files = planned(room_with_a_virtual_sphere(), tmp_path, replace(IPAD, effect_choices=choices))
    assert choices.keys() <= forced.on - by_itself.on
    with_all = forced.see(again, files)[0]
    assert np.array_equal(by_itself.see(captured, beside)[0].plane_depth_m, with_all.plane_depth_m)


def test_a_still_camera_has_no_rolling_shutter_and_no_drift(as_it_is, tmp_path):
    assert state(as_it_is[0], "rolling_shutter") == state(as_it_is[0], "pose_drift") == "on"
    scene = room_with_a_virtual_sphere(2, is_still=True)
    still, captured, files = planned(scene, tmp_path, IPAD)
    assert state(still, "rolling_shutter") == state(still, "pose_drift") == "off"
    assert np.array_equal(still.see(captured, files)[0].world_from_camera, captured.world_from_camera)
    # A frame that is taken over has what its source has.
    later = load_frame(files.capture(2))
    assert later.frame == 2 and np.array_equal(captured.srgb_u8, later.srgb_u8)
    seen = [replace(still, of_camera=SURFACE_EFFECTS).see(frame, files)[0] for frame in (captured, later)]
    assert np.array_equal(seen[0].plane_depth_m, seen[1].plane_depth_m)
    facts = [vars(load_surfaces(files.surfaces(frame))) for frame in (1, 2)]
    assert all(np.array_equal(facts[0][key], facts[1][key]) for key in facts[0])


def test_a_single_frame_of_a_walk_is_not_taken_for_a_still_camera(tmp_path):
    phone, *_ = planned(room_with_a_virtual_sphere(), tmp_path, replace(IPAD, frames=(2,)))
    assert state(phone, "rolling_shutter") == "on"
    assert np.linalg.norm(phone.chosen.survey.frames[2].motion.velocity_m_per_s) == pytest.approx(0.3 * 24, rel=0.05)


SKY = 'worlds["Background"].node_tree.nodes["Background"].inputs["Color"]'
LIGHTS = {
    "switched off": ('objects["Lamp"]', "hide_render", {1: False, 2: True}),
    "carried away": ('objects["Lamp"]', "location", {1: (1.9, 1, 1.6), 3: (1.9, 3, 1.6)}),
    "another sky": (SKY, "default_value", {1: (0.1, 0.1, 0.1, 1.0), 3: (0.3, 0.3, 0.3, 1.0)}),
}
"""What is keyed, from bpy.data on, and its values by frame."""


@pytest.mark.parametrize(("path", "name", "values"), LIGHTS.values(), ids=LIGHTS)
def test_a_light_that_changes_is_noticed(path, name, values):
    scene = room_with_a_virtual_sphere()
    key(bpy.data.path_resolve(path), name, values)
    assert before_captures(scene, IPAD).chosen.survey.light_changes


def test_a_lamp_that_is_driven_is_noticed():
    scene = room_with_a_virtual_sphere()
    add_lamp(scene).data.driver_add("energy").driver.expression = "frame * 10"
    assert before_captures(scene, IPAD).chosen.survey.light_changes


def test_the_light_sensor_is_simulated_where_a_light_changes(tmp_path):
    scene = room_with_a_virtual_sphere()
    key(light_strength(), "default_value", {1: 6.0, 3: 1.0})
    phone, captured, files = planned(scene, tmp_path, IPAD)
    assert state(phone, "light_sensor") == "on"
    assert not np.allclose(phone.see(captured, files)[0].ambient, captured.ambient, rtol=1e-3)


def test_the_light_sensor_is_left_out_where_no_light_changes(tmp_path):
    scene = room_with_a_virtual_sphere()
    # A virtual lamp, as an instance of a collection and by itself: the captures show neither.
    lamps = bpy.data.collections.new("Lamps")
    lamp = add_lamp(scene, collection=lamps)
    lamp.data.driver_add("energy").driver.expression = "frame * 10"
    add_instance(scene, lamps, virtual_collection(scene))
    add(scene, "Torch", lamp.data, collection=virtual_collection(scene))
    key(bpy.data.objects["Table"], "location", {1: (0, 0.1, 0.7), 3: (0, 0.3, 0.7)})
    phone, captured, files = planned(scene, tmp_path, IPAD)
    assert state(phone, "light_sensor") == "off"
    assert np.array_equal(phone.see(captured, files)[0].ambient, captured.ambient)


@pytest.mark.parametrize(
    ("effect", "look"),
    [
        ("transparent_dropout", {"Transmission_Weight": 1.0, "Roughness": 0.0, "Base_Color": (1, 1, 1, 1)}),
        ("glossy_dropout", {"Metallic": 1.0, "Roughness": 0.02}),
        ("dark_dropout", {"Base_Color": (0.01, 0.01, 0.01, 1), "Specular_IOR_Level": 0.0}),
    ],
)
def test_a_surface_that_gives_no_answer_makes_a_hole_where_it_is(effect, look, as_it_is, tmp_path):
    assert state(as_it_is[0], effect) == "off"
    scene = room_with_a_virtual_sphere(1)
    pane(scene, principled("Pane", **look))
    phone, captured, files = planned(scene, tmp_path, IPAD)
    assert state(phone, effect) == "on"
    seen, n_lost = replace(phone, of_camera=frozenset({effect})).see(captured, files)
    middle = (slice(10, 14), slice(14, 18))
    assert (captured.plane_depth_m[middle] > 0).all() and (seen.plane_depth_m[middle] == 0).all()
    assert 16 <= n_lost[effect] < captured.plane_depth_m.size / 2


def test_a_lacquered_surface_answers_and_a_lamp_is_not_dark(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    pane(scene, principled("Lacquer", Roughness=0.02, Base_Color=(0.6, 0.3, 0.2, 1)))
    phone, captured, files = planned(scene, tmp_path, replace(IPAD, effect_choices={"glossy_dropout": "on"}))
    assert state(phone, "dark_dropout") == "off"
    assert phone.see(captured, files)[1]["glossy_dropout"] == 0


def test_a_bright_wall_at_night_is_not_dark_to_a_sensor_with_its_own_light(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    light_strength().default_value = 1e-3
    phone, captured, _ = planned(scene, tmp_path, IPAD)
    assert captured.srgb_u8.mean() < 15
    assert state(phone, "dark_dropout") == "off"


def test_roughness_that_a_texture_drives_is_not_known_and_makes_no_hole(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    look = principled("Brushed", Metallic=1.0)
    noise = look.node_tree.nodes.new("ShaderNodeTexNoise")
    look.node_tree.links.new(noise.outputs[0], node_of(look, "BSDF_PRINCIPLED").inputs["Roughness"])
    pane(scene, look)
    phone, captured, files = planned(scene, tmp_path, IPAD)
    assert state(phone, "glossy_dropout") == "on"
    assert np.isnan(load_surfaces(files.surfaces(1)).roughness[12, 16])
    assert phone.see(captured, files)[1]["glossy_dropout"] == 0


def test_materials_of_other_names_do_not_stand_in_for_a_mirror(tmp_path):
    """Names of every length and beyond ASCII: Cryptomatte knows a material by a hash of its name."""
    scene = room_with_a_virtual_sphere(1)
    roughness = {"M": 0.07, "Mi": 0.08, "Mir": 0.09, "Mirr": 0.1, "Spiegel größer": 0.11, "鏡": 0.12}
    for column, (name, value) in enumerate(roughness.items()):
        strip = pane(scene, principled(name, Metallic=1.0, Roughness=value))
        strip.scale.x, strip.delta_location.x = 0.15, 0.09 * column - 0.22
    *_, files = planned(scene, tmp_path, IPAD)
    seen = load_surfaces(files.surfaces(1)).roughness
    from_left_to_right = dict.fromkeys(seen[12][seen[12] < 0.5].tolist())
    assert list(from_left_to_right) == np.float32(list(roughness.values())).tolist() and seen[0, 0] == 1


def test_a_path_that_is_coarser_than_the_network_says_so():
    scene, settings = room_with_a_virtual_sphere(2), replace(SMALL, network="lte")
    assert before_captures(scene, settings).notes() == []
    scene.render.fps = 2
    (note,) = before_captures(scene, settings).notes()
    assert "500 ms" in note and "79 ms" in note
    phone = before_captures(scene, replace(settings, effect_choices={"network": "off"}))
    assert phone.link_in_use is None and phone.effects["network"].origin == "user" and phone.notes() == []


def test_choices_are_remembered_in_the_blend_and_the_runs_own_win():
    scene = room_with_a_virtual_sphere(1)
    remember_overrides(scene, {"noise": "off", "range": "off", "volumes": "on"})
    phone = before_captures(scene, IPAD)
    assert (state(phone, "noise"), state(phone, "range")) == ("off", "off")
    phone = before_captures(scene, replace(IPAD, effect_choices={"noise": "auto", "range": "on"}))
    assert (state(phone, "noise"), state(phone, "range")) == ("on", "on")
    assert before_captures(scene, SMALL).on == frozenset()


def announced(scene, settings=SESSION, *, is_captured=True):
    positions = positions_in(scene, scene.frame_start)
    return run_blocking(plan_phone_effects(scene, positions, settings, is_captured=is_captured))


@pytest.mark.slow
def test_what_is_announced_is_what_the_run_simulates(tmp_path):
    scene = room_with_a_virtual_sphere()
    states = {name: effect.state for name, effect in announced(scene).items()}
    simulated = planned(scene, tmp_path, SESSION)[0].effects
    assert list(states) == list(PHONE_EFFECTS) and set(states.values()) == {"on", "off"}
    assert states == {name: simulated[name].state for name in states}


def test_without_captures_nothing_is_left_out_that_captures_would_call_for():
    scene = room_with_a_virtual_sphere()
    seen, unseen = announced(scene), announced(scene, is_captured=False)
    assert all(unseen[name].state == "on" for name, effect in seen.items() if effect.state == "on")
    assert unseen["range"].state == "on" and "not known" in unseen["range"].reason
    assert seen["range"].state == "off" and "within the sensor's" in seen["range"].reason
    # Without objects the path tells all but how near they come to surfaces, unless frames without one are left out.
    alone = run_blocking(plan_phone_effects(scene, [], SESSION, is_captured=True))
    assert {name: (effect.state, effect.reason) for name, effect in alone.items() if effect != seen[name]} == {
        "noise": ("on", "it is not known how near surfaces come to the virtual objects")
    }
    in_view = replace(SESSION, captured="in-view")
    assert run_blocking(plan_phone_effects(scene, [], in_view, is_captured=True)) == unseen


def test_looking_changes_nothing_in_the_file():
    scene = room_with_a_virtual_sphere()
    scene.frame_set(3)
    scene.camera.location.x += 0.1  # Without a key.
    with nothing_changes():
        run_blocking(effects_of_run(scene, replace(SMALL, phone="ipad_pro_lidar"), is_measured=False))


def test_a_perfect_phone_that_estimates_by_itself_has_no_effects():
    assert announced(room_with_a_virtual_sphere(), SMALL) == {}
    assert set(announced(room_with_a_virtual_sphere(), replace(SMALL, network="lte"))) == set(PHONE_EFFECTS)


def test_a_phone_without_a_camera_is_refused():
    empty_scene()
    with pytest.raises(UserError, match="has no camera"):
        announced(bpy.context.scene)


def test_light_transport_comes_first_and_the_phone_behind_it():
    scene = room_with_a_virtual_sphere()
    effects = run_blocking(effects_of_run(scene, SESSION, is_measured=False))
    transport = plan_light_transport(scene, positions_in(scene, scene.frame_start), frames=SESSION.frames)
    assert effects == transport | announced(scene, is_captured=False)
    rows = json.loads(json.dumps(effects_as_json(effects, with_cost=True), allow_nan=False))
    assert [row["name"] for row in rows] == list(effects) == [*transport, *PHONE_EFFECTS]
    assert set(rows[-1]) == {"name", "state", "reason", "parameters", "origin", "cost"}
    line = next(line for line in format_effects(effects).splitlines() if line.startswith("edge_bleeding"))
    assert " on " in line and "radius_px 2" in line


@pytest.mark.parametrize(("known", "state"), [(True, "off"), (False, "on")])
def test_gloss_that_one_frame_does_not_know_is_taken_to_be_there(known, state):
    scene, ones = room_with_a_virtual_sphere(), np.ones((3, 4), np.float32)
    survey = run_blocking(survey_path(scene, plan_previs(scene, SESSION)))
    facts = {}
    for frame, roughness in ((1, ones), (2, ones if known else np.nan * ones)):
        captured = frame_of(ones, frame=frame, time_s=frame / 24)
        surfaces = SurfaceFacts(reflectance=ones, transmission=0 * ones, roughness=roughness)
        facts[frame] = facts_of_capture(captured, np.zeros((1, 3)), "key", surfaces, None)
    phone = simulate_phone(choose_phone(scene, survey, SESSION), facts, exposure=1.0)
    assert phone.effects["glossy_dropout"].state == state
