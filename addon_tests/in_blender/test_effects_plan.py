"""Does the plan switch every effect by what the scene calls for, and judge well what a material hides?"""

import bpy
import numpy as np
import pytest
from effect_scenes import (
    PAIRS,
    add_lamp,
    all_mirror,
    ball,
    bright_room,
    fog,
    glass,
    mirror,
    nodes_of,
    open_field,
    shader_look,
    shader_node,
    stage,
    with_ball,
)
from scene_snapshot import differences, snapshot
from tiny_scenes import box, material, phone, room_with_a_virtual_sphere, set_world

from xihe_blender.effects import plan_effects
from xihe_blender.effects.enclosure import LEFT_OUT, MAX_BOUNCES, N_SURFACES, bounces_needed
from xihe_blender.effects.plan import RULES, everything_on, judge_effects
from xihe_blender.render import RenderSettings, can_denoise, working_scene


def state(scene, effect, **options):
    return plan_effects(scene, **options)[effect].state


@pytest.mark.parametrize("effect", PAIRS)
def test_an_effect_is_on_in_a_scene_that_calls_for_it_and_off_in_one_that_does_not(effect):
    calls_for_it, does_not = PAIRS[effect]
    called = plan_effects(calls_for_it())[effect]
    assert (called.state, called.origin) == ("on", "auto"), called.reason
    left_out = plan_effects(does_not())[effect]
    assert (left_out.state, left_out.origin) == ("off", "auto"), left_out.reason
    assert called.reason != left_out.reason


def test_every_effect_but_fast_gi_has_a_pair_of_scenes():
    assert set(PAIRS) == set(RULES) - {"Fast GI"}


def test_fast_gi_is_never_on_by_itself():
    scene = stage()
    scene.cycles.use_fast_gi = True
    plan = plan_effects(scene)
    assert plan["Fast GI"].state == "off" and "asks for it" in plan["Fast GI"].reason
    assert dict(plan.light_transport)["use_fast_gi"] is False
    assert plan_effects(scene, overrides={"Fast GI": "on"})["Fast GI"].parameters == {"use_fast_gi": True}


def test_the_plan_names_the_material_and_the_object():
    reason = plan_effects(with_ball(lambda: glass("Crystal")))["transmission"].reason
    assert "'Crystal'" in reason and "'Ball'" in reason


def node_of(scene, kind):
    """The node of a type in the material of the ball that `with_ball` put there."""
    return next(node for node in scene.objects["Ball"].data.materials[0].node_tree.nodes if node.type == kind)


# ----------------------------------------------------------------------------------------------------- hidden materials


def mixed(factor, is_linked=False):
    """Chalk and glass, mixed."""
    look = bpy.data.materials.new("Mixed")
    tree, output = nodes_of(look)
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = factor
    tree.links.new(shader_node(tree, "BsdfDiffuse").outputs[0], mix.inputs[1])
    tree.links.new(shader_node(tree, "BsdfGlass").outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    if is_linked:
        tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], mix.inputs[0])
    return look


