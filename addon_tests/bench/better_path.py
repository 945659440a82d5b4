"""The better path: how far does an advised second of looking lower the true error, beside a random second?

    python addon_tests/bench/better_path.py SCENE.blend ... --out DIR [--part 0.25] [--random 4] [--most 4] [--turn 90]
        [--tried N]

In each scene the phone captures a --part of its path, the look is chosen for each virtual object among --tried frames
and up to --turn degrees off the path, and the look, --random ones and a light probe at the object are rendered. Scenes
without virtual objects get a small sphere at the first empties named `placement_...`, --most of them, in memory. A
random second is at a random frame and in a random direction within the same reach of the same phone, and is captured in
the same way. Errors are SHC RMSE after the last frame of the part, of both targets. A row an object, random seconds by
their mean; medians at the end, of those objects that there was advice for.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TextIO

import bpy
import numpy as np
from given import given

from xihe_blender.cli.arguments import picture_size
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.io.look_results import ObjectAdvice
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.better_path import LookWishes, better_path
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.sphere_rig import sphere_mesh
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.camera_path.looks import LookSettings

RADIUS_M = 0.05
HEAD = "| scene, object | advice | seen | hdr error | lowered by | by random | ldr error | lowered by | by random |"


def add_spheres(scene: bpy.types.Scene, most: int) -> None:
    """A small sphere at each of the first placements of a scene that has no virtual object."""
    if virtual_objects(scene):
        return
    collection = virtual_collection(scene, create=True)
    for empty in sorted((o for o in scene.objects if o.name.startswith("placement_")), key=lambda o: o.name)[:most]:
        ball = bpy.data.objects.new(empty.name.replace("placement", "ball"), sphere_mesh("Ball", RADIUS_M, 16, 8))
        ball.location = empty.matrix_world.translation
        collection.objects.link(ball)
    bpy.context.view_layer.update()


def tried(path: Path, options: argparse.Namespace) -> dict[str, Sequence[ObjectAdvice]]:
    """The advice for each object of a scene, with true errors, by target."""
    scene = open_blend(path)
    add_spheres(scene, options.most)
    frames = list(range(scene.frame_start, scene.frame_end + 1, 1 if scene.frame_end < 30 else 2))
    part = tuple(frames[: max(2, round(options.part * len(frames)))])
    settings = PrevisSettings(preset="draft", size=options.size, frames=part, seed=options.seed)
    looks = LookSettings(largest_turn_deg=options.turn, most_frames=options.tried)
    wishes = LookWishes(is_verified=True, n_random=options.random, looks=looks)
    found = {}
    for target in ("hdr", "ldr"):
        out, of_one = options.out / f"{path.stem}_{len(part)}_{target}", replace(settings, target=target)
        found[target] = run_blocking(better_path(scene, out, of_one, wishes, blend_file=path)).objects
    return found


def row(scene: str, of_targets: Sequence[ObjectAdvice]) -> str:
    """One object with each target."""
    one = of_targets[0]
    seen = f"{one.coverage:.0%} to {one.predicted_coverage:.0%}"
    if one.look is None or one.true_errors is None:
        return f"| {scene}, {one.name} | nothing | {seen} | | | | | | |"
    cells = [f"{scene}, {one.name}", f"{one.look.words} at {one.look.frame}"]
    cells += [f"{seen} (in truth {one.true_errors.coverage_after:.0%})"]
    for true in (of_one.true_errors for of_one in of_targets if of_one.true_errors is not None):
        cells += [f"{true.before:.3f} to {true.after:.3f}", f"{true.lowered:.0%}", f"{true.lowered_by_random or 0:.0%}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    defaults = LookSettings()
    options = given(
        __doc__, "scenes+", out=Path, part=0.25, random=4, most=4, size=(picture_size, (128, 96)),
        turn=defaults.largest_turn_deg, tried=defaults.most_frames, seed=0,
    )  # fmt: skip
    with blender_output_aside() as (stdout, _):
        tell(options, stdout)


def tell(options: argparse.Namespace, stdout: TextIO) -> None:
    """Try every scene, and print the table as it grows."""
    found: dict[str, list[ObjectAdvice]] = {"hdr": [], "ldr": []}
    print(HEAD, "| --- " * 9 + "|", sep="\n", file=stdout, flush=True)
    for path in options.scenes:
        of_scene = tried(path, options)
        for target, objects in of_scene.items():
            found[target] += objects
        rows = [row(path.stem, of_targets) for of_targets in zip(*of_scene.values(), strict=True)]
        print(*rows, sep="\n", file=stdout, flush=True)
    for target, objects in found.items():
        true = [one.true_errors for one in objects if one.true_errors is not None]
        advised = np.median([one.lowered for one in true])
        each = [1 - error / one.before for one in true for error in one.random_after]
        mean = np.median([one.lowered_by_random for one in true])
        counts = (
            f"{target}: {len(true)} of {len(objects)} objects; the advised second lowers the error by {advised:.1%} in"
        )
        by_chance = f"a random one by {np.median(each):.1%} (median of {len(each)}; {mean:.1%} of each object's mean)"
        print(f"{counts} the median, {by_chance}", file=stdout)


if __name__ == "__main__":
    main()
