"""Where does the light come from: lamps with shades, the sun, the sky, a panorama.

A lampshade glows by its own emission and a round point light inside it lights the room; the shade casts no shadow of
that light. Letting the bulb shine through translucent cloth would be truer and, at 16 samples, only noise.
Colours of lamps are black bodies at a stated temperature. Bulbs are spheres of 4 cm and more: no fireflies.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TypeAlias

import bpy

from xihe_blender.lab.props.furniture import Place
from xihe_blender.lab.props.shapes import Vector, add_solid, ball, cylinder, joined, revolved, tube
from xihe_blender.lab.props.surfaces import glowing

Material: TypeAlias = bpy.types.Material
Collection: TypeAlias = bpy.types.Collection


def add_bulb(
    room: Collection, name: str, location: Vector, *, kelvin: float, watts: float, radius: float = 0.06
) -> bpy.types.Object:
    """A round point light with a black body's colour; its node is named "Temperature" for keying."""
    light = bpy.data.lights.new(name, "POINT")
    light.energy, light.shadow_soft_size = watts, radius
    if light.node_tree is None:  # from 5.0 on a new light may have its nodes, and asking for them warns
        light.use_nodes = True
    nodes, links = light.node_tree.nodes, light.node_tree.links
    tint = nodes.new("ShaderNodeBlackbody")
    tint.name = tint.label = "Temperature"
    tint.inputs[0].default_value = kelvin
    emission = next(node for node in nodes if node.type == "EMISSION")
    links.new(tint.outputs[0], emission.inputs["Color"])
    bulb = bpy.data.objects.new(name, light)
    bulb.location = location
    room.objects.link(bulb)
    return bulb


def add_shade(
    room: Collection, name: str, profile: list[tuple[float, float]], shade: Material, *, place: Place
) -> bpy.types.Object:
    """A lampshade of revolution that lets the bulb's light pass."""
    thing = add_solid(room, name, revolved(profile, 40), shade, smooth=True, **place)
    thing.visible_shadow = False
    return thing


def add_table_lamp(
    room: Collection,
    name: str,
    body: Material,
    *,
    place: Place,
    kelvin: float,
    watts: float,
    radiance: float,
    height: float = 0.5,
) -> bpy.types.Object:
    """A ceramic foot with a conical shade; returns the light."""
    h = height
    foot = [
        (0, 0),
        (0.15 * h, 0),
        (0.16 * h, 0.03 * h),
        (0.05 * h, 0.07 * h),
        (0.17 * h, 0.25 * h),
        (0.14 * h, 0.42 * h),
        (0.03 * h, 0.54 * h),
        (0.025 * h, 0.66 * h),
    ]
    add_solid(room, f"{name} foot", revolved(foot, 32), body, smooth=True, **place)
    add_shade(
        room,
        f"{name} shade",
        [(0.32 * h, 0.55 * h), (0.2 * h, h)],
        glowing(f"{name} shade", kelvin, radiance),
        place=place,
    )
    x, y, z = place["location"]
    return add_bulb(room, f"{name} light", (x, y, z + 0.75 * h), kelvin=kelvin, watts=watts)


def add_floor_lamp(
    room: Collection,
    name: str,
    metal: Material,
    *,
    place: Place,
    kelvin: float,
    watts: float,
    radiance: float,
    height: float = 1.6,
) -> bpy.types.Object:
    """A pole on a round foot with a drum shade; returns the light."""
    pole = [cylinder(0.15, 0.02, 32), tube((0, 0, 0.01), (0, 0, height - 0.1), 0.011)]
    add_solid(room, f"{name} pole", joined(pole), metal, smooth=True, **place)
    shade = glowing(f"{name} shade", kelvin, radiance)
    add_shade(room, f"{name} shade", [(0.21, height - 0.3), (0.17, height)], shade, place=place)
    x, y, z = place["location"]
    return add_bulb(room, f"{name} light", (x, y, z + height - 0.15), kelvin=kelvin, watts=watts)


def add_pendant(
    room: Collection, name: str, shell: Material, cord: Material, *, place: Place, drop: float = 0.7
) -> None:
    """A pendant lamp that is switched off, hanging from the place's height."""
    dome = [(0.2, -drop), (0.185, -drop + 0.07), (0.13, -drop + 0.14), (0.05, -drop + 0.18), (0.0, -drop + 0.185)]
    add_solid(room, f"{name} shell", revolved(dome, 40), shell, smooth=True, **place)
    parts = [
        tube((0, 0, -drop + 0.17), (0, 0, 0), 0.004, 8),
        cylinder(0.05, 0.03).moved((0, 0, -0.03)),
        ball(0.045, (0, 0, -drop + 0.06), 24),
    ]
    add_solid(room, f"{name} cord", joined(parts), cord, smooth=True, **place)


