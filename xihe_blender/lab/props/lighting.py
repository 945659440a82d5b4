"""Lighting of a room: lamps with shades, the sun, the sky, a panorama.

A lampshade glows by its own emission and a round point light inside it lights the room; the shade casts no shadow of
that light. Letting the bulb shine through translucent cloth would be truer and, at 16 samples, only noise.
Colours of lamps are black bodies at a stated temperature. Bulbs are spheres of 4 cm and more: no fireflies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.lab.props import Collection, Material, Vector
from xihe_blender.lab.props.shapes import Place, ball, cylinder, joined, revolved, tube
from xihe_blender.lab.props.surfaces import Nodes, glowing, plain

Profile = Sequence[tuple[float, float]]
LAMP_FOOT: Profile = (
    (0, 0), (0.15, 0), (0.16, 0.03), (0.05, 0.07), (0.17, 0.25), (0.14, 0.42), (0.03, 0.54), (0.025, 0.66),
)  # fmt: skip
"""Of a table lamp: radius and height, as shares of the lamp's height."""


def add_light(room: Collection, name: str, kind: str, location: Vector = (0, 0, 0), **look: Any) -> bpy.types.Object:
    """A light of one of Blender's kinds; `look` names properties of its data, as in energy=40."""
    light = bpy.data.lights.new(name, kind)
    for key, value in look.items():
        setattr(light, key, value)
    thing = bpy.data.objects.new(name, light)
    thing.location = location
    room.objects.link(thing)
    return thing


def tint_light(light: bpy.types.Light, kelvin: float) -> None:
    """Give a light a black body's colour; its node is named "Temperature" for keying."""
    nodes = Nodes(light)
    tint = nodes.add("Blackbody", {0: kelvin}, name="Temperature", label="Temperature")
    nodes.set(nodes.first("EMISSION"), {"Color": tint.outputs[0]})


def add_bulb(place: Place, *, kelvin: float, watts: float, radius: float = 0.06) -> bpy.types.Object:
    """A round point light with a black body's colour."""
    where, look = (place.x, place.y, place.z), {"energy": watts, "shadow_soft_size": radius}
    bulb = add_light(place.room, f"{place.name} light", "POINT", where, **look)
    tint_light(bulb.data, kelvin)
    return bulb


def shade_cloth(name: str, kelvin: float, radiance: float) -> Material:
    """A lit shade glows; one with a radiance of 0 is white cloth."""
    return glowing(name, kelvin, radiance) if radiance > 0 else plain(name, (0.7, 0.67, 0.6), roughness=0.9)


def _add_shaded_bulb(
    place: Place, profile: Profile, bulb_m: float, *, kelvin: float, watts: float, radiance: float
) -> bpy.types.Object | None:
    """A shade of revolution that lets light pass, and the bulb in it, `bulb_m` above the place; None without power."""
    cloth = shade_cloth(f"{place.name} shade", kelvin, radiance)
    shade = place.add(revolved(profile, 40), cloth, "shade", smooth=True)
    shade.visible_shadow = False
    return add_bulb(replace(place, z=place.z + bulb_m), kelvin=kelvin, watts=watts) if watts > 0 else None


def add_table_lamp(
    place: Place, body: Material, *, height: float = 0.5, foot: Profile = LAMP_FOOT, **light: float
) -> bpy.types.Object | None:
    """A ceramic foot with a conical shade; `light` is kelvin, watts and the shade's radiance. Returns the light."""
    h = height
    turned = revolved([(r * h, z * h) for r, z in foot], 32)
    place.add(turned, body, "foot", smooth=True)
    return _add_shaded_bulb(place, [(0.32 * h, 0.55 * h), (0.2 * h, h)], 0.75 * h, **light)


def add_floor_lamp(place: Place, metal: Material, *, height: float = 1.6, **light: float) -> bpy.types.Object | None:
    """A pole on a round foot with a drum shade; otherwise as `add_table_lamp`."""
    pole = [cylinder(0.15, 0.02, 32), tube((0, 0, 0.01), (0, 0, height - 0.1), 0.011)]
    place.add(joined(pole), metal, "pole", smooth=True)
    return _add_shaded_bulb(place, [(0.21, height - 0.3), (0.17, height)], height - 0.15, **light)


