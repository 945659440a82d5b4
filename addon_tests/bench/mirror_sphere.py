"""A real mirror sphere: what does it tell of the light, beside estimators that look at the room, and what does it cost?

The three-sphere rig walks through each scene as in `light_parts.py`. At every n-th frame a mirror sphere stands at each
position in turn, as GLEAM has it, and its light is projected. Errors are the SHC RMSE against the reference light of
all of the light (`hdr`) and of what a picture can hold (`ldr`), and the RMSE of the picture of the spheres, all in the
mean over frames and positions. Coverage is the share of anchors that are set, of one frame for the sphere and of all
frames so far for the others.

    python addon_tests/bench/mirror_sphere.py OUT SCENE.blend... [--every N] [--preset NAME]
"""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from given import given
from light_parts import scene_of_chain

from xihe_blender.capture.mirror_sphere import RADIUS_M, open_mirror_sphere
from xihe_blender.capture.reference_probe import MeasuredLight
from xihe_blender.compare.methods import measure, open_comparer
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.json_records import from_json
from xihe_blender.previs.settings import PrevisSettings
from xihenet import estimators
from xihenet.io.json_files import read_json
from xihenet.io.recording import load_frame
from xihenet.metrics import shc_rmse
from xihenet.mirror_sphere import mirror_sphere_cloud
from xihenet.records import ObjectLight
from xihenet.sphere import AnchorLattice

OTHERS = ("projection",)


def measured(file: Path, out: Path, settings: PrevisSettings, every: int) -> dict[str, dict[str, list[float]]]:
    """By method and figure, a value for each frame and position."""
    run, chain = scene_of_chain(file, out, settings)
    lattice, projection = AnchorLattice(settings.n_anchors), estimators.load("projection")
    found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    frames = [entry for entry in chain.frames if entry.active][::every]
    lights: dict[int, dict[str, dict[str, ObjectLight]]] = {}
    last: dict[str, ObjectLight] = {}
    with open_mirror_sphere(run.scene, run.capture) as sphere:
        for entry in frames:
            for probe in (probe for probe in run.plan.probes if probe.name in {one.name for one in entry.probes}):
                seen = sphere.seen_at(entry.frame, probe.at(entry.frame), run.exposure)
                if seen is None:
                    continue
                start = time.perf_counter()
                cloud = mirror_sphere_cloud(seen[0], probe.at(entry.frame), RADIUS_M, lattice)
                sh = projection.estimate(cloud)
                found["probe"]["ms"].append(1e3 * (time.perf_counter() - start))
                found["probe"]["render_s"].append(seen[1])
                found["probe"]["coverage"].append(float(cloud.is_set.mean()))
                last[probe.object_name] = ObjectLight(sh)
            lights[entry.frame] = chain.lights[entry.frame] | {"probe": dict(last)}
    methods = [settings.estimator, *settings.others, "ambient", "probe"]
    for entry in frames:
        for one in entry.probes:
            index = [probe.name for probe in run.plan.probes].index(one.name)
            reference = from_json(MeasuredLight, read_json(run.outputs.reference(index, one.name, entry.frame)))
            found[settings.estimator]["coverage"].append(one.coverage)
            for method in methods:
                light = lights[entry.frame][method].get(one.object)
                if light is not None:
                    found[method]["hdr"].append(shc_rmse(light.sh, reference.of("hdr")))
                    found[method]["ldr"].append(shc_rmse(light.sh, reference.of("ldr")))
    with open_comparer(run.scene, run.plan.objects, methods, run.comparison) as comparer:
        for entry in frames:
            of_all = {method: lights[entry.frame][method] for method in methods}
            if len(of_all["probe"]) < len(run.plan.objects):
                continue
            compared = comparer.render_comparison(load_frame(run.outputs.capture(entry.frame)), of_all)
            for method in methods:
                metrics = measure(compared.methods[method], compared.ground_truth, compared.weights, compared.ring)
                for name in ("rmse", "si_rmse", "angular_deg"):
                    value = getattr(metrics, name)
                    if value is not None:
                        found[method][name].append(value)
    return found


def main() -> None:
    options = given(__doc__, "out", "scenes+", preset="draft", every=8)
    settings = PrevisSettings(estimator="lattice", others=OTHERS, preset=options.preset)
    for file in options.scenes:
        found = measured(file, options.out / file.stem, settings, options.every)
        for method, figures in found.items():
            means = " ".join(f"{name} {np.mean(values):.4f}" for name, values in figures.items())
            print(f"{file.stem:24} {method:12} {means}", flush=True)


if __name__ == "__main__":
    with only_our_output():
        main()
