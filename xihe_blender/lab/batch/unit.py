"""Unit of a batch, one scene with one seed, in Blender: everything is rendered once, and every trial runs on it.

    prepare -> captures and light probes -> each trial's walk -> trigger sweeps -> comparisons

Captures hold what any of the phones needs. A trial's walk is that of `xihe previs`, on renders that are all there, so
that its numbers are those of a previs run. All trials' lights are compared in one go per frame; see `compare_unit`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.scanner import CyclesScanner
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import Job, Progress, run_blocking
from xihe_blender.lab.batch.compare_unit import compare_unit
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.trials import trial_record, trigger_sweep
from xihe_blender.light_transport.render_reuse import KeptRenders
from xihe_blender.previs.path_renders import open_path_renders
from xihe_blender.previs.phone_capture import PhoneCapture
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run
from xihe_blender.previs.run_chain import WalkedPath, walk_path
from xihe_blender.previs.settings import load_estimator
from xihe_blender.scene.state import scene_kept


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
    with scene_kept():
        runs = []
        for phone, estimator in trials:
            # The first trial measures, and the others read what it left.
            wanted = settings.of_trial(phone, estimator, seed)
            runs.append((yield from prepare_run(scene, plan, outputs, wanted, load_estimator(wanted))))
        yield from _capture_all(runs[:: len(settings.estimators)])
        walks = []
        for index, run in enumerate(runs):
            walks.append(run_blocking(walk_path(run)))
            yield _progress(run, len(plan.frames), f"trial {index + 1} of {len(runs)} has walked")
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


class _Phones:
    """All phones of a unit, which share captures: what any of them needs of a render is kept."""

    def __init__(self, phones: Sequence[PhoneCapture]) -> None:
        self.phones = phones
        self.delivered = frozenset[int]().union(*(phone.delivered for phone in phones))

    def prepare(self, scanner: CyclesScanner) -> None:
        for phone in self.phones:
            phone.prepare(scanner)

    def keep(self, scanner: CyclesScanner, frame: int) -> None:
        for phone in self.phones:
            phone.keep(scanner, frame)

    def take_over(self, source: int, frame: int) -> None:
        for phone in self.phones:
            phone.take_over(source, frame)


def _capture_all(runs: Sequence[PreparedRun]) -> Generator[Progress, None, None]:
    """Render every frame that any phone captures; `runs` has one for each phone."""
    # Each trial asks anew which frames are the same.
    first = replace(runs[0], kept=KeptRenders(runs[0].plan.frames, list(runs[0].kept.states.values())))
    phones = _Phones([PhoneCapture(run.scene, run.plan, run.outputs, run.settings, run.exposure) for run in runs])
    with open_path_renders(first, phones) as renders:
        for done, frame in enumerate(first.plan.frames):
            yield _progress(first, done, f"capturing frame {frame}")
            _, probes = renders.move_to(frame)
            if probes:
                renders.at(frame, probes)


def _progress(run: PreparedRun, done: float, doing: str) -> Progress:
    return Progress(done, run.total, doing)


def _mean_step_ms(walked: WalkedPath) -> float | None:
    steps = [sum(entry.stage_ms.values()) / len(entry.probes) for entry in walked.frames if entry.active]
    return float(np.mean(steps)) if steps else None
