"""The light that a file's virtual objects are lit with, read back from their worlds and suns."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Quaternion

from xihe_blender.apply.datablocks import LightOf, applied_worlds, lights_by_sh
from xihe_blender.apply.key_suns import applied_suns
from xihe_blender.apply.keys import f_curves
from xihe_blender.apply.sh_worlds import COEFFICIENTS, GAIN, inputs_of_world, light_curves
from xihe_blender.errors import UserError
from xihe_blender.io.run_lights import LightsAsked
from xihe_blender.scene.colour_management import in_rec709
from xihe_blender.scene.units import seconds_of
from xihenet.formats import as_spelled, format_names
from xihenet.light.exports import NamedLight, scaled
from xihenet.light.key_light import sh_of_key_light
from xihenet.records import KeyLight, ObjectLight


def lights_of_scene(scene: bpy.types.Scene, asked: LightsAsked) -> list[NamedLight]:
    """The lights that are asked for of the lit virtual objects of `scene`; UserError, naming the fix, for none.

    Without `asked.frame` the last that is keyed. What parts a light has is what the file has.
    """
    worlds = applied_worlds(scene)
    chosen = list(worlds) if asked.objects is None else as_spelled(asked.objects, worlds)
    if not chosen and asked.objects is None:
        raise UserError(f"scene {scene.name!r} has no lit virtual object: give the lit .blend that a run leaves")
    if unknown := [name for name in chosen if name not in worlds]:
        raise UserError(f"the file has no lit virtual object {unknown[0]!r}; it has {format_names(worlds)}")
    found = []
    for name in chosen:
        keyed = {round(point.co[0]) for _, curve in light_curves(worlds[name]) for point in curve.keyframe_points}
        keyed = keyed or {scene.frame_current}
        for frame in sorted(keyed) if asked.everything else [max(keyed) if asked.frame is None else asked.frame]:
            light, exposure = _light_at(worlds[name], applied_suns(scene).get(name), frame)
            gain = 1.0 if asked.units == "picture" else 1.0 / exposure
            found.append(NamedLight(name, frame, seconds_of(scene, frame), scaled(light, gain)))
    return found


def lights_after_run(room: bpy.types.Scene, frame: int, units: str = "picture") -> dict[str, NamedLight]:
    """The lights in use at `frame` of the virtual objects of `room` that were moved or added since the run."""
    worlds = {name: world for name, world in applied_worlds(room).items() if lights_by_sh(world)}
    moved = [name for name, world in worlds.items() if (of := LightOf.read(world)) and of.live]
    asked = LightsAsked(frame, objects=tuple(moved), units=units)
    return {light.object_name: light for light in lights_of_scene(room, asked)}


def _key_at(sun: bpy.types.Object, frame: int, exposure: float) -> KeyLight | None:
    light = sun.data
    values = {
        "rotation_quaternion": [*sun.rotation_quaternion],
        "color": [*light.color],
        "energy": [light.energy],
        "angle": [light.angle],
    }
    for curve in (*f_curves(sun), *f_curves(light)):
        if curve.data_path in values:
            values[curve.data_path][curve.array_index] = curve.evaluate(frame)
    irradiance = in_rec709(np.array(values["color"]) * values["energy"][0] * exposure)
    if not irradiance.max() > 0:
        return None
    # A sun shines along its -Z.
    direction = np.array(Quaternion(values["rotation_quaternion"]).normalized().to_matrix(), np.float64)[:, 2]
    return KeyLight(direction, irradiance, values["angle"][0] / 2, is_seen=False)


def _light_at(world: bpy.types.World, sun: bpy.types.Object | None, frame: int) -> tuple[ObjectLight, float]:
    """The light at `frame`, by its keys, so that the frame need not be shown, and the exposure that it carries.

    Its spherical harmonics and its key light, without reflections.
    """
    inputs = inputs_of_world(world)
    rest = np.array([tuple(inputs[one].default_value) for one in COEFFICIENTS], np.float64)[:, :3]
    gain = float(inputs[GAIN].default_value)
    for index, curve in light_curves(world):
        if index < len(COEFFICIENTS):
            rest[index, curve.array_index] = curve.evaluate(frame)
        else:
            gain = curve.evaluate(frame)
    key = None if sun is None else _key_at(sun, frame, 1.0 / gain)
    rest = in_rec709(rest)
    return ObjectLight(rest + sh_of_key_light(key), key), 1.0 / gain
