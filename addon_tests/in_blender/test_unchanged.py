"""What changes between two frames is noticed, whatever it is; what stands still is known to stand still."""

import bpy
import numpy as np
import pytest
from tiny_scenes import box, look_at, material, room_with_a_virtual_sphere, sphere

from xihe_blender.addon.overlay import forget_positions
from xihe_blender.light_transport.inspection import open_inspection
from xihe_blender.light_transport.render_reuse import SceneState, StateSurvey, each_its_own, plan_render_reuse
from xihe_blender.scene.virtual_objects import virtual_collection

FRAMES = (1, 2)


def still_room():
    """The tiny room with a lamp of Blender's own, and a phone that is not animated."""
    scene = room_with_a_virtual_sphere(2)
    scene.camera.animation_data_clear()
    lamp = bpy.data.objects.new("Spot", bpy.data.lights.new("Spot", "POINT"))
    lamp.location = (0, 0, 2.5)
    scene.collection.objects.link(lamp)
    return scene


def scene_states(scene, frames):
    """The state of the scene at each of `frames`."""
    survey = StateSurvey(scene)
    with open_inspection(scene) as inspection:
        for frame in frames:
            inspection.look_at(frame, survey.look_at)
    return list(survey.states.values())


def key(owner, path, values=(0.0, 1.0)):
    """Key a property to one value at frame 1 and to another at frame 2."""
    holder, _, name = path.rpartition(".")
    struct = owner.path_resolve(holder) if holder else owner
    for frame, value in zip(FRAMES, values, strict=True):
        setattr(struct, name, value)
        struct.keyframe_insert(name, frame=frame)


def drive(owner, path, expression="frame"):
    owner.driver_add(path).driver.expression = expression


def nodes_of(name):
    return bpy.data.materials[name].node_tree.nodes


def textured(scene, name="Wood"):
    """Feed the colour of a material from a new image texture; its node."""
    tree = bpy.data.materials[name].node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    shader = next(n for n in tree.nodes if n.type == "BSDF_DIFFUSE")
    tree.links.new(node.outputs["Color"], shader.inputs["Color"])
    return node


def collection_instance(scene):
    """An instance of a collection that is in no scene, with a lamp in it; the lamp."""
    inside = bpy.data.collections.new("Inside")
    lamp = bpy.data.objects.new("Instanced", bpy.data.lights.new("Instanced", "POINT"))
    inside.objects.link(lamp)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", inside
    scene.collection.objects.link(instance)
    return lamp


