"""The plan of effects: what does it save, and does its picture stay the same? A table over the example scenes.

    python addon_tests/bench/effects.py [--scenes living_room,courtyard] [--size 128x96] [--samples 4] [--seeds 16]

Per scene a capture at the middle frame with the plan, with everything on (all effects, 32 bounces of each kind) and as
the scene itself is set, interleaved seed by seed on one thread. Times are the processor's, which other work on the
machine disturbs least. A ratio is the median over the seeds of two renders that followed each other, with the interval
in which it lies with 95 % (bootstrap over the seeds): what is said of it must hold for its upper end. The means
over the seeds agree where the whole picture's and 16 blocks' differ by no more than two standard errors, see
`addon_tests/agreement.py`.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from given import given, words

from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner
from xihe_blender.cli.arguments import picture_size
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.lab.paper.records import measured
from xihe_blender.light_transport import cycles_settings, required_effects
from xihe_blender.previs.required_effects import positions_in
from xihe_blender.scene.blend_file import open_blend
from xihenet.effects import plan_effects
from xihenet.records import ArrayF32

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "addon_tests" / "in_blender")]

from planned_effects import everything_on  # noqa: E402

from addon_tests.agreement import agreement  # noqa: E402

SCENES = ROOT / "blend_scenes"
HEAD = (
    f"{'scene':<18}{'planning, s':>12}{'plan, s':>9}{'all on, s':>10}{'plan / all on':>22}{'plan / own':>22}"
    f"{'difference':>12}{'errors':>8}{'blocks':>8}  agree"
)


def row(name: str, settings: RenderSettings, n_seeds: int) -> str:
    """One scene's line of the table."""
    scene = open_blend(SCENES / f"{name}.blend")
    start = time.perf_counter()
    required = required_effects(scene, positions_in(scene, scene.frame_start))
    planning_s = time.perf_counter() - start
    plans = {
        "plan": cycles_settings(plan_effects(required, {})),
        "all on": cycles_settings(everything_on(scene, required)),
        "own": (),
    }
    pictures, seconds = rendered(scene, plans, settings, n_seeds)
    found = agreement(pictures["all on"], pictures["plan"])
    return (
        f"{name:<18}{planning_s:12.2f}{min(seconds['plan']):9.3f}{min(seconds['all on']):10.3f}"
        f"{ratio(seconds['plan'], seconds['all on']):>22}{ratio(seconds['plan'], seconds['own']):>22}"
        f"{found.relative_difference:+12.4%}{found.mean_errors:8.2f}{found.block_errors:8.2f}  "
        f"{'yes' if found.holds else 'NO'}"
    )


def rendered(
    scene: bpy.types.Scene, plans: dict[str, tuple[tuple[str, bool | int], ...]], settings: RenderSettings, n_seeds: int
) -> tuple[dict[str, ArrayF32], dict[str, list[float]]]:
    """Pictures (S, H, W, 3) and processor times of every plan over the same seeds; the first round is not timed."""
    pictures: dict[str, list[ArrayF32]] = {name: [] for name in plans}
    seconds: dict[str, list[float]] = {name: [] for name in plans}
    with contextlib.ExitStack() as stack:
        scenes = {name: stack.enter_context(_scene(scene, settings, plan)) for name, plan in plans.items()}
        for working in scenes.values():
            render_passes(working)
        for seed in range(n_seeds):
            for name in _turned(list(plans), seed):
                scenes[name].cycles.seed = seed
                start = time.process_time()
                render = render_passes(scenes[name])
                seconds[name].append(time.process_time() - start)
                pictures[name].append(first_layer(render)[0])
    return {name: np.array(of_plan) for name, of_plan in pictures.items()}, seconds


@contextlib.contextmanager
def _scene(
    scene: bpy.types.Scene, settings: RenderSettings, plan: tuple[tuple[str, bool | int], ...]
) -> Iterator[bpy.types.Scene]:
    planned_settings = RenderSettings(settings.size, settings.samples, denoise=False, light_transport=plan)
    with open_scanner(scene, planned_settings) as scanner:
        scanner.scene.render.threads_mode, scanner.scene.render.threads = "FIXED", 1
        scanner.scene.frame_set((scene.frame_start + scene.frame_end) // 2)
        yield scanner.scene


def _turned(names: list[str], seed: int) -> list[str]:
    """Another one first at every seed, so that none always follows the same one."""
    place = seed % len(names)
    return names[place:] + names[:place]


def ratio(first: list[float], second: list[float]) -> str:
    """The median of the pairs' ratios, and the interval in which it lies with 95 %."""
    found = measured(np.divide(first, second), np.random.default_rng(0), statistic=np.median)
    return f"{found.value:.3f} [{found.low:.3f}, {found.high:.3f}]"


def main() -> None:
    names = sorted(path.stem for path in SCENES.glob("*.blend"))
    options = given(__doc__, scenes=(words, names), size=(picture_size, (128, 96)), samples=4, seeds=16)
    settings = RenderSettings(options.size, options.samples)
    with blender_output_aside() as (stdout, _):
        print(f"{options.size[0]}x{options.size[1]}, {options.samples} samples, {options.seeds} seeds", file=stdout)
        print(HEAD, file=stdout, flush=True)
        for name in options.scenes:
            print(row(name, settings, options.seeds), file=stdout, flush=True)


if __name__ == "__main__":
    main()
