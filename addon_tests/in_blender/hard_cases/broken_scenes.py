"""Scenes that a user can make by mistake, each a change to the small room of the tests.

A change is a function of the scene. Rooms are at rest for one frame, with direct light and indirect light that is not
clamped, so that the brightness of a lamp changes nothing but the exposure.
"""

import bpy
import numpy as np
from tiny_scenes import add, add_lamp, box, key, light_strength, node_of, room_with_a_virtual_sphere, sphere

from xihe_blender.scene.virtual_objects import virtual_collection


def room(*changes):
    """The small room after `changes`."""
    scene = room_with_a_virtual_sphere(1, is_still=True)
    scene.cycles.sample_clamp_indirect = 0.0
    for change in changes:
        change(scene)
    bpy.context.view_layer.update()
    return scene


def add_mesh(points=(), edges=(), faces=(), *, is_virtual=False):
    def change(scene):
        mesh = bpy.data.meshes.new("Odd")
        mesh.from_pydata(list(points), list(edges), list(faces))
        _add(scene, mesh, is_virtual)

    return change


def add_empty_instance(*, is_virtual):
    """An empty that instances a collection with nothing in it."""

    def change(scene):
        item = _add(scene, None, is_virtual)
        item.instance_type, item.instance_collection = "COLLECTION", bpy.data.collections.new("Nothing")

    return change


def _add(scene, data, is_virtual):
    return add(scene, "Odd", data, (0.2, 0.0, 0.85), virtual_collection(scene) if is_virtual else None)


def move_vertex(name, place):
    """One vertex of an object to (place, place, place)."""
    return lambda scene: setattr(scene.objects[name].data.vertices[3], "co", (place,) * 3)


def put(name, **values):
    """Attributes of an object, or of its data."""

    def change(scene):
        for attribute, value in values.items():
            item = scene.objects[name]
            setattr(item if hasattr(item, attribute) else item.data, attribute, value)

    return change


def to_phone(name):
    """An object to where the camera is."""
    return lambda scene: setattr(scene.objects[name], "location", scene.camera.location)


def remove(*names):
    def change(scene):
        for name in names:
            bpy.data.objects.remove(scene.objects[name])

    return change


def add_block(centre):
    """A closed box in the room around `centre`."""
    return lambda scene: box(scene, "Block", centre, (0.4, 0.4, 0.4))


def add_shell(scene):
    """A virtual sphere around the other one."""
    sphere(scene, "Shell", (0, 0, 0.85), 0.3, None, virtual_collection(scene))


def scale_all(factor, *, scale_length=1.0, is_clip_scaled=True):
    """Everything `factor` times as large, in units of `scale_length` metres."""

    def change(scene):
        scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", scale_length
        for item in scene.objects:
            item.location *= factor
            if item.type == "MESH":
                item.scale *= factor
        if is_clip_scaled:
            lens = scene.camera.data
            lens.clip_start, lens.clip_end = lens.clip_start * factor, lens.clip_end * factor

    return change


def move_all(offset):
    def change(scene):
        for item in scene.objects:
            item.location.x += offset

    return change


def panel(strength):
    """How strongly the room's shining panel shines."""
    return lambda scene: setattr(light_strength(), "default_value", strength)


def virtual_lamp(scene):
    """A lamp among the virtual objects."""
    add_lamp(scene, location=(0.0, 0.0, 2.0), name="Bulb", collection=virtual_collection(scene))


def lamp_alone(energy, kind="POINT"):
    """A lamp instead of the panel."""

    def change(scene):
        panel(0.0)(scene)
        add_lamp(scene, kind, (0.5, 0.5, 2.0), "Bulb", energy=energy)

    return change


def no_light_threshold(scene):
    scene.cycles.light_sampling_threshold = 0.0


def lamp_that_breaks(scene):
    """10 W at the first frame, 1e31 W at the second."""
    lamp_alone(10.0)(scene)
    scene.frame_end = 2
    key(bpy.data.lights["Bulb"], "energy", {1: 10.0, 2: 1e31})


def feed_panel(node_type, values):
    """A node with these constants that feeds the panel's strength."""

    def change(scene):
        tree = bpy.data.materials["Light"].node_tree
        node = tree.nodes.new(node_type)
        if node_type == "ShaderNodeMath":
            node.operation = "MULTIPLY"
        for socket, value in zip(node.inputs if node_type == "ShaderNodeMath" else node.outputs, values, strict=False):
            socket.default_value = value
        tree.links.new(node.outputs[0], light_strength())

    return change


def paint_walls(*colour):
    def change(scene):
        node_of(bpy.data.materials["Walls"], "BSDF_DIFFUSE").inputs["Color"].default_value = (*colour, 1.0)

    return change


def background(strength):
    def change(scene):
        node_of(scene.world, "BACKGROUND").inputs["Strength"].default_value = strength

    return change


def no_world(scene):
    scene.world = None


def sky(value, n_pixels):
    """An HDRI of ones, `n_pixels` of which are `value`, in place of walls."""

    def change(scene):
        remove("Room")(scene)
        pixels = np.ones((16 * 32, 4), np.float32)
        pixels[:n_pixels, :3] = value
        image = bpy.data.images.new("HDRI", 32, 16, float_buffer=True)
        image.pixels.foreach_set(pixels.ravel())
        image.pack()
        # An importance map whose size Cycles chooses costs seconds.
        scene.world.cycles.sampling_method, scene.world.cycles.sample_map_resolution = "MANUAL", 64
        node = scene.world.node_tree.nodes.new("ShaderNodeTexEnvironment")
        node.image = image
        scene.world.node_tree.links.new(node.outputs[0], node_of(scene.world, "BACKGROUND").inputs["Color"])

    return change