def grown_by_nodes(scene, build):
    """Give the table a geometry nodes modifier; `build(tree)` gives the socket for the scale of its geometry."""
    tree = bpy.data.node_groups.new("Grow", "GeometryNodeTree")
    for name, direction in (("Geometry", "INPUT"), ("Out", "OUTPUT")):
        tree.interface.new_socket(name, in_out=direction, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    grow = tree.nodes.new("GeometryNodeTransform")
    tree.links.new(start.outputs[0], grow.inputs["Geometry"])
    tree.links.new(build(tree), grow.inputs["Scale"])
    tree.links.new(grow.outputs[0], end.inputs[0])
    bpy.data.objects["Table"].modifiers.new("Grow", "NODES").node_group = tree


# ------------------------------------------------------------------------------------------- what changes the room


def moved_object(scene):
    key(bpy.data.objects["Table"], "location", ((0, 0, 0.7), (0, 0, 0.71)))


def parent_that_moves(scene):
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    bpy.data.objects["Table"].parent = parent
    key(parent, "location", ((0, 0, 0), (0.01, 0, 0)))


def constraint(scene):
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    bpy.data.objects["Table"].constraints.new("COPY_LOCATION").target = target
    key(target, "location", ((0, 0, 0.7), (0, 0.01, 0.7)))


def lamp_power(scene):
    key(bpy.data.lights["Spot"], "energy", (5.0, 5.01))


def lamp_nodes(scene):
    lamp = bpy.data.lights["Spot"]
    if lamp.node_tree is None:
        lamp.use_nodes = True
    emission = next(n for n in lamp.node_tree.nodes if n.type == "EMISSION")
    key(emission.inputs["Strength"], "default_value")


def lamp_in_an_instance(scene):
    key(collection_instance(scene), "location", ((0, 0, 2), (0, 0, 2.1)))


def lamp_held_by_the_phone(scene):
    bpy.data.objects["Spot"].parent = scene.camera
    key(scene.camera, "location", ((-1.2, -1.5, 1.5), (-1.1, -1.5, 1.5)))


def driven_material(scene):
    drive(nodes_of("Light")["Emission"].inputs["Strength"], "default_value", "frame * 0.5")


def keyed_material(scene):
    shader = next(n for n in nodes_of("Wood") if n.type == "BSDF_DIFFUSE")
    key(shader.inputs["Roughness"], "default_value")


def group_in_a_group(scene):
    inner, outer = (bpy.data.node_groups.new(n, "ShaderNodeTree") for n in ("Inner", "Outer"))
    value = inner.nodes.new("ShaderNodeValue")
    outer.nodes.new("ShaderNodeGroup").node_tree = inner
    nodes_of("Wood").new("ShaderNodeGroup").node_tree = outer
    key(value.outputs[0], "default_value")


def colour_ramp(scene):
    ramp = nodes_of("Wood").new("ShaderNodeValToRGB").color_ramp
    key(ramp.elements[0], "position", (0.0, 0.2))


def world(scene):
    background = next(n for n in scene.world.node_tree.nodes if n.type == "BACKGROUND")
    key(background.inputs["Strength"], "default_value")


def visibility(scene):
    key(bpy.data.objects["Table"], "hide_render", (False, True))


def seen_by_one_kind_of_ray(scene):
    key(bpy.data.objects["Table"], "visible_diffuse", (True, False))


def custom_property(scene):
    table = bpy.data.objects["Table"]
    for frame in FRAMES:
        table["dirt"] = 0.5 * frame
        table.keyframe_insert('["dirt"]', frame=frame)


def object_colour(scene):
    key(bpy.data.objects["Table"], "color", ((1, 1, 1, 1), (1, 0, 1, 1)))


def shape_key(scene):
    table = bpy.data.objects["Table"]
    table.shape_key_add(name="Basis")
    bent = table.shape_key_add(name="Bent")
    bent.data[0].co.z += 0.1
    key(bent, "value")


def modifier_setting(scene):
    modifier = bpy.data.objects["Table"].modifiers.new("Thick", "SOLIDIFY")
    key(modifier, "thickness", (0.01, 0.02))


def modifier_that_follows(scene):
    hook = bpy.data.objects.new("Hook", None)
    scene.collection.objects.link(hook)
    modifier = bpy.data.objects["Table"].modifiers.new("Mirror", "MIRROR")
    modifier.mirror_object = hook
    key(hook, "location", ((1, 0, 0), (1.1, 0, 0)))


def nodes_that_read_the_time(scene):
    grown_by_nodes(scene, lambda tree: tree.nodes.new("GeometryNodeInputSceneTime").outputs["Frame"])


def image_sequence(scene):
    image = bpy.data.images.new("Sequence", 4, 4)
    image.source = "SEQUENCE"
    textured(scene).image = image


def movie(scene):
    image = bpy.data.images.new("Movie", 4, 4)
    image.source = "MOVIE"
    textured(scene).image = image


def texture_that_follows_an_empty(scene):
    empty = bpy.data.objects.new("Origin", None)
    scene.collection.objects.link(empty)
    tree = bpy.data.materials["Wood"].node_tree
    place = tree.nodes.new("ShaderNodeTexCoord")
    place.object = empty
    key(empty, "rotation_euler", ((0, 0, 0), (0, 0, 0.1)))


def texture_that_follows_a_virtual_object(scene):
    tree = bpy.data.materials["Wood"].node_tree
    tree.nodes.new("ShaderNodeTexCoord").object = bpy.data.objects["Ball"]
    key(bpy.data.objects["Ball"], "location", ((0, 0, 0.85), (0, 0.1, 0.85)))


def particles(scene):
    bpy.data.objects["Table"].modifiers.new("Dust", "PARTICLE_SYSTEM")


def bounces(scene):
    scene.cycles.keyframe_insert("max_bounces", frame=1)
    scene.cycles.max_bounces = 1
    scene.cycles.keyframe_insert("max_bounces", frame=2)


ROOM_CHANGES = [
    moved_object, parent_that_moves, constraint, lamp_power, lamp_nodes, lamp_in_an_instance, lamp_held_by_the_phone,
    driven_material, keyed_material, group_in_a_group, colour_ramp, world, visibility, seen_by_one_kind_of_ray,
    custom_property, object_colour, shape_key, modifier_setting, modifier_that_follows, nodes_that_read_the_time,
    image_sequence, movie, texture_that_follows_an_empty, texture_that_follows_a_virtual_object, particles, bounces,
]  # fmt: skip


@pytest.mark.parametrize("change", ROOM_CHANGES, ids=lambda change: change.__name__)
def test_a_change_of_the_room_is_noticed(change):
    scene = still_room()
    change(scene)
    first, second = scene_states(scene, FRAMES)
    assert first.room != second.room


# -------------------------------------------------------------------------------------------------- what does not


def test_a_scene_that_stands_still_has_one_state():
    scene = still_room()
    bpy.data.objects["Table"].modifiers.new("Smooth", "SUBSURF")
    collection_instance(scene)
    grown_by_nodes(scene, lambda tree: tree.nodes.new("ShaderNodeCombineXYZ").outputs[0])
    textured(scene).image = bpy.data.images.new("Still", 4, 4)
    assert len(set(scene_states(scene, (1, 2, 7)))) == 1


def test_keys_that_hold_a_value_change_nothing():
    scene = still_room()
    key(bpy.data.objects["Table"], "location", ((0, 0, 0.7), (0, 0, 0.7)))
    bpy.data.objects["Table"].modifiers.new("Thick", "SOLIDIFY")
    key(bpy.data.lights["Spot"], "energy", (5.0, 5.0))
    key(scene.camera.data, "lens", (35.0, 35.0))
    drive(nodes_of("Light")["Emission"].inputs["Strength"], "default_value", "6 + 0 * frame")
    assert len(set(scene_states(scene, FRAMES))) == 1


def test_what_comes_back_is_the_same_again():
    scene = still_room()
    lamp = bpy.data.lights["Spot"]
    for frame, energy in ((1, 5.0), (2, 7.0), (3, 5.0)):
        lamp.energy = energy
        lamp.keyframe_insert("energy", frame=frame)
    first, second, third = scene_states(scene, (1, 2, 3))
    assert first == third != second


def test_a_phone_that_moves_changes_nothing_but_the_camera():
    scene = still_room()
    key(scene.camera, "location", ((-1.2, -1.5, 1.5), (-1.1, -1.5, 1.5)))
    first, second = scene_states(scene, FRAMES)
    assert (first.room, first.virtual) == (second.room, second.virtual) and first.camera != second.camera


@pytest.mark.parametrize("path", ["lens", "shift_x", "dof.focus_distance", "clip_start"])
def test_a_camera_setting_changes_nothing_but_the_camera(path):
    scene = still_room()
    data = scene.camera.data
    key(data, path, (0.1, 0.2) if path != "lens" else (30.0, 50.0))
    first, second = scene_states(scene, FRAMES)
    assert first.room == second.room and first.camera != second.camera


def test_a_camera_that_a_marker_switches_is_another():
    scene = still_room()
    other = scene.camera.copy()
    other.data = scene.camera.data.copy()
    scene.collection.objects.link(other)
    for frame, camera in zip(FRAMES, (scene.camera, other), strict=True):
        scene.timeline_markers.new("switch", frame=frame).camera = camera
    first, second = scene_states(scene, FRAMES)
    assert first.room == second.room and first.camera != second.camera


def test_a_virtual_object_that_moves_changes_nothing_in_the_room():
    scene = still_room()
    key(bpy.data.objects["Ball"], "location", ((0, 0, 0.85), (0, 0.1, 0.85)))
    first, second = scene_states(scene, FRAMES)
    assert first.room == second.room and first.virtual != second.virtual


def test_with_a_handler_no_frame_is_like_another():
    scene = still_room()

    def meddle(*_):
        """What an add-on may do in every frame."""

    bpy.app.handlers.frame_change_post.append(meddle)
    try:
        first, second = scene_states(scene, FRAMES)
    finally:
        bpy.app.handlers.frame_change_post.remove(meddle)
    assert first != second


def test_the_overlay_of_the_panel_changes_no_frame():
    scene = still_room()
    bpy.app.handlers.frame_change_post.append(forget_positions)
    try:
        first, second = scene_states(scene, FRAMES)
    finally:
        bpy.app.handlers.frame_change_post.remove(forget_positions)
    assert first == second


def test_looking_leaves_the_scene_as_it_was():
    scene = still_room()
    lamp_power(scene)
    bpy.data.lights["Spot"].energy = 123.0
    look_at(scene.camera, (0, -1, 1), (0, 0, 0.8))
    bpy.context.view_layer.update()
    before = np.array(scene.camera.matrix_world)
    scene_states(scene, FRAMES)
    assert scene.frame_current == 1 and bpy.data.lights["Spot"].energy == 123.0
    assert [s.name for s in bpy.data.scenes] == [scene.name]
    np.testing.assert_array_equal(scene.camera.matrix_world, before)


# ------------------------------------------------------------------------------------------------------ what is kept


def test_each_render_is_taken_from_the_first_frame_that_has_it():
    dark, light = SceneState("dark", "v", "here"), SceneState("light", "v", "here")
    elsewhere = SceneState("dark", "v", "there")
    states = dict(enumerate((dark, elsewhere, dark, light, elsewhere), start=1))
    in_view = {1: ["Box"], 2: ["Ball"], 3: ["Ball"], 4: ["Ball"], 5: ["Ball", "Vase"]}
    reuse = plan_render_reuse(states, in_view)
    assert reuse.captures == {1: 1, 2: 2, 3: 1, 4: 4, 5: 2}
    assert [reuse.probes[frame, "Ball"] for frame in (2, 3, 4, 5)] == [2, 2, 4, 2]
    assert reuse.probes[5, "Vase"] == 5
    assert reuse.comparison(1, b"a") == reuse.comparison(3, b"a") != reuse.comparison(3, b"b")
    # A frame that is not captured, as one that the phone does not deliver, holds nothing for the others.
    assert plan_render_reuse(states, {3: ["Ball"], 5: ["Ball"]}).captures == {3: 3, 5: 5}


def test_where_nothing_is_known_every_frame_is_rendered():
    reuse = plan_render_reuse(each_its_own((1, 2)), {1: ["Ball"], 2: ["Ball"]})
    assert reuse.captures == {1: 1, 2: 2} and set(reuse.probes.values()) == {1, 2}
    assert reuse.comparison(1, b"a") != reuse.comparison(2, b"a")


def test_shapes_shared_by_the_room_and_a_virtual_object_are_noticed_in_both():
    scene = still_room()
    ball = bpy.data.objects["Ball"]
    ball.shape_key_add(name="Basis")
    bent = ball.shape_key_add(name="Bent")
    bent.data[0].co.z += 0.1
    key(bent, "value")
    twin = sphere(scene, "Twin", (0.5, 0.5, 1.0), 0.1, material("Twin"))
    twin.data = ball.data
    first, second = scene_states(scene, FRAMES)
    assert first.room != second.room and first.virtual != second.virtual


def test_a_second_virtual_object_belongs_to_the_virtual_ones():
    scene = still_room()
    added = box(scene, "Box", (0, 0.5, 1), (0.1, 0.1, 0.1), None, virtual_collection(scene))
    key(added, "hide_render", (False, True))
    first, second = scene_states(scene, FRAMES)
    assert first.room == second.room and first.virtual != second.virtual
