"""The reference light: how far is it off, held against renders that know nothing of how it is measured?

    python addon_tests/bench/reference.py SCENE.blend... [--presets draft] [--targets hdr] [--places 2] [--frames 1]
        [--seeds N]

`hdr` against a fit of bands 0, 1, 2, 4, 6 and 8 to irradiance that Blender bakes onto 200 small white triangles around
the position; `ldr` against two cubes of 10,000 directions, each path-traced alone with 512 samples and clipped then.
Positions are those of the virtual objects, or of empties named `placement_*`. A yardstick's own noise is half the
difference of two bakes or cubes; "mean light" is the signed error of L00.

At the end, for each preset: how many probes are off by at most what they tell, and by at most twice that, where the
yardstick's noise is added to what is told as a square.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import NamedTuple

import bpy
import numpy as np
from given import given, words
from mathutils import Matrix

from xihe_blender.capture.reference_probe import open_reference_probe
from xihe_blender.capture.render import RenderSettings, exclude_collection, render_passes
from xihe_blender.capture.scanner import first_layer, meter_exposure, working_room
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.props.surfaces import Shader
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import show_to_camera_alone
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.sh import basis, cosine_lobe
from xihenet.sphere import AnchorLattice

NORMALS = AnchorLattice(200).directions
BANDS = (0, 1, 2, 4, 6, 8)
BAKED_SAMPLES = 1024
ACROSS, VIEW_SAMPLES = 42, 512
"""Pixels along an edge of a cube; and rays in each of them."""

CUBE_TURNS = (0.3, 0.9)
"""Radians: no face lies level, so that edges of the room do not run along rows."""


def positions_of(scene):
    """Where light is wanted: (K, 3)."""
    if virtual_objects(scene):
        return np.array([probe.position_m for probe in plan_previs(scene, PrevisSettings()).probes])
    marks = sorted((item for item in scene.objects if item.name.startswith("placement")), key=lambda item: item.name)
    return np.array([tuple(item.matrix_world.translation) for item in marks])


def baked_irradiance(scene, place, seed):
    """(200, 3) irradiance on white triangles around `place`, virtual objects left out."""
    virtual, layer = virtual_collection(scene), bpy.context.view_layer
    if virtual is not None:
        exclude_collection(layer.layer_collection, virtual)
    target = _triangles(place)
    scene.collection.objects.link(target)
    for item in layer.objects:
        item.select_set(item == target)
    layer.objects.active = target
    scene.render.engine, scene.cycles.samples, scene.cycles.seed = "CYCLES", BAKED_SAMPLES, seed
    bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, target="VERTEX_COLORS")
    colours = np.empty(len(NORMALS) * 12, np.float32)
    target.data.attributes["Bake"].data.foreach_get("color", colours)
    bpy.data.meshes.remove(target.data)  # and with it the object
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
    white = Shader("White")
    white.set(white.output, {"Surface": white.add("BsdfDiffuse", {"Color": (1.0, 1.0, 1.0)}).outputs[0]})
    mesh.materials.append(white.material)
    mesh.color_attributes.active_color = mesh.color_attributes.new("Bake", "FLOAT_COLOR", "CORNER")
    target = bpy.data.objects.new("Bake", mesh)
    show_to_camera_alone(target)
    return target


def fitted(baked):
    """(9, 3) radiance coefficients of irradiance (200, 3)."""
    columns = np.concatenate([np.arange(band**2, (band + 1) ** 2) for band in BANDS])
    coefficients, *_ = np.linalg.lstsq(basis(NORMALS, max(BANDS))[:, columns], baked, rcond=None)
    return coefficients[:9] / np.repeat(cosine_lobe(2), [1, 3, 5])[:, None]


def clipped_light(scene, place, frame, exposure, turn):
    """(9, 3) of what camera rays see, clipped: the faces of a cube turned by `turn` about two axes, in radians.

    Each pixel is path-traced alone with VIEW_SAMPLES and a hundredth of it is looked at, so that what is clipped is the
    light of one direction and not the mean of many.
    """
    total, whole = np.zeros((9, 3)), 0.0
    with working_room(scene, "Cube", RenderSettings((ACROSS, ACROSS), VIEW_SAMPLES, 77, denoise=False)) as working:
        working.timeline_markers.clear()
        working.cycles.pixel_filter_type, working.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        camera = bpy.data.objects.new("Cube", bpy.data.cameras.new("Cube"))
        camera.data.angle, camera.data.clip_start, camera.data.clip_end = math.pi / 2, 0.001, 1e5
        working.camera = camera
        working.frame_set(frame)
        for around, up in ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (3, 1)):
            face = Matrix.Rotation(around * math.pi / 2, 3, "Z") @ Matrix.Rotation(up * math.pi / 2, 3, "X")
            turned = Matrix.Rotation(turn, 3, "X") @ Matrix.Rotation(turn, 3, "Z") @ face
            camera.matrix_world = Matrix.Translation(place) @ turned.to_4x4()
            seen = np.clip(np.nan_to_num(first_layer(render_passes(working))[0].astype(float)) * exposure, 0, 1)
            # Rows run from the top.
            x, y = np.meshgrid(*2 * [(np.arange(ACROSS) + 0.5) / ACROSS * 2 - 1])
            rays = np.stack([x, -y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
            solid_angle = np.linalg.norm(rays, axis=1) ** -3
            directions = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ np.array(turned).T
            total += basis(directions, 2).T @ (seen.reshape(-1, 3) * solid_angle[:, None])
            whole += solid_angle.sum()
    bpy.data.cameras.remove(camera.data)
    return total * (4 * np.pi / whole)


def apart(light, reference):
    return float(np.linalg.norm(light - reference) / np.linalg.norm(reference))


def measure(path, options):
    """Print a line for each preset, target, place, frame and seed of a scene, and return what was found."""
    open_blend(path)
    scene = bpy.context.scene
    places = positions_of(scene)[: options.places]
    exposure = run_blocking(meter_exposure(scene, range(scene.frame_start, scene.frame_end + 1)))
    chosen = np.linspace(scene.frame_start, scene.frame_end, options.frames).round().astype(int).tolist()
    found = []
    for frame in chosen:
        for number, place in enumerate(places):
            measured = [_of_preset(scene, name, place, frame, exposure, options) for name in options.presets]
            truths = {}
            if "ldr" in options.targets:
                truths["ldr"] = [clipped_light(scene, place, frame, exposure, turn) for turn in CUBE_TURNS]
            if "hdr" in options.targets:
                scene.frame_set(frame)
                truths["hdr"] = [fitted(baked_irradiance(scene, place, seed) * exposure) for seed in (5, 6)]
            open_blend(path)
            scene = bpy.context.scene
            for name, lights, seconds in measured:
                for light, target in ((light, target) for light in lights for target in truths):
                    found.append(compared(name, target, light, *truths[target]))
                    told = f"{found[-1]}; pictures {light.samples(target)}, {seconds:.1f} s for all"
                    print(f"{path.stem} frame {frame} place {number} {told}", flush=True)
    return found


def compared(preset, target, light, *truths):
    """One probe's light against two cubes or bakes at its place."""
    truth, ours = np.mean(truths, axis=0), light.of(target)
    mean = ours[0].sum() / truth[0].sum() - 1
    return Found(preset, target, apart(ours, truth), light.expected_error(target) or 0, apart(*truths) / 2, mean)


