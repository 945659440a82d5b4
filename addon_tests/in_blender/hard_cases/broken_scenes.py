"""Scenes that a user can make by mistake, each a change to the small room of the tests.

A change is a function of the scene. Rooms are at rest for one frame, with direct light and indirect light that is not
clamped, so that the brightness of a lamp changes nothing but the exposure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
from tiny_scenes import box, key, room_with_a_virtual_sphere, sphere

from xihe_blender.scene.virtual_objects import virtual_collection

Change = Callable[[bpy.types.Scene], None]


def room(*changes: Change) -> bpy.types.Scene:
    """The small room after `changes`."""
    scene = room_with_a_virtual_sphere(1)
    scene.camera.animation_data_clear()
    scene.cycles.sample_clamp_indirect = 0.0
    for change in changes:
        change(scene)
    bpy.context.view_layer.update()
    return scene


# ------------------------------------------------------------------------------------------------------------ geometry


def add_mesh(
    points: Sequence[Any] = (), edges: Sequence[Any] = (), faces: Sequence[Any] = (), *, is_virtual: bool = False
) -> Change:
    def change(scene: bpy.types.Scene) -> None:
        mesh = bpy.data.meshes.new("Odd")
        mesh.from_pydata(list(points), list(edges), list(faces))
        _add(scene, mesh, is_virtual)

    return change


def add_instance(*, is_virtual: bool) -> Change:
    """An empty that instances a collection with nothing in it."""

    def change(scene: bpy.types.Scene) -> None:
        item = _add(scene, None, is_virtual)
        item.instance_type, item.instance_collection = "COLLECTION", bpy.data.collections.new("Nothing")

    return change


def _add(scene: bpy.types.Scene, data: bpy.types.ID | None, is_virtual: bool) -> bpy.types.Object:
    item = bpy.data.objects.new("Odd", data)
    item.location = (0.2, 0.0, 0.85)
    (virtual_collection(scene) if is_virtual else scene.collection).objects.link(item)
    return item


def move_vertex(name: str, place: float) -> Change:
    """One vertex of an object to (place, place, place)."""
    return lambda scene: setattr(scene.objects[name].data.vertices[3], "co", (place,) * 3)


def put(name: str, **values: Any) -> Change:
    """Attributes of an object, or of its data."""

    def change(scene: bpy.types.Scene) -> None:
        for attribute, value in values.items():
            item = scene.objects[name]
            setattr(item if hasattr(item, attribute) else item.data, attribute, value)

    return change


def remove(*names: str) -> Change:
    def change(scene: bpy.types.Scene) -> None:
        for name in names:
            bpy.data.objects.remove(scene.objects[name])

    return change


def add_block(centre: Sequence[float]) -> Change:
    """A closed box in the room around `centre`."""
    return lambda scene: box(scene, "Block", centre, (0.4, 0.4, 0.4))


def add_shell(scene: bpy.types.Scene) -> None:
    """A virtual sphere around the other one."""
    sphere(scene, "Shell", (0, 0, 0.85), 0.3, None, virtual_collection(scene))


def scale_all(factor: float, *, scale_length: float = 1.0, is_clip_scaled: bool = True) -> Change:
    """Everything `factor` times as large, in units of `scale_length` metres."""

    def change(scene: bpy.types.Scene) -> None:
        scene.unit_settings.system, scene.unit_settings.scale_length = "METRIC", scale_length
        for item in scene.objects:
            item.location *= factor
            if item.type == "MESH":
                item.scale *= factor
        if is_clip_scaled:
            lens = scene.camera.data
            lens.clip_start, lens.clip_end = lens.clip_start * factor, lens.clip_end * factor

    return change


def move_all(offset: float) -> Change:
    def change(scene: bpy.types.Scene) -> None:
        for item in scene.objects:
            item.location.x += offset

    return change


# --------------------------------------------------------------------------------------------------------------- light


def panel(strength: float) -> Change:
    """How strongly the room's shining panel shines."""
    return lambda scene: setattr(_input("Light", "Emission", "Strength"), "default_value", strength)


def _input(material: str, node: str, name: str) -> Any:
    return bpy.data.materials[material].node_tree.nodes[node].inputs[name]


def lamp_alone(energy: float, kind: str = "POINT") -> Change:
    """A lamp instead of the panel."""

    def change(scene: bpy.types.Scene) -> None:
        panel(0.0)(scene)
        data = bpy.data.lights.new("Bulb", kind)
        data.energy = energy
        item = bpy.data.objects.new("Bulb", data)
        item.location = (0.5, 0.5, 2.0)
        scene.collection.objects.link(item)

    return change


def lamp_that_breaks(scene: bpy.types.Scene) -> None:
    """10 W at the first frame, 1e31 W at the second."""
    lamp_alone(10.0)(scene)
    scene.frame_end = 2
    key(bpy.data.lights["Bulb"], "energy", {1: 10.0, 2: 1e31})


def feed_panel(node_type: str, values: Sequence[float]) -> Change:
    """A node with these constants that feeds the panel's strength."""

    def change(scene: bpy.types.Scene) -> None:
        tree = bpy.data.materials["Light"].node_tree
        node = tree.nodes.new(node_type)
        if node_type == "ShaderNodeMath":
            node.operation = "MULTIPLY"
        for socket, value in zip(node.inputs if node_type == "ShaderNodeMath" else node.outputs, values, strict=False):
            socket.default_value = value
        tree.links.new(node.outputs[0], _input("Light", "Emission", "Strength"))

    return change


def paint_walls(*colour: float) -> Change:
    return lambda scene: setattr(_input("Walls", "Diffuse BSDF", "Color"), "default_value", (*colour, 1.0))


def background(strength: float) -> Change:
    return lambda scene: setattr(_background(scene).inputs["Strength"], "default_value", strength)


def _background(scene: bpy.types.Scene) -> Any:
    return next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")


def no_world(scene: bpy.types.Scene) -> None:
    scene.world = None


def sky(value: float, n_pixels: int) -> Change:
    """An HDRI of ones, `n_pixels` of which are `value`, in place of walls."""

    def change(scene: bpy.types.Scene) -> None:
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
        scene.world.node_tree.links.new(node.outputs[0], _background(scene).inputs["Color"])

    return change
