"""Parts of a light: what does each bring to the picture? Mirror, matte silver and diffuse sphere under each of them.

One walk along the path, and at every n-th of its frames the spheres under all of the estimate as spherical harmonics,
under its key light and the rest, and under those with a picture for glossy rays; the same of `truth`. Errors are of
linear colour at the session's exposure, inside each sphere, in the mean over frames; `shown_rmse` is that of colour
clipped at white, as a display shows it. In the ring around the spheres, where their shadow falls, all of them count at
once, by RMSE of colour clipped at white; under spherical harmonics alone there is no shadow.

The ground truth takes more samples than the preset's comparisons, since with 8 the lamps that a mirror shows are as
much noise as picture.

    python addon_tests/bench/light_parts.py OUT SCENE.blend... [--estimator NAME] [--every N] [--preset NAME]
        [--samples N]

OUT/SCENE has a picture of each compared frame: the ground truth, the estimate under each of the parts, and `truth`.

The three-sphere rig takes the place of a scene's first virtual object and of all others; without any it stands under
the empty `placement_0`. Captures in OUT are used again.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from given import given
from mathutils import Vector

from xihe_blender.cli.arguments import picture_size
from xihe_blender.compare.methods import composite, load_ground_truth, measure, open_comparer, save_ground_truth
from xihe_blender.compare.shadows import ring_around, ring_rmse, shadow_of_all, surfaces_in_view
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.kept_files import read_kept
from xihe_blender.io.outputs import RunOutputs, write_picture
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.compare_path import surfaces_known
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import ChainResult, run_chain
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.estimation_positions import box_corners_m
from xihe_blender.scene.sphere_rig import add_three_sphere_rig
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.io.recording import load_frame
from xihenet.metrics import image_rmse
from xihenet.records import ArrayF64, ObjectLight

PLACE = "placement_0"
PARTS = ("sh", "sh+key", "sh+key+reflections")


def scene_of_chain(file: Path, out: Path, settings: PrevisSettings) -> tuple[PreparedRun, ChainResult]:
    scene = open_blend(file)
    objects = virtual_objects(scene)
    place = under(objects[0]) if objects else below(scene, scene.objects[PLACE].matrix_world.translation)
    for item in objects:
        bpy.data.objects.remove(item)
    add_three_sphere_rig(scene, place)
    bpy.context.view_layer.update()
    plan = plan_previs(scene, settings)
    outputs = RunOutputs(out, file.stem)
    survey = run_blocking(survey_run(scene, plan, outputs))
    run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
    return run, run_blocking(run_chain(run))


def under(item: bpy.types.Object) -> tuple[float, float, float]:
    """The middle of the underside of its box, so that the rig stands where it stood."""
    corners = box_corners_m(item, bpy.context.evaluated_depsgraph_get()) / metres_per_unit(bpy.context.scene)
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return (float(middle[0]), float(middle[1]), float(corners[:, 2].min()))


def below(scene: bpy.types.Scene, place: Vector) -> tuple[float, float, float]:
    """Where one meets the room, straight down from a place in the air."""
    is_hit, found, *_ = scene.ray_cast(bpy.context.evaluated_depsgraph_get(), place, (0, 0, -1))
    return tuple(found if is_hit else place)


def part_of(light: ObjectLight, parts: str) -> ObjectLight:
    if parts == "sh":
        return ObjectLight(light.sh)
    return light if parts.endswith("reflections") else replace(light, reflections=None)


def measured(
    file: Path, out: Path, settings: PrevisSettings, every: int, samples: int
) -> dict[tuple[str, str], list[list[float]]]:
    """RMSE, si-RMSE and shown RMSE at each compared frame, by object and method."""
    run, chain = scene_of_chain(file, out, settings)
    methods = {f"{who} {parts}": (who, parts) for who in (settings.estimator, "truth") for parts in PARTS}
    found = defaultdict(list)
    frames = [entry.frame for entry in chain.frames if entry.active][::every]
    with open_comparer(run.scene, run.plan.objects, list(methods), run.comparison, has_key_light=True) as comparer:
        comparer.ground_truth.cycles.samples = samples
        for frame in frames:
            kept = out / f"truth_{samples}_{frame:04d}.npz"
            truth = read_kept(kept, load_ground_truth)
            if truth is None:
                truth = comparer.render_ground_truth(frame)
                save_ground_truth(kept, truth)
            captured, of_all = load_frame(run.outputs.capture(frame)), chain.lights[frame]
            lights = {
                method: {name: part_of(light, parts) for name, light in of_all[who].items()}
                for method, (who, parts) in methods.items()
            }
            surfaces = surfaces_known(run, frame, comparer)
            in_view = surfaces_in_view(captured, surfaces)
            layers = comparer.render_layers(captured, lights, surfaces).layers
            background = srgb_to_linear(captured.srgb_u8 / 255.0)
            exposed = truth.radiance.astype(np.float64) * captured.exposure
            row = [exposed]
            for method in methods:
                passes = {item.name: layers[comparer.layers[method, item.name]] for item in run.plan.objects}
                has_shadow = methods[method][1] != "sh"
                shaded = background * (shadow_of_all(passes, in_view) if has_shadow else 1)
                row.append(composite(shaded, list(passes.values()), captured)[0])
                weights = composite(shaded, list(passes.values()), captured)[1]
                if weights.sum() > 60:
                    found["ring", method].append([ring_rmse(row[-1], exposed, ring_around(weights)) or 0.0])
                for name, of_one in passes.items():
                    picture, weights = composite(background, [of_one], captured)
                    if weights.sum() > 20:
                        found[name, method].append(errors(picture, exposed, weights))
            write_picture(out / f"parts_{frame:04d}.png", linear_to_srgb(np.clip(np.hstack(row), 0, 1)))
    return found


def errors(picture: ArrayF64, truth: ArrayF64, weights: ArrayF64) -> list[float]:
    shown = image_rmse(np.clip(picture, 0, 1), np.clip(truth, 0, 1), weights)
    of_picture = measure(picture, truth, weights, np.zeros(weights.shape, bool))
    return [of_picture.rmse or 0.0, of_picture.si_rmse or 0.0, shown or 0.0]


def main() -> None:
    options = given(
        __doc__, "out", "scenes+", estimator="lattice", preset="draft", every=4, samples=128, size=(picture_size, None)
    )
    settings = PrevisSettings(
        estimator=options.estimator, preset=options.preset, light="sh+key+reflections", size=options.size
    )
    for file in options.scenes:
        found = measured(file, options.out / file.stem, settings, options.every, options.samples)
        for name, method in found:
            means = zip(("rmse", "si_rmse", "shown_rmse"), np.mean(found[name, method], axis=0), strict=False)
            print(f"{file.stem:28} {name:12} {method:16}", *(f"{m} {v:.4f}" for m, v in means), flush=True)


if __name__ == "__main__":
    with only_our_output():
        main()
