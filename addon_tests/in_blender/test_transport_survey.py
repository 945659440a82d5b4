"""What light can reach, over the frames of a run: animated, hidden, instanced, linked, made by modifiers."""

import bpy
import numpy as np
import pytest
from effect_scenes import ball, ball_node, bright_room, glass, mirror, mixed, shader_look, stage, state, with_ball
from planned_effects import plan_light_transport
from tiny_scenes import (
    add,
    add_instance,
    add_lamp,
    box,
    empty_scene,
    geometry_nodes,
    key,
    linked,
    material,
    node_of,
    phone,
)

from xihe_blender.light_transport import cycles_settings, required_effects, transport_survey
from xihe_blender.light_transport.enclosure import carried, rays_all_round
from xihe_blender.scene.shader_nodes import smoothest_roughness
from xihenet.effects import names_that_are_on


def test_an_emission_driven_at_frame_100_counts_only_if_frame_100_is_rendered():
    scene = with_ball(lambda: shader_look("Flash", "Emission"))
    strength = ball_node(scene, "EMISSION").inputs["Strength"]
    strength.default_value = 0.0
    strength.driver_add("default_value").driver.expression = "frame >= 100"
    assert state(scene, "light tree", frames=[1, 50, 99]) == "off"
    assert state(scene, "light tree", frames=[1, 50, 100]) == "on"


@pytest.mark.parametrize("is_strip", [False, True])
def test_an_animated_mix_factor_counts_over_its_frames(is_strip):
    scene = with_ball(lambda: mixed(0.0))
    factor = ball_node(scene, "MIX_SHADER").inputs[0]
    key(factor, "default_value", {1: 0.0, 10: 0.0, 20: 1.0})
    if is_strip:
        animation = factor.id_data.animation_data
        animation.nla_tracks.new().strips.new("Strip", 1, animation.action)
        animation.action = None
    assert state(scene, "transmission", frames=range(1, 11)) == "off"
    assert state(scene, "transmission", frames=range(1, 13)) == "on"


def test_a_colour_that_is_linked_to_a_number_counts_by_its_luminance():
    scene = with_ball(lambda: mixed(0.5))
    mix = ball_node(scene, "MIX_SHADER")
    colour = mix.id_data.nodes.new("ShaderNodeRGB").outputs[0]
    mix.id_data.links.new(colour, mix.inputs[0])
    for red, expected in ((0.0, "off"), (1.0, "on")):
        colour.default_value = (red, 0.0, 0.0, 1.0)
        assert state(scene, "transmission") == expected
    mirror = mix.id_data.nodes.new("ShaderNodeBsdfGlossy")
    mix.id_data.links.new(colour, mirror.inputs["Roughness"])
    mix.id_data.links.new(mirror.outputs[0], mix.id_data.get_output_node("CYCLES").inputs["Surface"])
    assert smoothest_roughness(scene.objects["Ball"].active_material) == pytest.approx(0.2126)


def test_a_lamp_that_is_keyed_on_later_is_a_second_light():
    scene = stage()
    key(add_lamp(scene, location=(1, 1, 1)).data, "energy", {1: 0.0, 5: 0.0, 6: 10.0})
    assert state(scene, "light tree", frames=range(1, 6)) == "off"
    assert state(scene, "light tree", frames=range(1, 8)) == "on"


def test_a_thing_that_glows_alone_needs_the_light_tree():
    scene = empty_scene()
    phone(scene, (0, -3, 1), (0, 0, 0))
    thing = ball(scene, "Lamp", (0, 0, 0), material("Matt", (0.5, 0.5, 0.5)))
    assert plan_light_transport(scene)["light tree"].reason == "the scene has no light"
    thing.data.materials[0] = shader_look("Glow", "Emission", Strength=3.0)
    needed = plan_light_transport(scene)["light tree"]
    assert needed.state == "on" and "only light is Lamp" in needed.reason
    assert plan_light_transport(stage())["light tree"].reason == "the scene has one light"


def test_a_portal_is_no_lamp():
    scene = stage()
    before = plan_light_transport(scene)
    add_lamp(scene, "AREA").data.cycles.is_portal = True
    assert plan_light_transport(scene) == before


def test_glass_out_of_every_view_but_in_a_mirror_counts():
    scene = with_ball(mirror)
    ball(scene, "Behind the phone", (0, -6, 1), glass())
    assert state(scene, "transmission") == "on"


def test_an_object_counts_where_a_ray_of_a_render_may_meet_it():
    """Also hidden in the viewport, or held out; not where it is hidden in renders, or from all kinds of rays."""
    scene = with_ball(glass)
    item = bpy.data.objects["Ball"]
    item.hide_viewport = True
    item.hide_set(True)
    assert state(scene, "transmission") == "on"
    item.hide_viewport, item.hide_render = False, True
    assert state(scene, "transmission") == "off"
    item.hide_render, item.is_holdout = False, True
    assert state(scene, "transmission") == "on"
    for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter"):
        setattr(item, f"visible_{ray}", False)
    assert state(scene, "transmission") == "off"
    item.visible_glossy = True
    assert state(scene, "transmission") == "on"


