"""Key suns: the key light of an estimate as light in Blender, a sun for each virtual object beside its world.

The world then holds what is left of the estimate: both together are the estimate, so nothing is lit twice. A sun of
another object must not shine here, so each has a collection of its own that only one view layer includes.

Direction, colour, strength and angle are keyed as the worlds are, with constant interpolation. Where there is no key
light the sun's strength is 0.
"""

from __future__ import annotations

from collections.abc import Mapping

import bpy
from mathutils import Vector

from xihe_blender.apply.datablocks import KEY_LIGHT, PREFIX, shortened
from xihe_blender.apply.keys import clear_keys, hold_keys, remove_animation
from xihe_blender.scene.colour_management import in_working_space
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.records import KeyLight


def make_key_sun(name: str) -> bpy.types.Object:
    """A sun named `name` that does not shine yet; an older one of ours is set up anew and stays where it is linked."""
    sun = key_sun(name)
    if sun is None:
        sun = bpy.data.objects.new(name, bpy.data.lights.new(name, "SUN"))
        sun[KEY_LIGHT] = name
        sun.rotation_mode = "QUATERNION"
    clear_keys(sun)
    clear_keys(sun.data)
    apply_key_to_sun(sun, None)
    return sun


def sun_name(virtual_object: str) -> str:
    """Name of the sun of a virtual object, in the 63 bytes that every Blender keeps of one."""
    return shortened(f"{PREFIX}Key Light {virtual_object}")


def apply_key_to_sun(sun: bpy.types.Object, key: KeyLight | None, exposure: float = 1.0) -> None:
    """Let `sun`, made by `make_key_sun`, shine as `key`, which carries `exposure`; None lets it not shine at all."""
    light = sun.data
    light.energy = 0.0
    if key is not None and key.irradiance.max() > 0:
        # A sun shines along its -Z.
        sun.rotation_quaternion = Vector(key.direction).to_track_quat("Z", "Y")
        irradiance = in_working_space(key.irradiance)
        light.energy = float(irradiance.max()) / exposure
        light.color = irradiance / irradiance.max()
        light.angle = 2 * key.angular_radius


def key_sun_changes(sun: bpy.types.Object, keys: Mapping[int, KeyLight | None], exposure: float) -> None:
    """As `apply_key_to_sun` at each frame of `keys`, in order, in place of all keys."""
    clear_keys(sun)
    clear_keys(sun.data)
    for frame, key in keys.items():
        apply_key_to_sun(sun, key, exposure)
        sun.keyframe_insert("rotation_quaternion", frame=frame)
        for name in ("energy", "color", "angle"):
            sun.data.keyframe_insert(name, frame=frame)
    hold_keys(sun)
    hold_keys(sun.data)


def show_in_reflections(sun: bpy.types.Object, is_shown: bool) -> None:
    """Whether glossy and transmission rays see `sun`: not where a picture shows its lamp."""
    sun.visible_glossy = sun.visible_transmission = is_shown


def key_suns() -> list[bpy.types.Object]:
    """All suns of ours in the file itself."""
    return [item for item in bpy.data.objects if KEY_LIGHT in item and item.library is None]


def key_sun(name: str) -> bpy.types.Object | None:
    """Our sun that was made with that name."""
    return next((sun for sun in key_suns() if sun[KEY_LIGHT] == name), None)


def applied_suns(scene: bpy.types.Scene) -> dict[str, bpy.types.Object]:
    """The sun of each virtual object of `scene`, for those that have one."""
    by_name = {sun[KEY_LIGHT]: sun for sun in key_suns()}
    names = {item.name: sun_name(item.name) for item in virtual_objects(scene)}
    return {name: by_name[own] for name, own in names.items() if own in by_name}


def remove_key_sun(sun: bpy.types.Object | None) -> None:
    """Take it away, with its light and its keys; nothing for None."""
    if sun is not None:
        light = sun.data
        for owner in (sun, light):
            remove_animation(owner)
        bpy.data.objects.remove(sun)
        bpy.data.lights.remove(light)
