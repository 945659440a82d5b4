"""The light that a file's virtual objects are lit with, read back from their worlds and suns."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Quaternion

from xihe_blender.apply.key_suns import applied_suns
from xihe_blender.apply.sh_worlds import COEFFICIENTS, GAIN, applied_worlds, f_curves, inputs_of_world
from xihenet.light.key_light import sh_of_key_light
from xihenet.records import KeyLight, ObjectLight


def applied_light(scene: bpy.types.Scene, name: str, frame: int) -> tuple[ObjectLight, float] | None:
    """The light of virtual object `name` of `scene` at `frame`, and the exposure that it carries; None for none.

    Its spherical harmonics and its key light, without reflections. Keys are read, so that the frame need not be shown.
    """
    world, sun = applied_worlds(scene).get(name), applied_suns(scene).get(name)
    if world is None:
        return None
    inputs = inputs_of_world(world)
    rest = np.array([tuple(inputs[one].default_value) for one in COEFFICIENTS], np.float64)[:, :3]
    gain = float(inputs[GAIN].default_value)
    for curve in f_curves(world.node_tree):
        index = int(curve.data_path.rsplit("[", 1)[1].split("]")[0])
        if index < len(COEFFICIENTS):
            rest[index, curve.array_index] = curve.evaluate(frame)
        else:
            gain = curve.evaluate(frame)
    key = None if sun is None else _key_at(sun, frame, 1.0 / gain)
    return ObjectLight(rest + sh_of_key_light(key), key), 1.0 / gain


def key_frames(scene: bpy.types.Scene, name: str) -> list[int]:
    """The frames from which on the light of virtual object `name` is another; empty where nothing keys it."""
    worlds = applied_worlds(scene)
    curves = f_curves(worlds[name].node_tree) if name in worlds else []
    return sorted({round(point.co[0]) for curve in curves for point in curve.keyframe_points})


def _key_at(sun: bpy.types.Object, frame: int, exposure: float) -> KeyLight | None:
    light = sun.data
    assert isinstance(light, bpy.types.SunLight)
    values = {
        "rotation_quaternion": [*sun.rotation_quaternion],
        "color": [*light.color],
        "energy": [light.energy],
        "angle": [light.angle],
    }
    for curve in (*f_curves(sun), *f_curves(light)):
        if curve.data_path in values:
            values[curve.data_path][curve.array_index] = curve.evaluate(frame)
    irradiance = np.array(values["color"]) * values["energy"][0] * exposure
    if not irradiance.max() > 0:
        return None
    # A sun shines along its -Z.
    direction = np.array(Quaternion(values["rotation_quaternion"]).normalized().to_matrix(), np.float64)[:, 2]
    return KeyLight(direction, irradiance, values["angle"][0] / 2, is_seen=False)