def add_sun(
    room: Collection, *, azimuth_deg: float, elevation_deg: float, irradiance: float, tint: Vector = (1.0, 0.93, 0.82)
) -> None:
    """A sun that shines from an azimuth (anticlockwise from +X) and elevation; its disc is 1 degree wide."""
    light = bpy.data.lights.new("Sun", "SUN")
    light.energy, light.angle, light.color = irradiance, math.radians(1.0), tint
    sun = bpy.data.objects.new("Sun", light)
    sun.rotation_euler = (math.radians(90 - elevation_deg), 0.0, math.radians(azimuth_deg + 90))
    room.objects.link(sun)


class WorldNodes:
    """A scene's new world with an empty colour, ready for nodes."""

    def __init__(self, scene: bpy.types.Scene, strength: float, map_size: int = 256) -> None:
        world = bpy.data.worlds.new("Outside")
        scene.world = world
        if world.node_tree is None:
            world.use_nodes = True
        # A fixed importance map: AUTOMATIC sizes it from the graph and takes seconds per change.
        world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", map_size
        self.nodes, self.links = world.node_tree.nodes, world.node_tree.links
        self.background = next(node for node in self.nodes if node.type == "BACKGROUND")
        self.background.inputs["Strength"].default_value = strength

    def along(self, direction: Any, axis: Vector, span: tuple[float, float]) -> Any:
        """A value that goes from the first to the second of `span` as the direction turns from -axis to +axis."""
        product = self.nodes.new("ShaderNodeVectorMath")
        product.operation = "DOT_PRODUCT"
        self.links.new(direction, product.inputs[0])
        product.inputs[1].default_value = axis
        scaled = self.nodes.new("ShaderNodeMapRange")
        self.links.new(product.outputs["Value"], scaled.inputs["Value"])
        scaled.inputs["From Min"].default_value = -1.0
        scaled.inputs["To Min"].default_value, scaled.inputs["To Max"].default_value = span
        return scaled.outputs[0]

    def colour(self, socket: Any) -> None:
        """What the world emits."""
        self.links.new(socket, self.background.inputs["Color"])


def set_sky(
    scene: bpy.types.Scene,
    stops: list[tuple[float, Vector]],
    *,
    strength: float,
    bright_azimuth_deg: float | None = None,
) -> None:
    """A sky that changes with elevation.

    Parameters
    ----------
    stops : colours, from straight down (0) over the horizon (0.5) to straight up (1)
    strength : radiance of a white stop
    bright_azimuth_deg : the side of the sun (anticlockwise from +X), five times as bright as the opposite side. Where
        that is the window's side, Cycles sends its samples through the window more often. None: the same all round.
    """
    world = WorldNodes(scene, strength)
    direction = world.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    ramp = world.nodes.new("ShaderNodeValToRGB")
    elements = ramp.color_ramp.elements
    while len(elements) < len(stops):
        elements.new(0.5)
    for element, (place, colour) in zip(elements, stops, strict=True):
        element.position, element.color = place, (*colour, 1.0)
    world.links.new(world.along(direction, (0.0, 0.0, 1.0), (0.0, 1.0)), ramp.inputs[0])
    world.colour(ramp.outputs[0])
    if bright_azimuth_deg is not None:
        azimuth = math.radians(bright_azimuth_deg)
        side = (math.cos(azimuth), math.sin(azimuth), 0.0)
        level = world.along(direction, side, (0.2 * strength, strength))
        world.links.new(level, world.background.inputs["Strength"])


def set_panorama(scene: bpy.types.Scene, file_name: str, *, strength: float, turn_deg: float = 0.0) -> None:
    """One of the CC0 panoramas that Blender ships in its studio lights, packed into the file."""
    folder = Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"))
    world = WorldNodes(scene, strength, 1024)
    picture = world.nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str(folder / file_name))
    picture.image.pack()
    # Where the packing machine keeps its files is nobody's business.
    picture.image.filepath = picture.image.packed_files[0].filepath = f"//{file_name}"
    turn = world.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value[2] = math.radians(turn_deg)
    world.links.new(world.nodes.new("ShaderNodeTexCoord").outputs["Generated"], turn.inputs["Vector"])
    world.links.new(turn.outputs[0], picture.inputs["Vector"])
    world.colour(picture.outputs["Color"])