def test_what_is_in_an_excluded_collection_is_left_out():
    scene = stage()
    collection = bpy.data.collections.new("Store")
    scene.collection.children.link(collection)
    ball(scene, "Ball", (0.5, 0, 0.35), glass(), collection)
    assert state(scene, "transmission") == "on"
    scene.view_layers[0].layer_collection.children["Store"].exclude = True
    assert state(scene, "transmission") == "off"


@pytest.mark.parametrize("is_subdivided", [False, True])
def test_a_material_slot_that_no_face_uses_is_left_out(is_subdivided):
    scene = stage()
    item = bpy.data.objects["Matt ball"]
    if is_subdivided:
        item.modifiers.new("Subdivision", "SUBSURF")
    item.data.materials.append(glass())
    assert state(scene, "transmission") == "off"
    item.data.polygons[0].material_index = 1
    assert state(scene, "transmission") == "on"
    item.data.polygons[0].material_index = 0
    item.data = bpy.data.meshes.new("Without faces")
    item.data.materials.append(glass())
    assert state(scene, "transmission") == "off"


def test_the_faces_of_a_mesh_are_looked_at_once_for_all_that_show_it(monkeypatch):
    """A forest has thousands of instances of one tree, and they were looked at for each, in each frame."""
    scene, looked, array_of = with_ball(glass), [], transport_survey.array_of
    monkeypatch.setattr(transport_survey, "array_of", lambda *asked: looked.append(asked[1]) or array_of(*asked))
    mesh = bpy.data.objects["Ball"].data
    mesh.materials.append(mirror())
    mesh.polygons[0].material_index = 1
    mesh.polygons[1].material_index = 300  # Beyond the last, which is meant.
    for k in range(5):
        add(scene, f"Copy {k}", mesh, (k, 0, 0))
    assert state(scene, "transmission", frames=[1, 2]) == "on"
    assert looked == 2 * ["material_index"]


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
    empty = add_instance(scene, collection)
    assert state(scene, "transmission") == "on"
    empty.hide_render = True
    assert state(scene, "transmission") == "off"


def test_instances_of_geometry_nodes_count():
    scene = stage()
    hidden = ball(scene, "Vase", (0, 0, 0), glass())
    hidden.hide_render = True
    group, start, end = geometry_nodes()
    points, info = group.nodes.new("GeometryNodeInstanceOnPoints"), group.nodes.new("GeometryNodeObjectInfo")
    info.inputs["Object"].default_value = hidden
    info.inputs["As Instance"].default_value = True
    group.links.new(start, points.inputs["Points"])
    group.links.new(info.outputs["Geometry"], points.inputs["Instance"])
    group.links.new(points.outputs[0], end)
    assert state(scene, "transmission") == "off"
    bpy.data.objects["Floor"].modifiers.new("Place", "NODES").node_group = group
    assert state(scene, "transmission") == "on"


def test_a_material_that_geometry_nodes_set_counts():
    scene = stage()
    group, start, end = geometry_nodes()
    node = group.nodes.new("GeometryNodeSetMaterial")
    node.inputs["Material"].default_value = glass()
    group.links.new(start, node.inputs[0])
    group.links.new(node.outputs[0], end)
    bpy.data.objects["Matt ball"].modifiers.new("Set", "NODES").node_group = group
    assert state(scene, "transmission") == "on"


def test_a_material_from_a_linked_library_is_read(tmp_path):
    scene = with_ball(lambda: material("Chalk"))
    bpy.data.libraries.write(str(tmp_path / "library.blend"), {glass("Library glass")})
    bpy.data.materials.remove(bpy.data.materials["Library glass"])
    (look,) = linked(tmp_path / "library.blend", "materials", "Library glass")
    bpy.data.objects["Ball"].data.materials[0] = look
    assert look.library is not None
    assert "'Library glass'" in plan_light_transport(scene)["transmission"].reason


def test_hair_of_a_particle_system_counts():
    scene = stage()
    bpy.data.objects["Floor"].modifiers.new("Grass", "PARTICLE_SYSTEM")
    settings = bpy.data.objects["Floor"].particle_systems[0].settings
    assert state(scene, "hair") == "off"
    settings.type = "HAIR"
    assert state(scene, "hair") == "on"


def test_an_empty_scene_has_a_plan_with_everything_off():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    plan = plan_light_transport(bpy.context.scene)
    assert names_that_are_on(plan) == set()
    assert dict(cycles_settings(plan))["max_bounces"] == 0


def test_no_ray_of_a_walk_through_glass_leaves_a_closed_room_through_a_corner(monkeypatch):
    made, unspied = [], transport_survey.Solids
    monkeypatch.setattr(transport_survey, "Solids", lambda *given: made.append(unspied(*given)) or made[-1])
    scene = bright_room(0.95)
    box(scene, "Around it", (0, 0, 1.5), (20, 20, 20))
    box(scene, "Show case", (0, 0, 1), (0.4, 0.4, 0.4), glass())
    required_effects(scene, frames=[1])
    for seed in range(30):
        weights, reached = carried(made[0], rays_all_round([(0, 0, 1)]), np.random.default_rng(seed))
        assert weights[0] == 1
        assert all(max(abs(place.x), abs(place.y), abs(place.z - 1.5) + 0.5) <= 2 for place, _ in reached)


