"""What changes between two frames is noticed, whatever it is; what stands still is known to stand still."""

import bpy
import pytest
from previs_runs import handler_in
from tiny_scenes import (
    add,
    add_instance,
    add_lamp,
    box,
    geometry_nodes,
    key,
    light_strength,
    material,
    node_of,
    room_with_a_virtual_sphere,
    sphere,
)

from xihe_blender.addon.overlay import forget_positions
from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport.inspection import open_inspection
from xihe_blender.light_transport.render_reuse import SceneState, StateSurvey, each_its_own, plan_render_reuse
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import render_reuse
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.simulated_phone import CaptureNeeds
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.effects import plan_effects

FRAMES = (1, 2)


def still_room():
    """The tiny room with a lamp of Blender's own, and a phone that is not animated."""
    scene = room_with_a_virtual_sphere(2, is_still=True)
    add_lamp(scene, location=(0, 0, 2.5), name="Spot")
    return scene


def scene_states(scene, frames=FRAMES):
    """The state of the scene at each of `frames`."""
    survey = StateSurvey(scene)
    with open_inspection(scene) as inspection:
        for frame in frames:
            inspection.look_at(frame, survey.look_at)
    return list(survey.states.values())


def key_both(owner, name, first=0.0, second=1.0):
    key(owner, name, {1: first, 2: second})


def empty_that_moves(scene):
    empty = add(scene, "Empty")
    key_both(empty, "location", (0, 0, 0.7), (0.01, 0, 0.7))
    return empty


def drive(owner, path, expression):
    owner.driver_add(path).driver.expression = expression


def textured(source=None):
    """Feed the colour of the wood from a new image."""
    look = bpy.data.materials["Wood"]
    node = look.node_tree.nodes.new("ShaderNodeTexImage")
    look.node_tree.links.new(node.outputs["Color"], node_of(look, "BSDF_DIFFUSE").inputs["Color"])
    node.image = bpy.data.images.new("Image", 4, 4)
    if source is not None:
        node.image.source = source


def lamp_of_an_instance(scene):
    """A lamp in a collection that is in no scene but as an instance."""
    inside = bpy.data.collections.new("Inside")
    add_instance(scene, inside)
    return add_lamp(scene, collection=inside)


def scaled_by_nodes(node_type):
    """Give the table a geometry nodes modifier that scales it by what a node of this type gives."""
    tree, start, end = geometry_nodes()
    scaled = tree.nodes.new("GeometryNodeTransform")
    tree.links.new(start, scaled.inputs["Geometry"])
    tree.links.new(tree.nodes.new(node_type).outputs[0], scaled.inputs["Scale"])
    tree.links.new(scaled.outputs[0], end)
    bpy.data.objects["Table"].modifiers.new("Scale", "NODES").node_group = tree


# ------------------------------------------------------------------------------------------- what changes the room


KEYED = {
    "moved object": ('objects["Table"]', "location", (0, 0, 0.7), (0, 0, 0.71)),
    "visibility": ('objects["Table"]', "hide_render", False, True),
    "seen by one kind of ray": ('objects["Table"]', "visible_diffuse", True, False),
    "object colour": ('objects["Table"]', "color", (1, 1, 1, 1), (1, 0, 1, 1)),
    "lamp power": ('lights["Spot"]', "energy", 5.0, 5.01),
    "keyed material": ('materials["Wood"].node_tree.nodes["Diffuse BSDF"].inputs["Roughness"]', "default_value", 0, 1),
    "world": ('worlds["Background"].node_tree.nodes["Background"].inputs["Strength"]', "default_value", 0, 1),
}
"""What is keyed, from bpy.data on, and its values at both frames."""


def parent_that_moves(scene):
    bpy.data.objects["Table"].parent = empty_that_moves(scene)


def constraint(scene):
    bpy.data.objects["Table"].constraints.new("COPY_LOCATION").target = empty_that_moves(scene)


def lamp_nodes(scene):
    lamp = bpy.data.lights["Spot"]
    if lamp.node_tree is None:
        lamp.use_nodes = True
    key_both(node_of(lamp, "EMISSION").inputs["Strength"], "default_value")


def lamp_held_by_the_phone(scene):
    bpy.data.objects["Spot"].parent = scene.camera
    key_both(scene.camera, "location", (-1.2, -1.5, 1.5), (-1.1, -1.5, 1.5))