def grouped(is_connected=True, is_nested=False):
    """A group with glass inside, which its output shows or does not."""
    group = bpy.data.node_groups.new("Group", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, out = shader_node(group, "BsdfGlass"), group.nodes.new("NodeGroupOutput")
    if is_connected:
        group.links.new(inside.outputs[0], out.inputs[0])
    look = bpy.data.materials.new("Grouped")
    tree, output = nodes_of(look)
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = wrapped(group) if is_nested else group
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return look


def wrapped(inner):
    group = bpy.data.node_groups.new("Outer", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    node, out = group.nodes.new("ShaderNodeGroup"), group.nodes.new("NodeGroupOutput")
    node.node_tree = inner
    group.links.new(node.outputs[0], out.inputs[0])
    return group


def grouped_by_factor(factor):
    """A group that mixes chalk and glass by a factor that is set outside it."""
    group = bpy.data.node_groups.new("By factor", "ShaderNodeTree")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    group.interface.new_socket("Glass", in_out="INPUT", socket_type="NodeSocketFloat")
    inside, out = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    mix = group.nodes.new("ShaderNodeMixShader")
    group.links.new(inside.outputs["Glass"], mix.inputs[0])
    group.links.new(shader_node(group, "BsdfDiffuse").outputs[0], mix.inputs[1])
    group.links.new(shader_node(group, "BsdfGlass").outputs[0], mix.inputs[2])
    group.links.new(mix.outputs[0], out.inputs[0])
    look = bpy.data.materials.new("Grouped by factor")
    tree, output = nodes_of(look)
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Glass"].default_value = factor
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return look


def muted_glass():
    look = glass()
    next(node for node in look.node_tree.nodes if node.type == "BSDF_GLASS").mute = True
    return look


def muted_link():
    look = glass()
    look.node_tree.links[0].is_muted = True
    return look


def muted_mix():
    """A muted mix lets its first shader through, whatever its factor."""
    look = mixed(1.0)
    next(node for node in look.node_tree.nodes if node.type == "MIX_SHADER").mute = True
    return look


def rerouted():
    look = glass()
    tree, output = look.node_tree, look.node_tree.get_output_node("CYCLES")
    first, second = tree.nodes.new("NodeReroute"), tree.nodes.new("NodeReroute")
    shader = next(node for node in tree.nodes if node.type == "BSDF_GLASS")
    tree.links.new(shader.outputs[0], first.inputs[0])
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
    "Principled without transmission": (lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=0.0), "off"),
    "Principled, half transmissive": (lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=0.5), "on"),
    "Principled transmission under metal": (
        lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=1.0, Metallic=1.0),
        "off",
    ),
    "Principled transmission of a surface with alpha 0": (
        lambda: shader_look("P", "BsdfPrincipled", Transmission_Weight=1.0, Alpha=0.0),
        "off",
    ),
}


@pytest.mark.parametrize("case", MATERIALS)
def test_a_material_is_judged_by_what_reaches_its_output(case):
    make, expected = MATERIALS[case]
    assert state(with_ball(make), "transmission") == expected


@pytest.mark.parametrize(("density", "expected"), [(0.0, "off"), (0.1, "on")])
def test_a_volume_counts_by_its_density(density, expected):
    scene = with_ball(fog)
    node_of(scene, "VOLUME_SCATTER").inputs["Density"].default_value = density
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


# ----------------------------------------------------------------------------------------------------------------- time


def test_an_emission_driven_at_frame_100_counts_only_if_frame_100_is_rendered():
    scene = with_ball(lambda: shader_look("Flash", "Emission"))
    strength = node_of(scene, "EMISSION").inputs["Strength"]
    strength.default_value = 0.0
    strength.driver_add("default_value").driver.expression = "frame >= 100"
    assert state(scene, "light tree", frames=[1, 50, 99]) == "off"
    assert state(scene, "light tree", frames=[1, 50, 100]) == "on"


def test_an_animated_mix_factor_counts_over_its_frames():
    scene = with_ball(lambda: mixed(0.0))
    factor = node_of(scene, "MIX_SHADER").inputs[0]
    for frame, value in ((1, 0.0), (10, 0.0), (20, 1.0)):
        factor.default_value = value
        factor.keyframe_insert("default_value", frame=frame)
    assert state(scene, "transmission", frames=range(1, 11)) == "off"
    assert state(scene, "transmission", frames=range(1, 13)) == "on"


def test_a_lamp_that_is_keyed_on_later_is_a_second_light():
    scene = stage()
    data = add_lamp(scene, (1, 1, 1)).data
    for frame, power in ((1, 0.0), (5, 0.0), (6, 10.0)):
        data.energy = power
        data.keyframe_insert("energy", frame=frame)
    assert state(scene, "light tree", frames=range(1, 6)) == "off"
    assert state(scene, "light tree", frames=range(1, 8)) == "on"


# --------------------------------------------------------------------------------------------------- what is reachable


