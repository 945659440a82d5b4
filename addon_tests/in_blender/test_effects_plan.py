"""Does the plan switch every effect by what the scene calls for, as far as it is called for, and keep what it says?"""

from functools import partial

import bpy
import numpy as np
import pytest
from effect_scenes import (
    PAIRS,
    all_mirror,
    ball,
    ball_node,
    bright_room,
    fog,
    glass,
    mix_of_chalk_and_glass,
    mixed,
    nodes_of,
    open_field,
    shader_look,
    shader_node,
    stage,
    state,
    with_ball,
)
from planned_effects import everything_on, plan_light_transport
from tiny_scenes import add_instance, box, material, node_of, phone, set_world

from xihe_blender.capture.render import RenderSettings, can_denoise, working_scene
from xihe_blender.light_transport import cycles_settings, required_effects
from xihe_blender.light_transport.enclosure import LEFT_OUT, MAX_BOUNCES, N_SURFACES, bounces_needed
from xihe_blender.light_transport.rules import RULES


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


def test_every_effect_but_fast_gi_which_is_never_on_by_itself_has_a_pair_of_scenes():
    assert set(PAIRS) == set(RULES) - {"Fast GI"}
    scene = stage()
    scene.cycles.use_fast_gi = True
    plan = plan_light_transport(scene)
    assert plan["Fast GI"].state == "off" and "switched on, but" in plan["Fast GI"].reason
    assert dict(cycles_settings(plan))["use_fast_gi"] is False
    assert plan_light_transport(scene, overrides={"Fast GI": "on"})["Fast GI"].parameters == {"use_fast_gi": True}


def bounces(scene, positions=()):
    return plan_light_transport(scene, positions=positions)["diffuse bounces"].parameters["diffuse_bounces"]


def test_a_brighter_closed_room_needs_more_bounces_and_open_ground_two():
    dark, middle, bright = (bounces(bright_room(albedo)) for albedo in (0.1, 0.4, 0.8))
    assert 2 <= dark < middle < bright
    assert bright >= 8
    assert bounces(open_field()) == 2


def test_a_room_in_other_units_inside_out_or_around_a_virtual_object_that_hides_it_needs_as_many_bounces():
    scene = bright_room(0.6)
    closed = bounces(scene)
    collection = bpy.data.collections.new("Xihe Virtual")
    scene.collection.children.link(collection)
    ball(scene, "Around the phone", scene.camera.location, material("Black", (0, 0, 0)), collection)
    assert bounces(scene) == closed
    bpy.data.objects["Room"].data.flip_normals()
    assert bounces(scene) == closed
    scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", 10.0
    assert bounces(scene) == closed


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
    empty = add_instance(scene, collection)
    empty.rotation_euler.z, empty.scale = 0.5, (1.2, 1.2, 1.2)
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
    assert albedo**needed > LEFT_OUT
    # Nothing in sight needs the fewest.
    assert bounces_needed(np.zeros(N_SURFACES)) == 2


def test_light_goes_on_behind_lamps_unless_the_user_wants_none_of_it():
    scene = stage()
    left_out = plan_light_transport(scene)["transparency"]
    unwanted = plan_light_transport(scene, overrides={"transparency": "off"})["transparency"]
    assert (left_out.state, left_out.parameters) == ("off", {"transparent_max_bounces": MAX_BOUNCES})
    assert unwanted.parameters == {"transparent_max_bounces": 0}
    assert plan_light_transport(stage(lamp=False))["transparency"].parameters == {"transparent_max_bounces": 0}


@pytest.mark.skipif(bpy.app.version < (5, 2), reason="the Principled shader has no thin walls")
@pytest.mark.parametrize(("transmission", "expected"), [(1.0, "on"), (0.0, "off")])
def test_light_of_lamps_goes_straight_through_a_thin_wall_that_transmits(transmission, expected):
    """Without transparency a room behind such a pane is black where a panel shines through it."""
    pane = partial(shader_look, "Pane", "BsdfPrincipled", Transmission_Weight=transmission, Thin_Wall=True)
    assert state(with_ball(pane), "transparency") == expected


def test_settings_of_the_plan_arrive_in_a_working_scene():
    scene = with_ball(glass)
    plan = plan_light_transport(scene)
    with working_scene(scene, "Planned", RenderSettings((8, 8), 1, light_transport=cycles_settings(plan))) as working:
        for name, value in cycles_settings(plan):
            assert getattr(working.render if name == "use_motion_blur" else working.cycles, name) == value
    assert dict(cycles_settings(plan))["transmission_bounces"] == MAX_BOUNCES
    assert dict(cycles_settings(plan))["volume_bounces"] == 0


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


def test_a_camera_that_is_not_the_scenes_is_not_judged():
    scene = stage()
    own = scene.camera
    other = phone(scene, (0, -2, 1), (0, 0, 0), name="Other")
    other.data.dof.use_dof = True
    scene.camera = own
    assert state(scene, "depth of field") == "off"
    scene.camera = other
    assert state(scene, "depth of field") == "on"


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


# ---------------------------------------------------------------------- materials, judged by what reaches their output


def shader_group():
    """A new group, and the socket of its output."""
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    return group, group.nodes.new("NodeGroupOutput").inputs[0]


