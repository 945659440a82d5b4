"""The key light: does it point at the lamp, and does it stay there?

A walk through each scene with the three-sphere rig. The lamp at a sphere is the patch of 10 degrees with most light in
a rendered mirror ball; where one elsewhere has nine tenths of that or more there are two, and no key light is right.
Of a window it is a part; the whole lamp is what shines with a quarter of its brightest or more within 25 degrees.
The phone has seen the lamp if it has seen at least half of its light: of the directions in that patch from a quarter of
the brightest on, weighted by their light, those that were sampled and showed three quarters of the true light, clipped
at white, in each channel. The outside of a shade does not, nor does a wall that was taken for the lamp.

For each scene, in degrees, the median and of how many estimates: the key light of `lattice` where the phone has seen
the lamp, and there the angle to the middle of the whole lamp; where it has not; that of `truth`; and the direction of
l = 1 alone. Then estimates without a key light, those with two equal lamps, which do not count in the others, and how
often it turns by more than 20 degrees from one to the next and ends farther from the lamp.

    python addon_tests/bench/key_light.py OUT SCENE.blend... [--preset NAME] [--size WxH]

Captures in OUT are used again.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
from given import given
from light_parts import scene_of_chain

from xihe_blender.cli.arguments import picture_size
from xihe_blender.io.blender_output import only_our_output
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import ChainResult
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.true_light import true_reflections
from xihenet.buffers import merge_in_sight
from xihenet.camera import unproject_frame
from xihenet.colour import LUMINANCE, srgb_to_linear
from xihenet.io.recording import load_frame
from xihenet.light.reflections import N_DIRECTIONS, thinned
from xihenet.records import ArrayBool, ArrayF64, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

LATTICE = AnchorLattice(N_DIRECTIONS)
PATCH = np.cos(np.radians(10))
APART = np.cos(np.radians(25))
JUMP = np.cos(np.radians(20))
EQUAL = 0.9


def patch_of_most_light(luminance: ArrayF64) -> ArrayBool:
    brightest = np.argsort(luminance)[-256:]
    within = LATTICE.directions[brightest] @ LATTICE.directions.T > PATCH
    best: ArrayBool = within[np.argmax(within @ luminance)]
    return best


def middle_of(patch: ArrayBool, luminance: ArrayF64) -> ArrayF64:
    middle = luminance[patch] @ LATTICE.directions[patch]
    return middle / np.linalg.norm(middle)


def whole_lamp(luminance: ArrayF64, lamp: ArrayF64) -> ArrayF64:
    """(3,) its middle."""
    for _ in range(5):
        near = LATTICE.directions @ lamp > APART
        lamp = middle_of(near & (luminance >= luminance[near].max() / 4), luminance)
    return lamp


def has_equal(luminance: ArrayF64, patch: ArrayBool, lamp: ArrayF64) -> bool:
    elsewhere = np.where(LATTICE.directions @ lamp > APART, 0.0, luminance)
    return bool(elsewhere[patch_of_most_light(elsewhere)].sum() >= EQUAL * luminance[patch].sum())


def was_seen(radiance: ArrayF64, patch: ArrayBool, cloud: UnitSphereCloud) -> bool:
    luminance = radiance @ LUMINANCE
    weights = np.where(patch & (luminance >= luminance[patch].max() / 4), luminance, 0.0)
    shows = srgb_to_linear(cloud.srgb.astype(np.float64)) >= 0.75 * np.minimum(radiance, 1)
    return bool(weights @ (cloud.is_set & shows.all(axis=1)) >= weights.sum() / 2)


def degrees(one: ArrayF64, other: ArrayF64) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def estimates(run: PreparedRun, chain: ChainResult, probe: Probe) -> Iterator[tuple[int, int, UnitSphereCloud]]:
    """Of each estimate for the probe: its frame, the first at which it is in use, and all that was seen up to it."""
    known, clouds, last = UnitSphereCloud.empty(len(LATTICE)), {}, None
    for entry in chain.frames:
        told = next((one for one in entry.probes if one.name == probe.name), None)
        if told is None:
            continue
        captured = load_frame(run.outputs.capture(entry.frame))
        points = thinned(unproject_frame(captured, reference_exposure=run.exposure))
        known = merge_in_sight(known, sample_unit_sphere(points, probe.at(entry.frame), LATTICE))
        clouds[entry.frame] = known
        if told.light_frame not in (None, last):
            last = told.light_frame
            yield last, entry.frame, clouds[last]


def angles(run: PreparedRun, chain: ChainResult, estimator: str) -> dict[str, list[float]]:
    """Degrees between the lamp and the key light, by what the bench asks."""
    found: dict[str, list[float]] = defaultdict(list)
    for probe in run.plan.probes:
        before = None
        for estimated, frame, cloud in estimates(run, chain, probe):
            radiance = true_reflections(run, probe, estimated, LATTICE).radiance.astype(np.float64)
            luminance = radiance @ LUMINANCE
            patch = patch_of_most_light(luminance)
            lamp, light = middle_of(patch, luminance), chain.lights[frame][estimator][probe.object_name]
            true = chain.lights[estimated]["truth"][probe.object_name].key
            key = light.key
            angle = np.nan if key is None else degrees(key.direction, lamp)
            has_jumped = key is not None and before is not None and key.direction @ before < JUMP
            if has_jumped and angle > degrees(before, lamp):
                found["away"].append(angle)
            before = before if key is None else key.direction
            if has_equal(luminance, patch, lamp):
                found["equal"].append(angle)
                continue
            first_band = (light.sh @ LUMINANCE)[[3, 1, 2]]
            found["l = 1"].append(degrees(first_band / np.linalg.norm(first_band), lamp))
            found["truth"].append(np.nan if true is None else degrees(true.direction, lamp))
            if key is None:
                found["none"].append(angle)
                continue
            if was_seen(radiance, patch, cloud):
                found["saw"].append(angle)
                found["whole"].append(degrees(key.direction, whole_lamp(luminance, lamp)))
            else:
                found["did not"].append(angle)
    return found


MEDIANS = ("saw", "whole", "did not", "truth", "l = 1")
COUNTS = ("none", "equal", "away")


def row(name: str, found: dict[str, list[float]]) -> str:
    medians = (f"{of} {np.nanmedian(found[of]):.1f} ({len(found[of])})" if found[of] else f"{of} -" for of in MEDIANS)
    return ", ".join([f"{name:26}", *medians, *(f"{of} {len(found[of])}" for of in COUNTS)])


def main() -> None:
    options = given(__doc__, "out", "scenes+", preset="draft", size=(picture_size, None))
    settings = PrevisSettings(preset=options.preset, size=options.size, light="sh+key+reflections")
    of_all: dict[str, list[float]] = defaultdict(list)
    for file in options.scenes:
        found = angles(*scene_of_chain(file, options.out / file.stem, settings), settings.estimator)
        for name, values in found.items():
            of_all[name] += values
        print(row(file.stem, found), flush=True)
    print(row("all", of_all))


if __name__ == "__main__":
    with only_our_output():
        main()