def test_glass_out_of_every_view_but_in_a_mirror_counts():
    scene = with_ball(mirror)
    ball(scene, "Behind the phone", (0, -6, 1), glass())
    assert state(scene, "transmission") == "on"


def test_hidden_in_the_viewport_is_not_hidden_in_renders():
    scene = with_ball(glass)
    item = bpy.data.objects["Ball"]
    item.hide_viewport = True
    item.hide_set(True)
    assert state(scene, "transmission") == "on"
    item.hide_viewport, item.hide_render = False, True
    assert state(scene, "transmission") == "off"


def test_what_is_in_an_excluded_collection_is_left_out():
    scene = stage()
    collection = bpy.data.collections.new("Store")
    scene.collection.children.link(collection)
    ball(scene, "Ball", (0.5, 0, 0.35), glass(), collection)
    assert state(scene, "transmission") == "on"
    scene.view_layers[0].layer_collection.children["Store"].exclude = True
    assert state(scene, "transmission") == "off"


def test_a_holdout_is_still_seen_by_other_surfaces():
    scene = with_ball(glass)
    bpy.data.objects["Ball"].is_holdout = True
    assert state(scene, "transmission") == "on"


def test_an_object_that_no_ray_meets_is_left_out():
    scene = with_ball(glass)
    item = bpy.data.objects["Ball"]
    for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
        setattr(item, f"visible_{ray}", False)
    assert state(scene, "transmission") == "off"
    item.visible_glossy = True
    assert state(scene, "transmission") == "on"


def test_a_material_slot_that_no_face_uses_is_left_out():
    scene = stage()
    mesh = bpy.data.objects["Matt ball"].data
    mesh.materials.append(glass())
    assert state(scene, "transmission") == "off"
    mesh.polygons[0].material_index = 1
    assert state(scene, "transmission") == "on"


def test_a_slot_that_no_face_uses_is_left_out_of_a_subdivided_mesh_as_well():
    scene = stage()
    item = bpy.data.objects["Matt ball"]
    item.modifiers.new("Subdivision", "SUBSURF")
    item.data.materials.append(glass())
    assert state(scene, "transmission") == "off"
    item.data.polygons[0].material_index = 1
    assert state(scene, "transmission") == "on"


def test_a_material_linked_to_the_object_wins_over_the_meshs():
    scene = with_ball(glass)
    slot = bpy.data.objects["Ball"].material_slots[0]
    slot.link = "OBJECT"
    slot.material = material("Chalk")
    assert state(scene, "transmission") == "off"


