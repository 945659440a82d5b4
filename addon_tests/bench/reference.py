"""How far is the reference light off, held against renders that know nothing of how it is measured?

    python addon_tests/bench/reference.py SCENE.blend... [--presets draft] [--places 2] [--frames 1] [--seeds N]

`hdr` against a fit of bands 0, 1, 2, 4, 6 and 8 to irradiance that Blender bakes onto 200 small white triangles around
the position; `ldr` against the clipped mean of a panorama of 128x64 texels with 1,024 samples. A grey sphere's
brightness under `hdr` is its mean irradiance over the baked one. Positions are those of the virtual objects, or of
empties named `placement_*`. The yardstick's own noise is the difference of two bakes.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from xihe_blender.blend_file import open_blend
from xihe_blender.capture import first_layer, leave_out_virtual_objects, meter_exposure
from xihe_blender.plan import plan_previs
from xihe_blender.previs_settings import PrevisSettings
from xihe_blender.reference_probe import open_reference_probe
from xihe_blender.render import RenderSettings, exclude_collection, render_passes, working_scene
from xihe_blender.virtual_objects import virtual_collection, virtual_objects
from xihenet.panorama import project_panorama
from xihenet.sh import basis, cosine_lobe, irradiance
from xihenet.sphere import AnchorLattice

NORMALS = AnchorLattice(200).directions
BANDS = (0, 1, 2, 4, 6, 8)
BAKED_SAMPLES, PANORAMA_SAMPLES = 1024, 1024


def positions_of(scene):
    """Where light is wanted: (K, 3)."""
    if virtual_objects(scene):
        return np.array([probe.position_m for probe in plan_previs(scene, PrevisSettings()).probes])
    marks = sorted((item for item in scene.objects if item.name.startswith("placement")), key=lambda item: item.name)
    return np.array([tuple(item.matrix_world.translation) for item in marks])


def baked_irradiance(scene, place, seed):
    """(200, 3) irradiance on white triangles around `place`, virtual objects left out."""
    virtual = virtual_collection(scene)
    if virtual is not None:
        exclude_collection(bpy.context.view_layer.layer_collection, virtual)
    target = _triangles(place)
    scene.collection.objects.link(target)
    for item in bpy.context.view_layer.objects:
        item.select_set(item == target)
    bpy.context.view_layer.objects.active = target
    scene.render.engine, scene.cycles.samples, scene.cycles.seed = "CYCLES", BAKED_SAMPLES, seed
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
    colours = np.empty(len(NORMALS) * 12, np.float32)
    target.data.attributes["Bake"].data.foreach_get("color", colours)
    mesh = target.data
    bpy.data.objects.remove(target)
    bpy.data.meshes.remove(mesh)
    return colours.reshape(len(NORMALS), 3, 4)[..., :3].mean(axis=1) * np.pi


def _triangles(place):
    """An object of triangles of a twentieth of a millimetre that face NORMALS, half a millimetre from `place`."""
    across = np.cross(NORMALS, np.where(np.abs(NORMALS[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(NORMALS, across)
    turns = 2 * np.pi * np.arange(3) / 3
    corners = across[:, None] * np.cos(turns)[:, None] + up[:, None] * np.sin(turns)[:, None]
    points = place + 5e-4 * NORMALS[:, None] + 5e-5 * corners
    mesh = bpy.data.meshes.new("Bake")
    mesh.from_pydata(points.reshape(-1, 3).tolist(), [], np.arange(600).reshape(-1, 3).tolist())
    white = bpy.data.materials.new("White")
    white.use_nodes = True
    white.node_tree.nodes.clear()
    shader = white.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (1, 1, 1, 1)
    output = white.node_tree.nodes.new("ShaderNodeOutputMaterial")
    white.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    mesh.materials.append(white)
    mesh.color_attributes.active_color = mesh.color_attributes.new("Bake", "FLOAT_COLOR", "CORNER")
    target = bpy.data.objects.new("Bake", mesh)
    for ray in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(target, f"visible_{ray}", False)
    return target


def fitted(baked):
    """(9, 3) radiance coefficients of irradiance (200, 3)."""
    columns = np.concatenate([np.arange(band**2, (band + 1) ** 2) for band in BANDS])
    coefficients, *_ = np.linalg.lstsq(basis(NORMALS, max(BANDS))[:, columns], baked, rcond=None)
    return coefficients[:9] / np.repeat(cosine_lobe(2), [1, 3, 5])[:, None]


def clipped_panorama(scene, place, frame, exposure):
    """(9, 3) of the light that camera rays see, clipped: a panorama with many samples."""
    with working_scene(scene, "Panorama", RenderSettings((128, 64), PANORAMA_SAMPLES, 77, denoise=False)) as working:
        leave_out_virtual_objects(working, scene)
        working.timeline_markers.clear()
        camera = bpy.data.objects.new("Panorama", bpy.data.cameras.new("Panorama"))
        camera.data.type, camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
        camera.data.clip_start, camera.data.clip_end = 0.001, 1e5
        camera.location, camera.rotation_euler = tuple(place), (math.pi / 2, 0, 0)
        working.camera = camera
        working.frame_set(frame)
        radiance = first_layer(render_passes(working))[0].astype(float)
    return project_panorama(np.clip(radiance * exposure, 0, 1))


def apart(light, reference):
    return float(np.linalg.norm(light - reference) / np.linalg.norm(reference))


def measure(path, options):
    """Print a line for each preset, place and frame of a scene."""
    open_blend(path)
    scene = bpy.context.scene
    places = positions_of(scene)[: options.places]
    exposure = meter_exposure(scene, range(scene.frame_start, scene.frame_end + 1))
    chosen = np.linspace(scene.frame_start, scene.frame_end, options.frames).round().astype(int).tolist()
    for frame in chosen:
        for number, place in enumerate(places):
            probe_lines = [_of_preset(scene, name, place, frame, exposure, options.seeds) for name in options.presets]
            ldr = clipped_panorama(scene, place, frame, exposure)
            scene.frame_set(frame)
            bakes = [baked_irradiance(scene, place, seed) * exposure for seed in (5, 6)]
            baked, between = np.mean(bakes, axis=0), apart(fitted(bakes[0]), fitted(bakes[1])) / 2
            open_blend(path)
            scene = bpy.context.scene
            for name, lights, seconds in probe_lines:
                for light in lights:
                    ball = irradiance(light.hdr, NORMALS).mean() / baked.mean()
                    print(
                        f"{path.stem} {name} frame {frame} place {number}: hdr {apart(light.hdr, fitted(baked)):.3f} "
                        f"(said {light.hdr_noise or 0:.3f}, yardstick {between:.3f}), grey sphere {ball:.3f}; "
                        f"ldr {apart(light.ldr, ldr):.3f} (said {light.ldr_noise or 0:.3f}), "
                        f"L00 {light.ldr[0].sum() / ldr[0].sum() - 1:+.3f}; "
                        f"pictures {light.ldr_samples} + {light.hdr_samples}, {seconds:.1f} s",
                        flush=True,
                    )


def _of_preset(scene, name, place, frame, exposure, n_seeds):
    lights, start = [], time.perf_counter()
    for seed in range(n_seeds):
        with open_reference_probe(scene, [place], replace(PrevisSettings(preset=name).reference, seed=seed)) as probe:
            lights.append(probe.light_at(0, frame, exposure).measured)
    return name, lights, (time.perf_counter() - start) / n_seeds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path, metavar="SCENE.blend")
    parser.add_argument("--presets", type=lambda text: text.split(","), default=["draft", "balanced", "accurate"])
    parser.add_argument("--places", type=int, default=4)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    for path in options.scenes:
        measure(path, options)


if __name__ == "__main__":
    main()