def add_pendant(place: Place, shell: Material, cord: Material, *, drop: float) -> None:
    """A pendant lamp that is switched off, hanging from the place's height."""
    dome = [(0.2, -drop), (0.185, -drop + 0.07), (0.13, -drop + 0.14), (0.05, -drop + 0.18), (0.0, -drop + 0.185)]
    place.add(revolved(dome, 40), shell, "shell", smooth=True)
    parts = [tube((0, 0, -drop + 0.17), (0, 0, 0), 0.004, 8), cylinder(0.05, 0.03).moved((0, 0, -0.03))]
    parts.append(ball(0.045, (0, 0, -drop + 0.06), 24))
    place.add(joined(parts), cord, "cord", smooth=True)


def add_sun(
    room: Collection, *, azimuth_deg: float, elevation_deg: float, irradiance: float, tint: Vector = (1.0, 0.93, 0.82)
) -> None:
    """A sun that shines from an azimuth (anticlockwise from +X) and elevation; its disc is 1 degree wide."""
    sun = add_light(room, "Sun", "SUN", energy=irradiance, angle=math.radians(1.0), color=tint)
    sun.rotation_euler = (math.radians(90 - elevation_deg), 0.0, math.radians(azimuth_deg + 90))


def new_world(scene: bpy.types.Scene, strength: float, map_size: int) -> Nodes:
    """The nodes of a new world of `scene` with an empty colour."""
    world = scene.world = bpy.data.worlds.new("Outside")
    # A fixed importance map: AUTOMATIC sizes it from the graph and takes seconds per change.
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", map_size
    nodes = Nodes(world)
    nodes.set(nodes.first("BACKGROUND"), {"Strength": strength})
    return nodes


def _along(nodes: Nodes, direction: Any, axis: Vector, span: tuple[float, float]) -> Any:
    """A value that goes from the first to the second of `span` as the direction turns from -axis to +axis."""
    product = nodes.add("VectorMath", {0: direction, 1: axis}, operation="DOT_PRODUCT").outputs["Value"]
    return nodes.add("MapRange", {"Value": product, "From Min": -1.0, "To Min": span[0], "To Max": span[1]}).outputs[0]


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
    nodes = new_world(scene, strength, 256)
    background = nodes.first("BACKGROUND")
    direction = nodes.add("TexCoord").outputs["Generated"]
    nodes.set(background, {"Color": nodes.ramp(_along(nodes, direction, (0.0, 0.0, 1.0), (0.0, 1.0)), *stops)})
    if bright_azimuth_deg is not None:
        azimuth = math.radians(bright_azimuth_deg)
        side = (math.cos(azimuth), math.sin(azimuth), 0.0)
        nodes.set(background, {"Strength": _along(nodes, direction, side, (0.2 * strength, strength))})


def set_panorama(scene: bpy.types.Scene, file_name: str, *, strength: float, turn_deg: float) -> None:
    """One of the CC0 panoramas that Blender ships in its studio lights, packed into the file."""
    folder = Path(bpy.utils.system_resource("DATAFILES", path="studiolights/world"))
    image = bpy.data.images.load(str(folder / file_name))
    image.pack()
    # Where the packing machine keeps its files is nobody's business.
    image.filepath = image.packed_files[0].filepath = f"//{file_name}"
    nodes = new_world(scene, strength, 1024)
    direction = nodes.add("TexCoord").outputs["Generated"]
    turned = nodes.add("Mapping", {"Vector": direction, "Rotation": (0.0, 0.0, math.radians(turn_deg))})
    picture = nodes.add("TexEnvironment", {"Vector": turned.outputs[0]}, image=image)
    nodes.set(nodes.first("BACKGROUND"), {"Color": picture.outputs["Color"]})
