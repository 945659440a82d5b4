"""Does an exported USD light a sphere in Blender, by Blender's own import, as the spherical harmonics do?"""

import bpy
import numpy as np
import pytest
from renders import rendered_sphere
from tiny_scenes import empty_scene, material, sphere

from xihenet.light.exports import NamedLight, export_files
from xihenet.light.key_light import rest_of
from xihenet.records import KeyLight, ObjectLight
from xihenet.sh import irradiance

SH = np.eye(9)[0][:, None] * 1.5 + np.eye(9)[[1, 2, 3, 7]].sum(axis=0)[:, None] * (0.3, -0.2, 0.1)
KEY = KeyLight(np.array([-0.48, -0.6, 0.64]), np.array([0.5, 0.4, 0.2]), 1e-3, True)


@pytest.mark.parametrize("key", [None, KEY])
def test_blender_lights_a_sphere_by_the_usd_as_it_is_meant(tmp_path, key):
    light = ObjectLight(SH, key)
    for name, content in export_files([NamedLight("Ball", 1, 0.0, light)], "usd", reading="blender").items():
        (tmp_path / name).write_bytes(content)
    scene = empty_scene()
    sphere(scene, "White", (0, 0, 0), 1.0, material("White", (1, 1, 1)))
    # Its import lights a world that is there, and makes none.
    scene.world = bpy.data.worlds.new("World")
    assert bpy.ops.wm.usd_import(filepath=str(tmp_path / "Ball_0001.usda")) == {"FINISHED"}
    # An importance map whose size Cycles chooses costs seconds.
    scene.world.cycles.sampling_method, scene.world.cycles.sample_map_resolution = "MANUAL", 64
    shown, normals = rendered_sphere(scene, 256, side=24)
    true = irradiance(rest_of(light), normals) / np.pi
    if key is not None:
        true += np.maximum(normals @ key.direction, 0)[:, None] * key.irradiance / np.pi
    assert np.abs(shown - true).mean() < 0.02 * true.mean()