def group_in_a_group(scene):
    inner, outer = (bpy.data.node_groups.new(n, "ShaderNodeTree") for n in ("Inner", "Outer"))
    value = inner.nodes.new("ShaderNodeValue")
    outer.nodes.new("ShaderNodeGroup").node_tree = inner
    bpy.data.materials["Wood"].node_tree.nodes.new("ShaderNodeGroup").node_tree = outer
    key_both(value.outputs[0], "default_value")


def colour_ramp(scene):
    ramp = bpy.data.materials["Wood"].node_tree.nodes.new("ShaderNodeValToRGB").color_ramp
    key_both(ramp.elements[0], "position", 0.0, 0.2)


def custom_property(scene):
    table = bpy.data.objects["Table"]
    for frame in FRAMES:
        table["dirt"] = 0.5 * frame
        table.keyframe_insert('["dirt"]', frame=frame)


def bent(item):
    """A shape key of an object."""
    item.shape_key_add(name="Basis")
    shape = item.shape_key_add(name="Bent")
    shape.data[0].co.z += 0.1
    return shape


def modifier_that_follows(scene):
    new_modifier("MIRROR").mirror_object = empty_that_moves(scene)


def attribute_of_instances(node_type):
    """Cubes on the table that the wood's shader asks for an attribute, which a node of this type gives."""
    tree, start, end = geometry_nodes()
    points, stored = (
        tree.nodes.new(kind) for kind in ("GeometryNodeInstanceOnPoints", "GeometryNodeStoreNamedAttribute")
    )
    stored.domain, stored.data_type, stored.inputs["Name"].default_value = "INSTANCE", "FLOAT", "glow"
    tree.links.new(start, points.inputs["Points"])
    tree.links.new(tree.nodes.new("GeometryNodeMeshCube").outputs[0], points.inputs["Instance"])
    tree.links.new(points.outputs[0], stored.inputs["Geometry"])
    value = next(socket for socket in stored.inputs if socket.name == "Value" and socket.enabled)
    tree.links.new(tree.nodes.new(node_type).outputs[0], value)
    tree.links.new(stored.outputs[0], end)
    bpy.data.objects["Table"].modifiers.new("Cubes", "NODES").node_group = tree
    look = bpy.data.materials["Wood"].node_tree.nodes.new("ShaderNodeAttribute")
    look.attribute_type, look.attribute_name = "INSTANCER", "glow"


def texture_that_follows_an_empty(scene):
    empty = add(scene, "Origin")
    bpy.data.materials["Wood"].node_tree.nodes.new("ShaderNodeTexCoord").object = empty
    key_both(empty, "rotation_euler", (0, 0, 0), (0, 0, 0.1))


def texture_that_follows_a_virtual_object(scene):
    bpy.data.materials["Wood"].node_tree.nodes.new("ShaderNodeTexCoord").object = bpy.data.objects["Ball"]
    key_both(bpy.data.objects["Ball"], "location", (0, 0, 0.85), (0, 0.1, 0.85))


def new_modifier(kind):
    return bpy.data.objects["Table"].modifiers.new("New", kind)


OTHERWISE_CHANGED = {
    "parent that moves": parent_that_moves,
    "constraint": constraint,
    "lamp nodes": lamp_nodes,
    "lamp in an instance": lambda scene: key_both(lamp_of_an_instance(scene), "location", (0, 0, 2), (0, 0, 2.1)),
    "lamp held by the phone": lamp_held_by_the_phone,
    "driven material": lambda _: drive(light_strength(), "default_value", "frame * 0.5"),
    "group in a group": group_in_a_group,
    "colour ramp": colour_ramp,
    "custom property": custom_property,
    "shape key": lambda _: key_both(bent(bpy.data.objects["Table"]), "value"),
    "setting of a modifier": lambda _: key_both(new_modifier("SOLIDIFY"), "thickness", 0.01, 0.02),
    "modifier that follows": modifier_that_follows,
    "nodes that read the time": lambda _: scaled_by_nodes("GeometryNodeInputSceneTime"),
    "attribute of instances that reads the time": lambda _: attribute_of_instances("GeometryNodeInputSceneTime"),
    "image sequence": lambda _: textured("SEQUENCE"),
    "movie": lambda _: textured("MOVIE"),
    "texture that follows an empty": texture_that_follows_an_empty,
    "texture that follows a virtual object": texture_that_follows_a_virtual_object,
    "particles": lambda _: new_modifier("PARTICLE_SYSTEM"),
}


