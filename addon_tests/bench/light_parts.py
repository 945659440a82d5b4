"""What does each part of a light bring to the picture? Mirror, matte silver and diffuse sphere under each of them.

One walk along the path, and at every n-th of its frames the spheres under all of the estimate as spherical harmonics,
under its key light and the rest, and under those with a picture for glossy rays; the same of `truth`, whose picture
is filled from the same frames. Errors are of linear colour at the session's exposure, inside
each sphere, in the mean over frames.

    python addon_tests/bench/light_parts.py OUT SCENE.blend... [--estimator NAME] [--every N] [--preset NAME]

A scene without virtual objects gets the three-sphere rig at its empty `placement_0`. Captures in OUT are used again.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.apply.key_suns import apply_key_to_sun
from xihe_blender.apply.reflection_pictures import reflect_in_world
from xihe_blender.apply.sh_worlds import apply_sh_to_world
from xihe_blender.capture.render import render_passes
from xihe_blender.compare.methods import (
    Comparer,
    composite,
    load_ground_truth,
    measure,
    open_comparer,
    save_ground_truth,
)
from xihe_blender.io.kept_files import read_kept
from xihe_blender.io.outputs import RunOutputs, write_picture
from xihe_blender.io.run_results import Metrics
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import WalkedPath, walk_path
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.sphere_rig import add_three_sphere_rig
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.buffers import merge
from xihenet.camera import unproject_frame
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.light.key_light import rest_of
from xihenet.light.reflections import N_DIRECTIONS, fill_reflections, reflection_panorama
from xihenet.recording import load_frame
from xihenet.records import ArrayF32, ObjectLight, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

PLACE = "placement_0"
PARTS = ("sh", "sh+key", "sh+key+reflections")


def walked_scene(file: Path, out: Path, settings: PrevisSettings) -> tuple[PreparedRun, WalkedPath]:
    scene = open_blend(file)
    if not virtual_objects(scene):
        add_three_sphere_rig(scene, tuple(scene.objects[PLACE].matrix_world.translation))
    bpy.context.view_layer.update()
    plan = plan_previs(scene, settings)
    outputs = RunOutputs(out, file.stem)
    run = run_blocking(
        prepare_run(scene, plan, survey_run(scene, plan, outputs), outputs, settings, load_estimators(settings))
    )
    return run, run_blocking(walk_path(run))


def part_of(light: ObjectLight, parts: str) -> ObjectLight:
    return ObjectLight(light.sh) if parts == "sh" else light


class FinerSpheres:
    """What was seen from the first position of each object so far, on the lattice of the reflections."""

    def __init__(self, run: PreparedRun) -> None:
        self.run, self.lattice = run, AnchorLattice(N_DIRECTIONS)
        self.probes = {item.name: run.plan.probes_of(item.name)[0] for item in run.plan.objects}
        self.seen = {name: UnitSphereCloud.empty(N_DIRECTIONS) for name in self.probes}

    def add(self, frame: int) -> None:
        points = unproject_frame(load_frame(self.run.outputs.capture(frame)), reference_exposure=self.run.exposure)
        for name, probe in self.probes.items():
            self.seen[name] = merge(self.seen[name], sample_unit_sphere(points, probe.at(frame), self.lattice))

    def panorama(self, name: str, light: ObjectLight) -> ArrayF32:
        return reflection_panorama(fill_reflections(self.seen[name], self.lattice, light), self.lattice)


def render_parts(
    comparer: Comparer,
    lights: dict[str, dict[str, ObjectLight]],
    frame: int,
    exposure: float,
    spheres: FinerSpheres,
) -> dict[tuple[str, str], dict[str, ArrayF32]]:
    """Passes by (method, object)."""
    for key, world in comparer.worlds.items():
        light = lights[key[0]][key[1]]
        if key[0].endswith("reflections"):
            reflect_in_world(world, spheres.panorama(key[1], light), exposure)
            comparer.suns[key].visible_glossy = comparer.suns[key].visible_transmission = False
        apply_sh_to_world(world, rest_of(light), exposure)
        apply_key_to_sun(comparer.suns[key], light.key, exposure)
    comparer.lit.frame_set(frame)
    layers = render_passes(comparer.lit).layers
    return {key: layers[name] for key, name in comparer.layers.items()}


def measured(file: Path, out: Path, settings: PrevisSettings, every: int) -> dict[tuple[str, str], list[Metrics]]:
    """Metrics at each compared frame, by object and method."""
    run, walked = walked_scene(file, out, settings)
    methods = [f"{who} {parts}" for who in (settings.estimator, "truth") for parts in PARTS]
    found = defaultdict(list)
    frames = [entry.frame for entry in walked.frames if entry.active][::every]
    with open_comparer(run.scene, run.plan.objects, methods, run.comparison, has_key_light=True) as comparer:
        truths = {}
        for frame in frames:
            kept = out / f"truth_{frame:04d}.npz"
            truths[frame] = read_kept(kept, load_ground_truth)
            if truths[frame] is None:
                truths[frame] = comparer.render_ground_truth(frame)
                save_ground_truth(kept, truths[frame])
        spheres, walked_frames = FinerSpheres(run), [entry.frame for entry in walked.frames if entry.captured]
        for frame in frames:
            while walked_frames and walked_frames[0] <= frame:
                spheres.add(walked_frames.pop(0))
            captured, of_all = load_frame(run.outputs.capture(frame)), walked.lights[frame]
            lights = {
                f"{who} {parts}": {name: part_of(light, parts) for name, light in of_all[who].items()}
                for who in (settings.estimator, "truth")
                for parts in PARTS
            }
            passes = render_parts(comparer, lights, frame, run.exposure, spheres)
            truth = truths[frame].radiance.astype(np.float64) * run.exposure
            background = srgb_to_linear(captured.srgb_u8 / 255.0)
            row = [truth]
            for method in methods:
                row.append(composite(background, [passes[method, i.name] for i in run.plan.objects], captured)[0])
                for item in run.plan.objects:
                    picture, weights = composite(background, [passes[method, item.name]], captured)
                    if weights.sum() > 20:
                        found[item.name, method].append(measure(picture, truth, weights))
            write_picture(out / f"parts_{frame:04d}.png", linear_to_srgb(np.clip(np.hstack(row), 0, 1)))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--estimator", default="lattice")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--every", type=int, default=4)
    options = parser.parse_args()
    settings = PrevisSettings(estimator=options.estimator, preset=options.preset, light="sh+key")
    for file in options.scenes:
        found = measured(file, options.out / file.stem, settings, options.every)
        for name, method in found:
            of_all = found[name, method]
            means = {m: np.mean([getattr(one, m) for one in of_all]) for m in ("rmse", "si_rmse", "ssim")}
            print(f"{file.stem:28} {name:12} {method:16}", *(f"{m} {v:.4f}" for m, v in means.items()), flush=True)


if __name__ == "__main__":
    main()