def look_of_group(group):
    look = bpy.data.materials.new("Grouped")
    tree, output = nodes_of(look)
    tree.links.new(group_node(tree, group).outputs[0], output.inputs["Surface"])
    return look


def group_node(tree, group):
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    return node


def grouped(is_connected=True, is_nested=False):
    """A group with glass inside, which its output shows or does not."""
    group, shown = shader_group()
    inside = shader_node(group, "BsdfGlass")
    if is_connected:
        group.links.new(inside.outputs[0], shown)
    if is_nested:
        outer, shown = shader_group()
        outer.links.new(group_node(outer, group).outputs[0], shown)
        group = outer
    return look_of_group(group)


def grouped_by_factor(factor):
    """A group that mixes chalk and glass by a factor that is set outside it."""
    group, shown = shader_group()
    group.interface.new_socket("Glass", in_out="INPUT", socket_type="NodeSocketFloat")
    mix = mix_of_chalk_and_glass(group)
    group.links.new(group.nodes.new("NodeGroupInput").outputs["Glass"], mix.inputs[0])
    group.links.new(mix.outputs[0], shown)
    look = look_of_group(group)
    node_of(look, "GROUP").inputs["Glass"].default_value = factor
    return look


def muted_glass():
    look = glass()
    node_of(look, "BSDF_GLASS").mute = True
    return look


def muted_link():
    look = glass()
    look.node_tree.links[0].is_muted = True
    return look


def muted_mix():
    """A muted mix lets its first shader through, whatever its factor."""
    look = mixed(1.0)
    node_of(look, "MIX_SHADER").mute = True
    return look


def rerouted():
    look = glass()
    tree, output = look.node_tree, look.node_tree.get_output_node("CYCLES")
    first, second = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    tree.links.new(node_of(look, "BSDF_GLASS").outputs[0], first.inputs[0])
    tree.links.new(first.outputs[0], second.inputs[0])
    tree.links.new(second.outputs[0], output.inputs["Surface"])
    return look


def in_an_unused_output():
    """Glass at an output that is not the active one."""
    look = material("Chalk")
    tree = look.node_tree
    tree.links.new(shader_node(tree, "BsdfGlass").outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[0])
    tree.get_output_node("CYCLES").is_active_output = True
    return look


def principled(transmission, **inputs):
    return shader_look("Principled", "BsdfPrincipled", Transmission_Weight=transmission, **inputs)


def beside_the_output():
    look = material("Chalk")
    shader_node(look.node_tree, "BsdfGlass")
    return look


MATERIALS = {
    "transmission behind a mix at factor 0": (lambda: mixed(0.0), "off"),
    "transmission behind a mix at factor 1": (lambda: mixed(1.0), "on"),
    "transmission behind a mix by a texture": (lambda: mixed(0.0, is_linked=True), "on"),
    "glass in a group": (grouped, "on"),
    "glass in a group in a group": (lambda: grouped(is_nested=True), "on"),
    "glass in a group that shows nothing of it": (lambda: grouped(is_connected=False), "off"),
    "glass in a group by a factor of 0": (lambda: grouped_by_factor(0.0), "off"),
    "glass in a group by a factor of a half": (lambda: grouped_by_factor(0.5), "on"),
    "a muted glass node": (muted_glass, "off"),
    "a muted link": (muted_link, "off"),
    "glass as the second shader of a muted mix": (muted_mix, "off"),
    "glass behind two reroutes": (rerouted, "on"),
    "glass at an output that is not active": (in_an_unused_output, "off"),
    "glass that nothing is linked to": (beside_the_output, "off"),
    "black glass": (lambda: shader_look("Black", "BsdfGlass", Color=(0, 0, 0, 1)), "off"),
    "Principled without transmission": (lambda: principled(0.0), "off"),
    "Principled, half transmissive": (lambda: principled(0.5), "on"),
    "Principled transmission under metal": (lambda: principled(1.0, Metallic=1.0), "off"),
    "Principled transmission of a surface with alpha 0": (lambda: principled(1.0, Alpha=0.0), "off"),
}


@pytest.mark.parametrize("case", MATERIALS)
def test_a_material_is_judged_by_what_reaches_its_output(case):
    make, expected = MATERIALS[case]
    assert state(with_ball(make), "transmission") == expected


@pytest.mark.parametrize(("density", "expected"), [(0.0, "off"), (0.1, "on")])
def test_a_volume_counts_by_its_density(density, expected):
    scene = with_ball(fog)
    ball_node(scene, "VOLUME_SCATTER").inputs["Density"].default_value = density
    assert state(scene, "volumes") == expected


def test_a_volume_in_an_unused_output_is_left_out():
    scene = with_ball(lambda: material("Chalk"))
    tree = bpy.data.objects["Ball"].data.materials[0].node_tree
    unused = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader_node(tree, "VolumeScatter").outputs[0], unused.inputs["Volume"])
    tree.get_output_node("CYCLES").is_active_output = True
    unused.is_active_output = False
    assert state(scene, "volumes") == "off"
    unused.is_active_output = True
    assert state(scene, "volumes") == "on"


def test_a_world_full_of_haze_is_a_volume():
    scene = stage()
    tree, output = nodes_of(scene.world)
    tree.links.new(shader_node(tree, "VolumeScatter", Density=0.01).outputs[0], output.inputs["Volume"])
    assert state(scene, "volumes") == "on"