def assert_room_changes(scene):
    first, second = scene_states(scene)
    assert first.room != second.room


@pytest.mark.parametrize(("path", "name", "first", "second"), KEYED.values(), ids=KEYED)
def test_a_key_that_changes_the_room_is_noticed(path, name, first, second):
    scene = still_room()
    key_both(bpy.data.path_resolve(path), name, first, second)
    assert_room_changes(scene)


@pytest.mark.parametrize("change", OTHERWISE_CHANGED.values(), ids=OTHERWISE_CHANGED)
def test_another_change_of_the_room_is_noticed(change):
    scene = still_room()
    change(scene)
    assert_room_changes(scene)


# -------------------------------------------------------------------------------------------------- what does not


def test_a_scene_that_stands_still_has_one_state():
    scene = still_room()
    bpy.data.objects["Table"].modifiers.new("Smooth", "SUBSURF")
    lamp_of_an_instance(scene)
    scaled_by_nodes("ShaderNodeCombineXYZ")
    textured()
    drive(bpy.data.objects["Table"].modifiers.new("Thick", "SOLIDIFY"), "thickness", "0.01 + 0 * frame")
    bpy.data.objects["Table"].data.attributes.new("Maker", "STRING", "POINT")
    assert len(set(scene_states(scene, (1, 2, 7)))) == 1


@pytest.mark.skipif(bpy.app.version < (4, 5), reason="Python is not shown the instances")
def test_attributes_of_instances_that_stand_still_have_one_state():
    scene = still_room()
    attribute_of_instances("ShaderNodeValue")
    assert len(set(scene_states(scene, (1, 2, 7)))) == 1


def test_keys_that_hold_a_value_change_nothing():
    scene = still_room()
    key_both(bpy.data.objects["Table"], "location", (0, 0, 0.7), (0, 0, 0.7))
    bpy.data.objects["Table"].modifiers.new("Thick", "SOLIDIFY")
    key_both(bpy.data.lights["Spot"], "energy", 5.0, 5.0)
    key_both(scene.camera.data, "lens", 35.0, 35.0)
    drive(light_strength(), "default_value", "6 + 0 * frame")
    assert len(set(scene_states(scene))) == 1


def test_keys_of_settings_that_a_run_sets_itself_change_nothing():
    scene = still_room()
    key_both(scene.cycles, "max_bounces", 12, 1)
    assert len(set(scene_states(scene))) == 1
    with working_scene(scene, "copy", RenderSettings((8, 8), 1)) as copy:
        copy.cycles.max_bounces = 7
        values = []
        for frame in FRAMES:
            copy.frame_set(frame)
            values.append(copy.cycles.max_bounces)
    assert values == [7, 7]


def test_what_comes_back_is_the_same_again():
    scene = still_room()
    key(bpy.data.lights["Spot"], "energy", {1: 5.0, 2: 7.0, 3: 5.0})
    first, second, third = scene_states(scene, (1, 2, 3))
    assert first == third != second


def phone_that_moves(scene):
    key_both(scene.camera, "location", (-1.2, -1.5, 1.5), (-1.1, -1.5, 1.5))


def phone_that_a_marker_switches(scene):
    other = scene.camera.copy()
    other.data = scene.camera.data.copy()
    scene.collection.objects.link(other)
    for frame, camera in zip(FRAMES, (scene.camera, other), strict=True):
        scene.timeline_markers.new("switch", frame=frame).camera = camera


@pytest.mark.parametrize("change", [phone_that_moves, phone_that_a_marker_switches])
def test_another_place_of_the_phone_changes_nothing_but_the_camera(change):
    scene = still_room()
    change(scene)
    first, second = scene_states(scene)
    assert (first.room, first.virtual) == (second.room, second.virtual) and first.camera != second.camera


def test_a_phone_on_a_rail_is_another_camera():
    scene = still_room()
    scene.camera.constraints.new("COPY_LOCATION").target = empty_that_moves(scene)
    first, second = scene_states(scene)
    assert first.camera != second.camera


