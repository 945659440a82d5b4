"""What is done in Blender for one scene and one seed: everything is rendered once, and every trial runs on it.

    prepare -> captures and light probes -> each trial's walk -> thetas -> comparisons

Captures hold what any of the phones needs. A trial's walk is that of `xihe previs`, on renders that are all there, so
that its numbers are those of a previs run. All trials' lights are compared in one go per frame; see `compare_unit`.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import Job, Progress, run_blocking
from xihe_blender.lab.batch.compare_unit import compare_unit
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.rows import trial_record
from xihe_blender.lab.batch.thetas import sweep_theta
from xihe_blender.previs.path_renders import open_path_renders
from xihe_blender.previs.plan import PrevisPlan, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, render_reuse, survey_run
from xihe_blender.previs.run_chain import WalkedPath, walk_path
from xihe_blender.previs.settings import load_estimator
from xihe_blender.previs.survey import SceneSurvey
from xihe_blender.scene.state import scene_kept


def evaluate_unit(scene: bpy.types.Scene, file: Path, folder: Path, settings: BatchSettings, seed: int) -> Job[Any]:
    """Run all trials of `scene` with `seed`, on renders that are kept in `folder`.

    Returns
    -------
    {"trials": one record each (see `rows`), "step_ms": the chain's mean time by trial, "render_s": of everything}

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
            runs.append((yield from _prepared(scene, plan, survey, outputs, settings, phone, estimator, seed)))
        yield from _capture_all(runs[:: len(settings.estimators)])
        walks = []
        for place, run in enumerate(runs):
            walks.append(run_blocking(walk_path(run)))
            yield _progress(run, len(plan.frames), f"trial {place + 1} of {len(runs)} has walked")
        thetas = [sweep_theta(run, walked) for run, walked in zip(runs, walks, strict=True)]
        compared = yield from compare_unit(runs, walks)
    records = [
        trial_record(run, walked, of_trial, at_thetas)
        for run, walked, of_trial, at_thetas in zip(runs, walks, compared.by_trial, thetas, strict=True)
    ]
    return {
        "trials": records,
        "step_ms": [_mean_step_ms(walked) for walked in walks],
        "render_s": sum(entry["render_s"] for entry in walks[0].frames) + compared.render_s,
    }


def _prepared(
    scene: bpy.types.Scene,
    plan: PrevisPlan,
    survey: SceneSurvey,
    outputs: RunOutputs,
    settings: BatchSettings,
    phone: str,
    estimator: str,
    seed: int,
) -> Job[PreparedRun]:
    """The first trial measures, and the others read what it left."""
    wanted = settings.of_trial(phone, estimator, seed)
    return (yield from prepare_run(scene, plan, survey, outputs, wanted, load_estimator(wanted)))


def _capture_all(runs: Sequence[PreparedRun]) -> Generator[Progress, None, None]:
    """Render every frame that any phone captures, with what any needs beside it; `runs` has one for each phone."""
    first = runs[0]
    needs = functools.reduce(operator.or_, (run.needs for run in runs))
    shared = replace(first, needs=needs, reuse=render_reuse(first.survey, first.effects, needs))
    with open_path_renders(shared) as renders:
        for done, frame in enumerate(shared.plan.frames):
            yield _progress(shared, done, f"capturing frame {frame}")
            renders.at(frame)


def _progress(run: PreparedRun, done: float, doing: str) -> Progress:
    return Progress(done, run.total, doing)


def _mean_step_ms(walked: WalkedPath) -> float | None:
    steps = [sum(entry["stage_ms"].values()) / len(entry["probes"]) for entry in walked.frames if entry["active"]]
    return float(np.mean(steps)) if steps else None
