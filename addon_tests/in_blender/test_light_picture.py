"""The three spheres of a light's picture against Cycles, which renders them under the same spherical harmonics."""

import bpy
import numpy as np
import pytest
from tiny_scenes import empty_scene, material, sphere

from xihe_blender.apply.sh_worlds import apply_sh_to_world, make_sh_world
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer
from xihenet.light_picture import SILVER_ROUGHNESS, sphere_mask, three_spheres

SIDE = 48


def metal(roughness):
    """Reflects all light, without a tint."""
    made = material("Metal", (1.0, 1.0, 1.0))
    nodes = made.node_tree.nodes
    glossy = nodes.new("ShaderNodeBsdfAnisotropic")
    glossy.distribution = "MULTI_GGX"
    glossy.inputs["Color"].default_value = (1, 1, 1, 1)
    glossy.inputs["Roughness"].default_value = roughness
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    made.node_tree.links.new(glossy.outputs[0], output.inputs["Surface"])
    return made


def rendered(look, coefficients):
    """(SIDE, SIDE, 3): a sphere of radius 1, seen by an orthographic camera that looks along +Y."""
    scene = empty_scene()
    sphere(scene, "Ball", (0, 0, 0), 1.0, look())
    data = bpy.data.cameras.new("Camera")
    data.type, data.ortho_scale = "ORTHO", 2.0
    scene.camera = bpy.data.objects.new("Camera", data)
    scene.collection.objects.link(scene.camera)
    scene.camera.location = (0, -5, 0)
    scene.camera.rotation_euler = (np.pi / 2, 0, 0)
    scene.world = make_sh_world("Xihe Ball")
    apply_sh_to_world(scene.world, coefficients, 1.0)
    with working_scene(scene, "Test", RenderSettings((SIDE, SIDE), 128, denoise=False)) as working:
        radiance, _ = first_layer(render_passes(working))
    return radiance.astype(np.float64)


@pytest.mark.parametrize(
    ("place", "look", "tolerance"),
    [
        (0, lambda: metal(0.0), 0.006),
        (1, lambda: metal(SILVER_ROUGHNESS), 0.015),
        (2, lambda: material("Grey", (1.0, 1.0, 1.0)), 0.01),
    ],
    ids=["mirror", "matte silver", "grey diffuse"],
)
@pytest.mark.parametrize("seed", range(2))
def test_the_pictured_sphere_is_the_one_that_cycles_renders(place, look, tolerance, seed):
    coefficients = np.random.default_rng(seed).normal(size=(9, 3)) * 0.3
    coefficients[0] += 3
    expected = three_spheres(coefficients, SIDE)[place]
    # The rim, where a pixel mixes sphere and background and the lobe of a rough metal stretches, is left out.
    x = (2 * np.arange(SIDE) + 1) / SIDE - 1
    inner = sphere_mask(SIDE) & (x[None] ** 2 + x[:, None] ** 2 < 0.8)
    shown = rendered(look, coefficients)
    error = np.sqrt(np.mean((shown - expected)[inner] ** 2)) / expected[inner].mean()
    assert error < tolerance
