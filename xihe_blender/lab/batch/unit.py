"""Unit of a batch, one scene with one seed, in Blender: everything is rendered once, and every trial runs on it.

    prepare -> captures and light probes -> each trial's walk -> trigger sweeps -> comparisons

Captures hold what any of the phones needs. A trial's walk is that of `xihe previs`, on renders that are all there, so
that its numbers are those of a previs run. All trials' lights are compared in one go per frame, each a method of the
comparison: a view layer per virtual object costs little beside the path-traced picture that they are all held against.
Pictures are kept of the worst frame of each trial only: a batch would otherwise leave gigabytes that nobody looks at.
A frame's numbers are written once all of its pictures are, so a stopped unit goes on.
"""

from __future__ import annotations

import contextlib
import functools
import operator
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.compare.methods import Comparer, display, error_map, measure, open_comparer
from xihe_blender.io.kept_files import kept_json
from xihe_blender.io.outputs import RunOutputs, write_json, write_picture
from xihe_blender.jobs import Job, Progress, run_blocking
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.results import WORST_KINDS, worst_frame, worst_picture
from xihe_blender.lab.batch.trials import trial_record, trigger_sweep
from xihe_blender.previs.path_renders import render_path
from xihe_blender.previs.plan import compared_frames, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, render_reuse, survey_run
from xihe_blender.previs.run_chain import WalkedPath, walk_path
from xihe_blender.previs.settings import load_estimator
from xihe_blender.scene.state import scene_kept
from xihenet.json_files import read_json
from xihenet.recording import load_frame
from xihenet.records import ArrayF64

Light = Mapping[str, ArrayF64]
"""(9, 3) coefficients by virtual object."""


def evaluate_unit(scene: bpy.types.Scene, file: Path, folder: Path, settings: BatchSettings, seed: int) -> Job[Any]:
    """Run all trials of `scene` with `seed`, on renders that are kept in `folder`.

    Returns
    -------
    {"trials": one record each (see `trials`), "step_ms": the chain's mean time by trial, "render_s": of everything}

    Raises
    ------
    UserError for a scene that cannot be run
    """
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    outputs = RunOutputs(folder, file.stem)
    trials = settings.trials()
    plan = plan_previs(scene, settings.of_trial(*trials[0], seed))
    survey = survey_run(scene, plan, outputs)
    with scene_kept():
        runs = []
        for phone, estimator in trials:
            # The first trial measures, and the others read what it left.
            wanted = settings.of_trial(phone, estimator, seed)
            runs.append((yield from prepare_run(scene, plan, survey, outputs, wanted, load_estimator(wanted))))
        yield from _capture_all(runs[:: len(settings.estimators)])
        walks = []
        for index, run in enumerate(runs):
            walks.append(run_blocking(walk_path(run)))
            yield run.progress("ground truth", 0, f"trial {index + 1} of {len(runs)} has walked")
        swept = [trigger_sweep(run, walked) for run, walked in zip(runs, walks, strict=True)]
        compared = yield from compare_unit(runs, walks)
    records = [
        trial_record(run, walked, of_trial, of_sweep)
        for run, walked, of_trial, of_sweep in zip(runs, walks, compared.by_trial, swept, strict=True)
    ]
    return {
        "trials": records,
        "step_ms": [_mean_step_ms(walked) for walked in walks],
        "render_s": sum(entry.render_s for entry in walks[0].frames) + compared.render_s,
    }


def _capture_all(runs: Sequence[PreparedRun]) -> Generator[Progress, None, None]:
    """Render every frame that any phone captures, with what any needs beside it; `runs` has one for each phone."""
    first = runs[0]
    needs = functools.reduce(operator.or_, (run.needs for run in runs))
    shared = replace(first, needs=needs, reuse=render_reuse(first.survey, first.effects, needs))
    yield from render_path(shared)


def _mean_step_ms(walked: WalkedPath) -> float | None:
    steps = [sum(entry.stage_ms.values()) / len(entry.probes) for entry in walked.frames if entry.active]
    return float(np.mean(steps)) if steps else None