@pytest.mark.parametrize(
    ("path", "name"), [("", "lens"), ("", "shift_x"), ("dof", "focus_distance"), ("", "clip_start")]
)
def test_a_camera_setting_changes_nothing_but_the_camera(path, name):
    scene = still_room()
    data = scene.camera.data
    key_both(getattr(data, path, data), name, *((30.0, 50.0) if name == "lens" else (0.1, 0.2)))
    first, second = scene_states(scene)
    assert first.room == second.room and first.camera != second.camera


def virtual_object_that_moves(scene):
    key_both(bpy.data.objects["Ball"], "location", (0, 0, 0.85), (0, 0.1, 0.85))


def second_virtual_object(scene):
    added = box(scene, "Box", (0, 0.5, 1), (0.1, 0.1, 0.1), None, virtual_collection(scene))
    key_both(added, "hide_render", False, True)


@pytest.mark.parametrize("change", [virtual_object_that_moves, second_virtual_object])
def test_a_virtual_object_that_changes_changes_nothing_in_the_room(change):
    scene = still_room()
    change(scene)
    first, second = scene_states(scene)
    assert first.room == second.room and first.virtual != second.virtual


def meddle(*_):
    """What an add-on may do in every frame."""


@pytest.mark.parametrize("handler", [meddle, forget_positions])
def test_with_a_handler_no_frame_is_like_another_but_for_that_of_the_panels_overlay(handler):
    scene = still_room()
    with handler_in(bpy.app.handlers.frame_change_post, handler):
        first, second = scene_states(scene)
    assert (first == second) == (handler is forget_positions)


# ------------------------------------------------------------------------------------------------------ what is kept


def test_each_render_is_taken_from_the_first_frame_that_has_it():
    dark, light = SceneState("dark", "v", "here"), SceneState("light", "v", "here")
    elsewhere = SceneState("dark", "v", "there")
    states = dict(enumerate((dark, elsewhere, dark, light, elsewhere), start=1))
    in_view = {1: ["Box"], 2: ["Ball"], 3: ["Ball"], 4: ["Ball"], 5: ["Ball", "Vase"]}
    reuse = plan_render_reuse(states, in_view, {})
    assert reuse.captures == {1: 1, 2: 2, 3: 1, 4: 4, 5: 2}
    assert [reuse.probes[frame, "Ball"] for frame in (2, 3, 4, 5)] == [2, 2, 4, 2]
    assert reuse.probes[5, "Vase"] == 5
    assert reuse.comparison(1, b"a") == reuse.comparison(3, b"a") != reuse.comparison(3, b"b")
    # A frame that is not captured, as one that the phone does not deliver, holds nothing for the others.
    assert plan_render_reuse(states, {3: ["Ball"], 5: ["Ball"]}, {}).captures == {3: 3, 5: 5}
    # A light probe elsewhere is another.
    moved = plan_render_reuse(states, in_view, {3: {"Ball": (0, 0, 1)}, 5: {"Ball": (0, 0, 1)}})
    assert moved.captures == reuse.captures
    assert [moved.probes[frame, "Ball"] for frame in (2, 3, 4, 5)] == [2, 3, 4, 3]


def test_where_nothing_is_known_every_frame_is_rendered():
    reuse = plan_render_reuse(each_its_own((1, 2)), {1: ["Ball"], 2: ["Ball"]}, {})
    assert reuse.captures == {1: 1, 2: 2} and set(reuse.probes.values()) == {1, 2}
    assert reuse.comparison(1, b"a") != reuse.comparison(2, b"a")


def test_shapes_shared_by_the_room_and_a_virtual_object_are_noticed_in_both():
    scene = still_room()
    ball = bpy.data.objects["Ball"]
    key_both(bent(ball), "value")
    sphere(scene, "Twin", (0.5, 0.5, 1.0), 0.1, material("Twin")).data = ball.data
    first, second = scene_states(scene)
    assert first.room != second.room and first.virtual != second.virtual


def test_each_frame_of_a_recording_has_a_capture_of_its_own_where_a_rendered_one_would_serve_for_all():
    scene = room_with_a_virtual_sphere(is_still=True)
    plan, needs = plan_previs(scene, PrevisSettings(frames=(1, 2))), CaptureNeeds(frozenset({1, 2}), frozenset({1, 2}))
    survey = run_blocking(survey_path(scene, plan))
    of_each = [
        render_reuse(survey, plan_effects(survey.required, {}), needs, has_truth=has_truth).captures
        for has_truth in (True, False)
    ]
    assert of_each == [{1: 1, 2: 1}, {1: 1, 2: 2}]