def test_an_instanced_collection_counts_although_the_scene_does_not_hold_it():
    scene = stage()
    collection = bpy.data.collections.new("Asset")
    ball(scene, "Vase", (0, 0, 0), glass(), collection)
    assert state(scene, "transmission") == "off"
    empty = bpy.data.objects.new("Placed", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    scene.collection.objects.link(empty)
    assert state(scene, "transmission") == "on"
    empty.hide_render = True
    assert state(scene, "transmission") == "off"


def test_instances_of_geometry_nodes_count():
    scene = stage()
    hidden = ball(scene, "Vase", (0, 0, 0), glass())
    hidden.hide_render = True
    group = bpy.data.node_groups.new("Place", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    out, points = group.nodes.new("NodeGroupOutput"), group.nodes.new("GeometryNodeInstanceOnPoints")
    source, info = group.nodes.new("NodeGroupInput"), group.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = hidden
    info.inputs["As Instance"].default_value = True
    group.links.new(source.outputs[0], points.inputs["Points"])
    group.links.new(info.outputs["Geometry"], points.inputs["Instance"])
    group.links.new(points.outputs[0], out.inputs[0])
    assert state(scene, "transmission") == "off"
    bpy.data.objects["Floor"].modifiers.new("Place", "NODES").node_group = group
    assert state(scene, "transmission") == "on"


def test_a_material_that_geometry_nodes_set_counts():
    scene = stage()
    group = bpy.data.node_groups.new("Set", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    node = group.nodes.new("GeometryNodeSetMaterial")
    node.inputs["Material"].default_value = glass()
    group.links.new(group.nodes.new("NodeGroupInput").outputs[0], node.inputs[0])
    group.links.new(node.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    bpy.data.objects["Matt ball"].modifiers.new("Set", "NODES").node_group = group
    assert state(scene, "transmission") == "on"


def test_a_material_from_a_linked_library_is_read(tmp_path):
    scene = with_ball(lambda: material("Chalk"))
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {glass("Library glass")})
    bpy.data.materials.remove(bpy.data.materials["Library glass"])
    with bpy.data.libraries.load(str(tmp_path / "library.blend"), link=True) as (_, wanted):
        wanted.materials = ["Library glass"]
    bpy.data.objects["Ball"].data.materials[0] = wanted.materials[0]
    assert wanted.materials[0].library is not None
    assert "'Library glass'" in plan_effects(scene)["transmission"].reason


def test_hair_of_a_particle_system_counts():
    scene = stage()
    bpy.data.objects["Floor"].modifiers.new("Grass", "PARTICLE_SYSTEM")
    settings = bpy.data.objects["Floor"].particle_systems[0].settings
    assert state(scene, "hair") == "off"
    settings.type = "HAIR"
    assert state(scene, "hair") == "on"


def test_an_empty_scene_has_a_plan_with_everything_off():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plan = plan_effects(bpy.context.scene)
    assert {effect.name for effect in plan.effects if effect.state == "on"} == set()
    assert dict(plan.light_transport)["max_bounces"] == 0


# -------------------------------------------------------------------------------------------------------------- bounces


def bounces(scene, positions=()):
    return plan_effects(scene, positions=positions)["diffuse bounces"].parameters["diffuse_bounces"]


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


# ------------------------------------------------------------------------------------------------------------ the plan


def test_planning_changes_nothing_in_the_file():
    scene = room_with_a_virtual_sphere()
    scene.frame_set(2)
    before = snapshot()
    plan_effects(scene)
    assert differences(before, snapshot()) == ({}, [])


def test_light_goes_on_behind_lamps_unless_the_user_wants_none_of_it():
    scene = stage()
    left_out = plan_effects(scene)["transparency"]
    unwanted = plan_effects(scene, overrides={"transparency": "off"})["transparency"]
    assert (left_out.state, left_out.parameters) == ("off", {"transparent_max_bounces": MAX_BOUNCES})
    assert unwanted.parameters == {"transparent_max_bounces": 0}
    assert plan_effects(stage(lamp=False))["transparency"].parameters == {"transparent_max_bounces": 0}


def test_settings_of_the_plan_arrive_in_a_working_scene():
    scene = with_ball(glass)
    plan = plan_effects(scene)
    with working_scene(scene, "Planned", RenderSettings((8, 8), 1, light_transport=plan.light_transport)) as working:
        for name, value in plan.light_transport:
            assert getattr(working.render if name == "use_motion_blur" else working.cycles, name) == value
    assert dict(plan.light_transport)["transmission_bounces"] == MAX_BOUNCES
    assert dict(plan.light_transport)["volume_bounces"] == 0


def test_a_plan_survives_json():
    plan = plan_effects(with_ball(glass), overrides={"volumes": "on"})
    assert type(plan).from_json(plan.as_json()) == plan


def test_everything_on_leaves_no_effect_out():
    scene = stage()
    settings = dict(everything_on(scene, judge_effects(scene)).light_transport)
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
    assert plan_effects(scene, other)["depth of field"].state == "on"


def test_a_world_of_a_view_layer_is_the_one_that_is_judged():
    scene = stage(lamp=False)
    assert state(scene, "denoising") == "off"
    lit = set_world(scene, (1, 1, 1))
    set_world(scene)
    scene.view_layers[0].world_override = lit
    assert state(scene, "denoising") == "on"


def test_all_mirrors_have_no_matt_surface():
    assert "no matt" in plan_effects(all_mirror())["reflective caustics"].reason
