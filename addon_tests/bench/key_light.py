"""Does the key light point at the lamp? And does it stay there along a walk?

The three-sphere rig walks through each scene as in `light_parts.py`, whose captures in OUT are used again. The lamp is
read off the rendered mirror ball at each position: the middle of the patch of 10 degrees that has most light in it.
Prints the median angle of the key light of the estimate to it, where the phone has seen a lamp and where it has not,
that of the direction of l = 1 alone, and that of the key light of `truth`; and how often the key light jumps by more
than 20 degrees from one estimate to the next and ends farther from the lamp.

    python addon_tests/bench/key_light.py OUT SCENE.blend... [--preset NAME]
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import numpy as np
from light_parts import walked_scene

from xihe_blender.previs.path_renders import true_reflections
from xihe_blender.previs.settings import PrevisSettings
from xihenet.light.key_light import LUMINANCE
from xihenet.light.reflections import N_DIRECTIONS
from xihenet.records import ArrayF64, Reflections
from xihenet.sphere import AnchorLattice

PATCH = np.cos(np.radians(10))
JUMP = np.cos(np.radians(20))


def lamp_of(reflections: Reflections, lattice: AnchorLattice) -> ArrayF64:
    luminance = reflections.radiance.astype(np.float64) @ LUMINANCE
    brightest = np.argsort(luminance)[-64:]
    within = lattice.directions[brightest] @ lattice.directions.T > PATCH
    best = within[np.argmax(within @ luminance)]
    middle = (lattice.directions[best] * luminance[best, None]).sum(axis=0)
    return middle / np.linalg.norm(middle)


def degrees(one: ArrayF64, other: ArrayF64) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--preset", default="draft")
    options = parser.parse_args()
    settings, lattice = PrevisSettings(preset=options.preset, light="sh+key+reflections"), AnchorLattice(N_DIRECTIONS)
    of_all = defaultdict(list)
    for file in options.scenes:
        run, walked = walked_scene(file, options.out / file.stem, settings)
        found = defaultdict(list)
        for probe in run.plan.probes:
            before = None
            for entry in (entry for entry in walked.frames if probe.name in {one.name for one in entry.probes}):
                lamp = lamp_of(true_reflections(run, probe, entry.frame, lattice), lattice)
                light = walked.lights[entry.frame][settings.estimator][probe.object_name]
                first_band = (light.sh @ LUMINANCE)[[3, 1, 2]]
                found["l = 1"].append(degrees(first_band / np.linalg.norm(first_band), lamp))
                true = walked.lights[entry.frame]["truth"][probe.object_name].key
                found["truth"].append(np.nan if true is None else degrees(true.direction, lamp))
                if light.key is None:
                    found["none"].append(0.0)
                    continue
                angle = degrees(light.key.direction, lamp)
                found["seen" if light.key.is_seen else "not seen"].append(angle)
                if before is not None and light.key.direction @ before < JUMP:
                    found["jumps away" if angle > degrees(before, lamp) else "jumps to it"].append(angle)
                before = light.key.direction
        for name, values in found.items():
            of_all[name] += values
        print(f"{file.stem:26}", *(f"{n} {np.nanmedian(v):.1f} ({len(v)})," for n, v in found.items()), flush=True)
    print(f"{'all':26}", *(f"{n} {np.nanmedian(v):.1f} ({len(v)})," for n, v in of_all.items()))


if __name__ == "__main__":
    main()
