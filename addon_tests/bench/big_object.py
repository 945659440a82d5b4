"""A big object, a virtual sofa: is it lit better at several positions than at one?

The sofa, 2.2 m long, is estimated at the positions of an even split, and compared at every n-th frame in three ways:
under the light of the position that is nearest to its middle, under the mean of all, and with every point under the
light of the positions around it. Errors are the RMSE of the picture of all of the sofa, and of its ends alone, the
outer quarters of its length, in the mean over frames.

    python addon_tests/bench/big_object.py OUT SCENE.blend --at X,Y [--yaw DEGREES] [--spacing METRES] [--every N]
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import bpy
import numpy as np
from given import given

from xihe_blender.compare.methods import display, open_comparer
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.outputs import RunOutputs, write_picture
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.props.shapes import add_solid, box, joined
from xihe_blender.lab.props.surfaces import plain
from xihe_blender.previs.compare_path import surfaces_known
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import prepare_run, survey_run
from xihe_blender.previs.run_chain import run_chain
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene import estimation_positions
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.camera import unproject_frame
from xihenet.io.recording import load_frame
from xihenet.metrics import image_rmse
from xihenet.records import ObjectLight

LENGTH_M = 2.2
BOXES = (  # Size and middle: seat, back and arms.
    ((LENGTH_M, 0.85, 0.44), (0.0, 0.0, 0.22)),
    ((LENGTH_M, 0.15, 0.4), (0.0, 0.35, 0.55)),
    ((0.16, 0.85, 0.2), (-1.02, 0.0, 0.5)),
    ((0.16, 0.85, 0.2), (1.02, 0.0, 0.5)),
)
WAYS = ("one", "mean", "each")


def add_sofa(scene: bpy.types.Scene, place: tuple[float, float], yaw: float) -> bpy.types.Object:
    sofa, cloth = joined([box(*one) for one in BOXES]), plain("Cloth", (0.6, 0.6, 0.6), roughness=1.0)
    virtual = virtual_collection(scene, create=True)
    return add_solid(virtual, "Sofa", sofa, cloth, location=(*place, 0.0), turn_deg=yaw)


def in_the_way(light: ObjectLight, way: str) -> ObjectLight:
    if way == "each":
        return light
    places = np.array([place for place, _ in light.at])
    middle = np.argmin(np.linalg.norm(places - (places.min(axis=0) + places.max(axis=0)) / 2, axis=1))
    return replace(light.at[middle][1], at=()) if way == "one" else replace(light, at=())


def main() -> None:
    options = given(__doc__, "out", "scene", at="0,0", yaw=0.0, spacing=0.55, every=4)
    estimation_positions.SPACING_M = options.spacing
    scene = open_blend(options.scene)
    for item in virtual_objects(scene):
        bpy.data.objects.remove(item)
    sofa = add_sofa(scene, tuple(map(float, options.at.split(","))), options.yaw)
    bpy.context.view_layer.update()
    frames = tuple(range(scene.frame_start, scene.frame_end + 1, options.every))
    settings = PrevisSettings(preset="draft", light="sh+key", frames=frames)
    outputs, plan = RunOutputs(options.out, options.scene.stem), plan_previs(scene, settings)
    survey = run_blocking(survey_run(scene, plan, outputs))
    run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
    chain = run_blocking(run_chain(run))
    print(f"{len(plan.probes)} positions")
    found = defaultdict(list)
    methods = {f"{who} {way}": (who, way) for who in (settings.estimator, "truth") for way in WAYS}
    sofa_from_world = np.linalg.inv(np.array(sofa.matrix_world))
    with open_comparer(run.scene, plan.objects, list(methods), run.comparison, has_key_light=True) as comparer:
        for entry in (entry for entry in chain.frames if entry.active):
            captured = load_frame(outputs.capture(entry.frame))
            lights = {
                method: {"Sofa": in_the_way(chain.lights[entry.frame][who]["Sofa"], way)}
                for method, (who, way) in methods.items()
            }
            truth, surfaces = comparer.render_ground_truth(entry.frame), surfaces_known(run, entry.frame, comparer)
            compared = comparer.render_methods(captured, lights, truth, surfaces)
            depth = comparer.render_layers(captured, lights).layers[comparer.layers["truth one", "Sofa"]]["Depth.Z"]
            points = unproject_frame(replace(captured, plane_depth_m=depth)).points_m.reshape(*depth.shape, 3)
            along = points @ sofa_from_world[0, :3] + sofa_from_world[0, 3]
            at_ends = compared.weights * (np.nan_to_num(np.abs(along)) > LENGTH_M / 4)
            if at_ends.sum() < 50:
                continue
            for method, picture in compared.methods.items():
                whole = image_rmse(picture, compared.ground_truth, compared.weights)
                found[method].append((whole, image_rmse(picture, compared.ground_truth, at_ends)))
            shown = [compared.ground_truth, *(compared.methods[method] for method in methods)]
            write_picture(options.out / f"sofa_{entry.frame:04d}.png", display(np.hstack(shown)))
    for method, errors in found.items():
        whole, ends = np.mean(errors, axis=0)
        print(f"{method:16} {len(errors)} frames, all of the sofa {whole:.4f}, its ends {ends:.4f}")


if __name__ == "__main__":
    with only_our_output():
        main()