# ---------------------------------------------------------------------------------------------- comparison


@dataclass(frozen=True, eq=False)
class ComparedUnit:
    """The metrics of each trial by frame, and the seconds that rendering all of them took."""

    by_trial: list[dict[int, dict[str, float | None]]]
    render_s: float


def compare_unit(runs: Sequence[PreparedRun], walks: Sequence[WalkedPath]) -> Generator[Progress, None, ComparedUnit]:
    """A job: every trial against the truth, at the frames that `xihe previs` would compare."""
    first = runs[0]
    step = first.settings.preset_values.comparison_step
    wanted = [compared_frames([frame.frame for frame in walked.frames if frame.active], step) for walked in walks]
    frames = sorted(frozenset[int]().union(*wanted))
    by_trial: list[dict[int, dict[str, float | None]]] = [{} for _ in runs]
    render_s = 0.0
    sources: dict[tuple[Any, ...], int] = {}
    with contextlib.ExitStack() as stack:
        comparer = None
        for done, frame in enumerate(frames):
            yield first.progress("ground truth", done / len(frames), f"comparing frame {frame}")
            trials = [index for index, of_trial in enumerate(wanted) if frame in of_trial]
            lights = {str(index): _light(runs[index], walks[index], frame) for index in trials}
            source = sources.setdefault(_made_from(first, frame, lights), frame)
            file = first.outputs.compared(source)
            content = kept_json(file, dict)
            if content is None:
                if comparer is None:
                    methods = [str(index) for index in range(len(runs))]
                    opened = open_comparer(first.scene, first.plan.objects, methods, first.comparison)
                    comparer = stack.enter_context(opened)
                write_json(file, _compared(first, frame, lights, comparer, by_trial))
                content = read_json(file)
            render_s += content["render_s"] if source == frame else 0.0
            for index in trials:
                by_trial[index][frame] = content["metrics"][str(index)]
    return ComparedUnit(by_trial, render_s)


def _light(run: PreparedRun, walked: WalkedPath, frame: int) -> Light:
    """What the objects are lit by in a trial."""
    return walked.lights[frame][run.settings.estimator]


def _made_from(run: PreparedRun, frame: int, lights: Mapping[str, Light]) -> tuple[Any, ...]:
    """Equal for frames whose comparisons are: scene, camera, capture and every trial's light are the same."""
    captured = load_frame(run.outputs.capture(frame))
    of_all = [light.tobytes() for of_trial in lights.values() for light in of_trial.values()]
    names = ",".join(lights).encode()
    return run.reuse.comparison(frame, captured.srgb_u8.tobytes(), captured.plane_depth_m.tobytes(), names, *of_all)


def _compared(
    run: PreparedRun,
    frame: int,
    lights: Mapping[str, Light],
    comparer: Comparer,
    so_far: Sequence[Mapping[int, Mapping[str, float | None]]],
) -> dict[str, Any]:
    """Metrics of each trial at `frame`; pictures are written of those that are worse than `so_far`."""
    dark = {item.name: np.zeros((9, 3)) for item in run.plan.objects}
    of_all = {method: lights.get(method, dark) for method, _ in comparer.worlds}
    compared = comparer.render_comparison(load_frame(run.outputs.capture(frame)), of_all)
    metrics = {}
    for trial in lights:
        picture = compared.methods[trial]
        metrics[trial] = measure(picture, compared.ground_truth, compared.weights)
        if worst_frame({**so_far[int(trial)], frame: metrics[trial]}) == frame:
            shown = (
                display(compared.ground_truth),
                display(picture),
                error_map(picture, compared.ground_truth, compared.weights),
            )
            for kind, pixels in zip(WORST_KINDS, shown, strict=True):
                write_picture(worst_picture(run.outputs.folder, int(trial), kind), pixels)
    return {"metrics": metrics, "render_s": compared.render_s}