class Found(NamedTuple):
    """How far one probe is off, what it tells of itself, the yardstick's own noise, and the signed error of L00."""

    preset: str
    target: str
    off: float
    told: float
    yardstick: float
    mean: float

    def __str__(self):
        told = f"(told {self.told:.3f}, yardstick {self.yardstick:.3f}), mean light {self.mean:+.3f}"
        return f"{self.preset} {self.target}: {self.off:.3f} {told}"


def summary(found):
    """A line for each preset and target."""
    for preset, target in dict.fromkeys((one.preset, one.target) for one in found):
        those = np.array([one[2:] for one in found if one[:2] == (preset, target)])
        off, told, yardstick, mean = those.T
        times = off / np.maximum(np.hypot(told, yardstick), 1e-9)
        print(
            f"{preset} {target}: {len(off)} probes, off by {np.median(off):.3f} (median), {off.max():.3f} (most); "
            f"within what they tell {np.mean(times <= 1):.2f}, within twice that {np.mean(times <= 2):.2f}; "
            f"mean light {mean.min():+.3f} to {mean.max():+.3f}, {mean.mean():+.4f} in the mean"
        )


def _of_preset(scene, name, place, frame, exposure, options):
    lights, start = [], time.perf_counter()
    for seed in range(options.seeds):
        settings = replace(PrevisSettings(preset=name).reference, seed=seed, aims_at_ldr="ldr" in options.targets)
        with open_reference_probe(scene, [place], settings) as probe:
            lights.append(probe.light_at(0, frame, exposure).measured)
    return name, lights, (time.perf_counter() - start) / options.seeds


def main():
    options = given(__doc__, "scenes+", presets=(words, list(PRESETS)), targets=(words, ["ldr", "hdr"]),
                    places=4, frames=3, seeds=1)  # fmt: skip
    summary([one for path in options.scenes for one in measure(path, options)])


if __name__ == "__main__":
    with only_our_output():
        main()
