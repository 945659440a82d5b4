"""Odd places: is the reference light that of white triangles inside glass, close above a floor, beside a mirror, behind
a pane of glass, and in a polished room?

    python addon_tests/bench/odd_places.py [--blur 1] [--places mirror,pane]

`hdr` of 24 pictures against irradiance that Blender bakes around the same place (`reference.py`), with `blur` as the
scene's Filter Glossy; and its mean inside a sphere of glass under an even sky, where all of it arrives without blur.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy
import numpy as np
from given import given, words
from reference import apart, baked_irradiance, fitted

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "addon_tests" / "in_blender")]

from effect_scenes import glass, shader_look, shader_node  # noqa: E402
from tiny_scenes import add_lamp, box, empty_scene, material, set_world, sphere  # noqa: E402

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe  # noqa: E402
from xihe_blender.io.blender_output import only_our_output  # noqa: E402

SETTINGS = ProbeSettings(96, 24, noise_target=None)
PLACES_M = {
    "middle of glass": (0, 0, 1), "glass": (0.06, 0, 1.03), "bump": (0.1, 0.05, 0.01), "normals": (0.1, 0.05, 0.01),
    "flat": (0.1, 0.05, 0.01), "mirror": (-0.56, 0.1, 1.1),
    "pane": (-0.613, 0.1, 1.1), "polished": (0.3, 0.2, 0.15),
}  # fmt: skip


def room(kind, blur):
    """A coloured floor and two walls under a lamp and a sky, and what `kind` names."""
    scene = empty_scene()
    scene.cycles.blur_glossy, scene.cycles.max_bounces = blur, 32
    scene.cycles.transmission_bounces = scene.cycles.glossy_bounces = 32
    roughness = 0.08 if kind == "polished" else 0.5
    floor = shader_look("Floor", "BsdfPrincipled", Base_Color=(0.6, 0.5, 0.4, 1), Roughness=roughness)
    tree = floor.node_tree
    if kind in ("bump", "normals"):
        node, fed, by = ("Bump", "Height", "Fac") if kind == "bump" else ("NormalMap", "Color", "Color")
        noise, turned = shader_node(tree, "TexNoise", Scale=40.0), shader_node(tree, node)
        tree.links.new(noise.outputs[by], turned.inputs[fed])
        tree.links.new(turned.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    bpy.ops.mesh.primitive_plane_add(size=5.0)
    bpy.context.object.data.materials.append(floor)
    box(scene, "West", (-2, 0, 1.2), (0.1, 5, 2.4), material("West", (0.7, 0.15, 0.12)))
    box(scene, "North", (0, 2, 1.2), (5, 0.1, 2.4), material("North", (0.2, 0.3, 0.75)))
    if kind == "polished":
        look = shader_look("Steel", "BsdfAnisotropic", Roughness=0.05, Color=(0.9, 0.9, 0.9, 1))
        box(scene, "Steel", (1, 0.3, 0.4), (0.6, 0.6, 0.6), look)
    if kind == "pane":
        box(scene, "Pane", (-0.59, 0, 1.2), (0.006, 2, 2), glass())
    if "glass" in kind:
        sphere(scene, "Glass", (0, 0, 1), 0.1, glass())
    if kind == "mirror":
        look = shader_look("Mirror", "BsdfAnisotropic", Roughness=0.0, Color=(0.9, 0.9, 0.9, 1))
        box(scene, "Mirror", (-0.6, 0, 1.2), (0.02, 2, 2), look)
    add_lamp(scene, "AREA", (0.5, 0.4, 2.5), energy=50).data.size = 0.5
    set_world(scene, (0.3, 0.3, 0.4))
    return scene


def hdr(scene, place):
    with open_reference_probe(scene, [place], SETTINGS) as probe:
        return probe.light_at(0, 1).measured


def main():
    options = given(__doc__, blur=1.0, places=(words, list(PLACES_M)))
    blur = options.blur
    scene = empty_scene()
    set_world(scene, (1, 1, 1))
    scene.cycles.blur_glossy = blur
    sphere(scene, "Glass", (0, 0, 1), 0.1, glass())
    mean = hdr(scene, (0, 0, 1)).hdr[0].mean() / math.sqrt(4 * math.pi)
    print(f"glass under an even sky: {mean:.3f} of it", flush=True)
    for kind in options.places:
        scene, place = room(kind, blur), PLACES_M[kind]
        light = hdr(scene, place)
        bakes = [fitted(baked_irradiance(scene, np.array(place), seed)) for seed in (5, 6)]
        off, noise = apart(light.hdr, np.mean(bakes, axis=0)), math.hypot(light.hdr_noise, apart(*bakes) / 2)
        print(f"{kind}: off by {off:.3f}, noise of both {noise:.3f}", flush=True)


if __name__ == "__main__":
    with only_our_output():
        main()
