"""Does the plan switch every effect by what the scene calls for, as far as it is called for, and keep what it says?"""

import bpy
import numpy as np
import pytest
from effect_scenes import (
    PAIRS,
    all_mirror,
    ball,
    bright_room,
    glass,
    open_field,
    stage,
    state,
    with_ball,
)
from scene_snapshot import differences, snapshot
from tiny_scenes import box, material, phone, room_with_a_virtual_sphere, set_world

from xihe_blender.capture.render import RenderSettings, can_denoise, working_scene
from xihe_blender.light_transport import cycles_settings, plan_light_transport, required_effects
from xihe_blender.light_transport.enclosure import LEFT_OUT, MAX_BOUNCES, N_SURFACES, bounces_needed
from xihe_blender.light_transport.plan import everything_on
from xihe_blender.light_transport.rules import RULES
from xihenet.effects import effects_as_json, effects_from_json


@pytest.mark.parametrize(
    "effect", [pytest.param(e, marks=pytest.mark.needs_denoiser) if e == "denoising" else e for e in PAIRS]
)
def test_an_effect_is_on_in_a_scene_that_calls_for_it_and_off_in_one_that_does_not(effect):
    calls_for_it, does_not = PAIRS[effect]
    called = plan_light_transport(calls_for_it())[effect]
    assert (called.state, called.origin) == ("on", "auto"), called.reason
    left_out = plan_light_transport(does_not())[effect]
    assert (left_out.state, left_out.origin) == ("off", "auto"), left_out.reason
    assert called.reason != left_out.reason


def test_every_effect_but_fast_gi_has_a_pair_of_scenes():
    assert set(PAIRS) == set(RULES) - {"Fast GI"}


def test_fast_gi_is_never_on_by_itself():
    scene = stage()
    scene.cycles.use_fast_gi = True
    plan = plan_light_transport(scene)
    assert plan["Fast GI"].state == "off" and "switched on, but" in plan["Fast GI"].reason
    assert dict(cycles_settings(plan))["use_fast_gi"] is False
    assert plan_light_transport(scene, overrides={"Fast GI": "on"})["Fast GI"].parameters == {"use_fast_gi": True}


def test_the_plan_names_the_material_and_the_object():
    reason = plan_light_transport(with_ball(lambda: glass("Crystal")))["transmission"].reason
    assert "'Crystal'" in reason and "'Ball'" in reason


def bounces(scene, positions=()):
    return plan_light_transport(scene, positions=positions)["diffuse bounces"].parameters["diffuse_bounces"]


def test_a_brighter_closed_room_needs_more_bounces_and_open_ground_two():
    dark, middle, bright = (bounces(bright_room(albedo)) for albedo in (0.1, 0.4, 0.8))
    assert 2 <= dark < middle < bright
    assert bright >= 8
    assert bounces(open_field()) == 2


def test_walls_hidden_in_the_viewport_close_the_room_all_the_same():
    scene = bright_room(0.6)
    closed = bounces(scene)
    bpy.data.objects["Room"].hide_viewport = True
    bpy.data.objects["Room"].hide_set(True)
    assert bounces(scene) == closed


