"""A mirror sphere rendered in a room tells what light there is, beside the light probe that is rendered there."""

import bpy
import numpy as np
import pytest
from tiny_scenes import box, empty_scene, material, phone

from xihe_blender.capture.mirror_sphere import RADIUS_M, open_mirror_sphere
from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import RenderSettings
from xihenet.estimators import load
from xihenet.metrics import shc_rmse
from xihenet.mirror_sphere import mirror_sphere_cloud
from xihenet.sphere import AnchorLattice

PLACE = np.array([0.2, 0.1, 1.0])


def coloured_room():
    scene = empty_scene()
    box(scene, "Room", (0, 0, 1.25), (4, 4, 2.5), material("Walls", (0.6, 0.5, 0.4)), inward=True)
    box(scene, "Red", (-1.9, 0, 1.0), (0.1, 3, 2), material("Red", (0.7, 0.05, 0.05)))
    box(scene, "Lamp", (0.8, 0.5, 2.3), (0.8, 0.8, 0.05), material("Lamp", (1, 1, 1), 3.0))
    phone(scene, (0.5, -1.5, 1.4), PLACE)
    return scene


def test_light_of_the_sphere_is_that_of_the_light_probe():
    scene, exposure = coloured_room(), 0.5
    before = [{block.name for block in kind} for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.materials)]
    with open_mirror_sphere(scene, RenderSettings((64, 48), 16)) as sphere:
        seen, render_s = sphere.seen_at(1, PLACE, exposure)
        assert sphere.seen_at(1, PLACE + [0, 0, 9], exposure) is None
    cloud = mirror_sphere_cloud(seen, PLACE, RADIUS_M, AnchorLattice(1280))
    with open_reference_probe(scene, [PLACE], ProbeSettings(size=96)) as probe:
        truth = probe.light_at(0, 1, exposure).measured.of("ldr")
    assert render_s > 0 and cloud.is_set.mean() > 0.5
    estimate = load("projection").estimate(cloud)
    assert shc_rmse(estimate, truth) < 0.25 * np.sqrt(np.mean(truth**2))
    assert estimate[3] == pytest.approx(truth[3], abs=0.15)
    after = [{block.name for block in kind} for kind in (bpy.data.objects, bpy.data.meshes, bpy.data.materials)]
    assert after == before