def room_with_a_wax_wall(centre, size=(1.0, 0.1, 1.0)):
    """A closed room with the phone, 4 x 4 x 3 m about (0, 0, 1.5), and a wall of wax at `centre`."""
    scene = bright_room()
    box(scene, "Wax wall", centre, size, shader_look("Wax", "BsdfPrincipled", Subsurface_Weight=1.0))
    return scene


OUTSIDE, IN_VIEW, BEHIND_THE_PHONE = (0, 2.5, 1.5), (0, 1.5, 1.2), (-1.2, -1.9, 1.5)
OTHER_ROOM = (10, 0, 1.5)


@pytest.mark.parametrize("centre", [OUTSIDE, (0, 0, -0.6), (30, 0, 1.5)])
def test_a_subsurface_wall_that_no_ray_reaches_is_left_out_and_the_reason_says_so(centre):
    plan = plan_light_transport(room_with_a_wax_wall(centre), positions=[(0, 0, 1)])
    assert plan["subsurface"].state == "off"
    assert "are out of reach: material 'Wax' on 'Wax wall'; no ray from the camera" in plan["subsurface"].reason
    assert "'Wax'" in plan["glossy bounces"].reason, "what a setting switches is left out only where nothing has it"


@pytest.mark.parametrize("centre", [IN_VIEW, BEHIND_THE_PHONE])
@pytest.mark.parametrize("side", [0.02, 0.1])
def test_a_subsurface_wall_in_the_cameras_room_counts_in_view_or_after_a_bounce_however_small(centre, side):
    plan = plan_light_transport(room_with_a_wax_wall(centre, (side,) * 3))
    assert plan["subsurface"].state == "on" and "'Wax wall'" in plan["subsurface"].reason


def test_a_subsurface_wall_that_only_the_probe_sees_counts():
    scene = room_with_a_wax_wall((10, 1.5, 1.5))
    box(scene, "Other room", OTHER_ROOM, (4, 4, 3), inward=True)
    assert state(scene, "subsurface") == "off"
    assert state(scene, "subsurface", positions=[OTHER_ROOM]) == "on"


def test_a_camera_that_passes_the_wall_between_the_frames_of_the_walk_sees_it():
    scene = room_with_a_wax_wall((10, 1.5, 1.5))
    box(scene, "Other room", OTHER_ROOM, (4, 4, 3), inward=True)
    here, there = scene.camera.location.copy(), (10, *scene.camera.location.yz)
    key(scene.camera, "location", {1: here, 3: here, 4: there, 5: here, 9: here})
    assert state(scene, "subsurface", frames=[1, 2, 3, 5, 9]) == "off"
    assert state(scene, "subsurface", frames=range(1, 10)) == "on"


def through_paper(scene):
    scene.objects["Room"].data.materials[0] = shader_look("Paper", "BsdfTranslucent")


def through_a_wall_hidden_from_the_camera(scene):
    scene.objects["Room"].visible_camera = False


def through_a_wall_that_fades(scene):
    look = shader_look("Veil", "BsdfPrincipled")
    scene.objects["Room"].data.materials[0] = look
    alpha = node_of(look, "BSDF_PRINCIPLED").inputs["Alpha"]
    alpha.driver_add("default_value").driver.expression = "frame != 2"


def through_a_wall_that_opens(scene):
    key(scene.objects["Room"], "location", {1: (0, 0, 1.5), 2: (9, 0, 1.5), 3: (0, 0, 1.5)})


@pytest.mark.parametrize(
    "opened",
    [through_paper, through_a_wall_hidden_from_the_camera, through_a_wall_that_fades, through_a_wall_that_opens],
    ids=lambda opened: opened.__name__,
)
def test_subsurface_stays_on_where_rays_cannot_tell(opened):
    scene = room_with_a_wax_wall(OUTSIDE)
    opened(scene)
    assert state(scene, "subsurface", frames=[1, 2, 3, 4, 5]) == "on"


def test_a_phone_that_looks_into_an_empty_sky_reaches_nothing_behind_it():
    scene = empty_scene()
    ball(scene, "Ball", (0, -6, 1), shader_look("Wax", "SubsurfaceScattering"))
    phone(scene, (0, -3, 1), (0, 0, 1))
    assert state(scene, "subsurface") == "off"
    assert state(scene, "subsurface", positions=[(0, 0, 1)]) == "on"


def test_subsurface_of_strands_stays_on_since_no_ray_is_aimed_at_them():
    scene = stage()
    fur = bpy.data.hair_curves.new("Fur")
    fur.add_curves([2])
    fur.materials.append(shader_look("Wax", "SubsurfaceScattering"))
    add(scene, "Fur", fur)
    assert state(scene, "subsurface") == "on"