def test_a_room_that_is_an_instance_is_as_closed():
    scene = bright_room(0.6)
    closed, room = bounces(scene), bpy.data.objects["Room"]
    collection = bpy.data.collections.new("Asset")
    collection.objects.link(room)
    scene.collection.objects.unlink(room)
    empty = bpy.data.objects.new("Placed", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.rotation_euler.z, empty.scale = 0.5, (1.2, 1.2, 1.2)
    scene.collection.objects.link(empty)
    assert abs(bounces(scene) - closed) <= 2


def test_a_room_without_its_walls_needs_fewer_bounces():
    scene = bright_room(0.8)
    closed = bounces(scene)
    bpy.data.objects["Room"].hide_render = True
    box(scene, "Ground", (0, 0, -0.1), (4, 4, 0.2), material("Walls again", (0.8, 0.8, 0.8)))
    assert bounces(scene) < closed / 2


def test_the_inside_of_a_virtual_object_is_no_room():
    scene = open_field()
    collection = bpy.data.collections.new("Xihe Virtual")
    scene.collection.children.link(collection)
    ball(scene, "Behind the phone", (0, -3.4, 0.3), material("White", (1, 1, 1)), collection)
    box(scene, "More ground", (0, -4, -0.1), (4, 4, 0.2), material("Chalk"))
    assert bounces(scene, positions=[(0, -3.4, 0.3)]) == 2


@pytest.mark.parametrize("albedo", [0.2, 0.5, 0.7, 0.85])
def test_in_a_room_that_glows_all_over_the_bounces_leave_out_next_to_nothing(albedo):
    weights = albedo ** np.arange(N_SURFACES)
    needed = bounces_needed(weights)
    left_out = albedo ** (needed + 1)
    assert left_out <= LEFT_OUT or needed == MAX_BOUNCES
    assert albedo**needed > LEFT_OUT or needed == 2


def test_nothing_in_sight_needs_the_fewest_bounces():
    assert bounces_needed(np.zeros(N_SURFACES)) == 2


def test_planning_changes_nothing_in_the_file():
    scene = room_with_a_virtual_sphere()
    scene.frame_set(2)
    before = snapshot()
    plan_light_transport(scene)
    assert differences(before, snapshot()) == ({}, [])


def test_light_goes_on_behind_lamps_unless_the_user_wants_none_of_it():
    scene = stage()
    left_out = plan_light_transport(scene)["transparency"]
    unwanted = plan_light_transport(scene, overrides={"transparency": "off"})["transparency"]
    assert (left_out.state, left_out.parameters) == ("off", {"transparent_max_bounces": MAX_BOUNCES})
    assert unwanted.parameters == {"transparent_max_bounces": 0}
    assert plan_light_transport(stage(lamp=False))["transparency"].parameters == {"transparent_max_bounces": 0}


def test_settings_of_the_plan_arrive_in_a_working_scene():
    scene = with_ball(glass)
    plan = plan_light_transport(scene)
    with working_scene(scene, "Planned", RenderSettings((8, 8), 1, light_transport=cycles_settings(plan))) as working:
        for name, value in cycles_settings(plan):
            assert getattr(working.render if name == "use_motion_blur" else working.cycles, name) == value
    assert dict(cycles_settings(plan))["transmission_bounces"] == MAX_BOUNCES
    assert dict(cycles_settings(plan))["volume_bounces"] == 0


def test_a_plan_survives_json():
    plan = plan_light_transport(with_ball(glass), overrides={"volumes": "on"})
    kept = effects_from_json(effects_as_json(plan))
    assert cycles_settings(kept) == cycles_settings(plan) and effects_as_json(kept) == effects_as_json(plan)


def test_everything_on_leaves_no_effect_out():
    scene = stage()
    settings = dict(cycles_settings(everything_on(scene, required_effects(scene))))
    kinds = ("diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces", "transparent_max_bounces")
    assert {settings[kind] for kind in (*kinds, "max_bounces")} == {MAX_BOUNCES}
    assert settings["caustics_reflective"] and settings["caustics_refractive"] and settings["use_light_tree"]
    assert not settings["use_fast_gi"] and not settings["use_motion_blur"]


def test_denoising_is_planned_only_where_the_build_can():
    scene = stage()
    with working_scene(scene, "Ask", RenderSettings((4, 4), 1)) as working:
        expected = "on" if can_denoise(working) else "off"
    assert state(scene, "denoising") == expected


def test_a_camera_of_ones_own_is_judged_instead_of_the_scenes():
    scene = stage()
    own = scene.camera
    other = phone(scene, (0, -2, 1), (0, 0, 0), name="Other")
    other.data.dof.use_dof = True
    scene.camera = own
    assert state(scene, "depth of field") == "off"
    assert plan_light_transport(scene, other)["depth of field"].state == "on"


@pytest.mark.needs_denoiser
def test_a_world_of_a_view_layer_is_the_one_that_is_judged():
    scene = stage(lamp=False)
    assert state(scene, "denoising") == "off"
    lit = set_world(scene, (1, 1, 1))
    set_world(scene)
    scene.view_layers[0].world_override = lit
    assert state(scene, "denoising") == "on"


def test_all_mirrors_have_no_matt_surface():
    assert "no matt" in plan_light_transport(all_mirror())["reflective caustics"].reason
