"""Unit of a batch, one scene with one seed, in Blender: everything is rendered once, and every trial runs on it.

    prepare -> captures and light probes -> each trial's chain -> trigger sweeps -> comparisons

Captures hold what any of the phones needs. A trial's chain is that of `xihe previs`, on renders that are all there, so
that its numbers are those of a previs run. All trials' lights are compared in one go per frame, each a method of the
comparison: a view layer per virtual object costs little beside the path-traced picture that they are all held against.
Pictures are kept of the worst frame of each trial only: a batch would otherwise leave gigabytes that nobody looks at.
A frame's numbers are written once all of its pictures are, so a stopped unit goes on.

The trigger is swept over the captures that are there: all of its thresholds are scaled by one factor, from 0, which
estimates in every frame, to 64. One that has none, with "every-frame", stays alone. Nothing is rendered for that, so
the sweep has no pictures. No figure of a trial tells the time or the machine: the same batch gives the same bytes,
whoever computes it.
"""

from __future__ import annotations

import functools
import itertools
import operator
import shutil
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from xihe_blender.compare.methods import Comparison, display, error_map, measure
from xihe_blender.io.folder_manifest import contents_sha256
from xihe_blender.io.json_records import as_json
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json, write_picture
from xihe_blender.io.run_results import METRICS, FrameResult, Metrics, ProbeResult
from xihe_blender.jobs import Job, run_blocking
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.results import (
    WORST_KINDS,
    FilesRead,
    TrialFigures,
    TrialFrame,
    TriggerFigures,
    UnitCost,
    UnitResult,
    worst_frame,
    worst_picture,
)
from xihe_blender.previs.compare_path import compare_frames
from xihe_blender.previs.files_read import files_named, files_read
from xihe_blender.previs.phone_errors import run_sessions
from xihe_blender.previs.plan import check_is_rendered, compared_frames, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, render_reuse, survey_run
from xihe_blender.previs.run_chain import ChainResult, Lights, render_path, run_chain
from xihe_blender.previs.settings import load_estimators
from xihe_blender.report.values import mean
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept

FACTORS = (0.0, 0.25, 1.0, 4.0, 16.0, 64.0)


@dataclass(frozen=True)
class ComparedTrials:
    """The pictures of a frame: metrics by the number of the trial, the seconds that rendering all of them took, and how
    many pixels virtual objects cover."""

    metrics: dict[str, Metrics]
    render_s: float
    object_pixels: float | None = None


def evaluate_unit(file: Path, folder: Path, settings: BatchSettings, seed: int) -> Job[UnitResult]:
    """Run all trials of a .blend with `seed`, on renders that are kept in `folder`; UserError where none can be run."""
    start_s, start_processor_s = time.perf_counter(), time.process_time()
    scene = open_blend(file)
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    outputs = RunOutputs(folder, file.stem)
    trials = settings.trials()
    check_is_rendered(scene)
    read = _begun_with(outputs)
    plan = plan_previs(scene, settings.of_trial(*trials[0], seed))
    survey = yield from survey_run(scene, plan, outputs)
    write_json(outputs.settings, as_json(read))
    with scene_kept():
        runs = []
        for phone, estimator in trials:
            # The first trial measures, and the others read what it left.
            wanted = settings.of_trial(phone, estimator, seed)
            runs.append((yield from prepare_run(scene, plan, survey, outputs, wanted, load_estimators(wanted))))
        # Every frame that any phone captures, with what any needs beside it.
        first, needs = runs[0], functools.reduce(operator.or_, (run.needs for run in runs))
        yield from render_path(replace(first, needs=needs, reuse=render_reuse(first.survey, first.effects, needs)))
        chains = []
        for index, run in enumerate(runs):
            chains.append(run_blocking(run_chain(run)))
            yield run.progress("ground truth", 0, f"trial {index + 1} of {len(runs)} is run")
        swept = [trigger_sweep(run, chain) for run, chain in zip(runs, chains, strict=True)]
        by_trial, pixels, compared_s = yield from compare_unit(runs, chains)
    return UnitResult(
        trials=tuple(map(trial_figures, runs, chains, by_trial, swept, itertools.repeat(pixels))),
        step_ms=tuple(map(step_ms, chains)),
        render_s=render_s(chains) + compared_s,
        cost=_cost(folder, start_s, start_processor_s),
        read=read,
    )


def _begun_with(outputs: RunOutputs) -> FilesRead:
    """What the open file reads from others; renders that a stopped unit made from anything else go."""
    read = FilesRead(patterns=tuple(files_named()), sha256=contents_sha256(files_read()))
    if kept_record(FilesRead, outputs.settings) != read:
        shutil.rmtree(outputs.folder, ignore_errors=True)
    return read


def render_s(chains: Sequence[ChainResult]) -> float:
    """Of all frames that any of the phones captures: they share the renders."""
    return sum(max(entry.render_s for entry in same) for same in zip(*(one.frames for one in chains), strict=True))


def step_ms(chain: ChainResult) -> float | None:
    """The median over the frames: in the first one of the first trial tables are made that all trials share."""
    steps = [sum(entry.stage_ms.values()) / len(entry.probes) for entry in chain.frames if entry.active]
    return statistics.median(steps) if steps else None


def _cost(folder: Path, start_s: float, start_processor_s: float) -> UnitCost:
    return UnitCost(
        elapsed_s=time.perf_counter() - start_s,
        processor_s=time.process_time() - start_processor_s,
        peak_memory_mb=_peak_memory_mb(),
        written_bytes=sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()),
    )


def _peak_memory_mb() -> float | None:
    """The most memory that this process had; None on Windows, which does not count it for Python."""
    try:
        import resource
    except ImportError:
        return None
    # In kilobytes, but for macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


# ---------------------------------------------------------------------------------------------- comparison


def compare_unit(
    runs: Sequence[PreparedRun], chains: Sequence[ChainResult]
) -> Job[tuple[list[dict[int, Metrics]], dict[int, float | None], float]]:
    """Every trial against the truth, at the frames that `xihe previs` would compare.

    Metrics of each trial by frame, pixels that virtual objects cover by frame, and seconds.
    """
    first = runs[0]
    step = first.settings.preset_values.comparison_step
    wanted = [compared_frames([frame.frame for frame in chain.frames if frame.active], step) for chain in chains]
    lights: dict[int, Lights] = {frame: {} for frame in sorted(frozenset[int]().union(*wanted))}
    for trial, (run, chain) in enumerate(zip(runs, chains, strict=True)):
        for frame in wanted[trial]:
            lights[frame][str(trial)] = chain.lights[frame][run.settings.estimator]
    methods = [str(trial) for trial in range(len(runs))]

    def read(frame: int) -> ComparedTrials | None:
        return kept_record(ComparedTrials, first.outputs.compared(frame))

    record = functools.partial(_record_frame, first.outputs.folder, lights)
    compared, sources = yield from compare_frames(first, methods, lights, read, record)
    by_trial = [
        {frame: compared[sources[frame]].metrics[trial] for frame in of_trial}
        for trial, of_trial in zip(methods, wanted, strict=True)
    ]
    # Frames without an object do not count.
    pixels = {frame: compared[source].object_pixels or None for frame, source in sources.items()}
    return by_trial, pixels, sum(one.render_s for one in compared.values())


def _record_frame(
    folder: Path, lights: Mapping[int, Lights], frame: int, compared: Comparison, done: Mapping[int, ComparedTrials]
) -> ComparedTrials:
    """Metrics of each trial at `frame`; pictures are written of those that are worse than all that is `done`."""
    metrics = {}
    for trial in lights[frame]:
        picture = compared.methods[trial]
        metrics[trial] = measure(picture, compared.ground_truth, compared.weights, compared.ring)
        so_far = {other: one.metrics[trial] for other, one in done.items() if trial in one.metrics}
        if worst_frame({**so_far, frame: metrics[trial]}) == frame:
            error = error_map(picture, compared.ground_truth, compared.weights)
            shown = (display(compared.ground_truth), display(picture), error)
            for kind, pixels in zip(WORST_KINDS, shown, strict=True):
                write_picture(worst_picture(folder, int(trial), kind), pixels)
    return ComparedTrials(metrics, compared.render_s, float(compared.weights.sum()))


# ---------------------------------------------------------------------------------------------- trials


def trial_figures(
    run: PreparedRun, chain: ChainResult, compared: Mapping[int, Metrics], swept: Sequence[TriggerFigures],
    pixels: Mapping[int, float | None],
) -> TrialFigures:  # fmt: skip
    """One trial: its means, its frames, and what a more or less eager trigger would have done."""
    active = [entry for entry in chain.frames if entry.active]
    probes = [probe for entry in active for probe in entry.probes]
    not_compared = Metrics(**dict.fromkeys(METRICS))
    frames = tuple(_trial_frame(entry, compared.get(entry.frame, not_compared)) for entry in active)
    n_fired = sum(frame.n_fired for frame in frames)
    return TrialFigures(
        phone=run.settings.phone,
        estimator=run.settings.estimator,
        n_frames=len(chain.frames),
        n_active_frames=len(active),
        n_compared_frames=len(compared),
        n_estimates=n_fired,
        estimates_per_minute=estimates_per_minute(chain, n_fired),
        **_means(probes),
        **{metric: mean(getattr(frame, metric) for frame in frames) for metric in METRICS},
        object_pixels=mean(pixels[frame] for frame in compared),
        payload_bytes=sum(probe.payload_bytes for probe in probes),
        frames=frames,
        trigger_sweep=tuple(swept),
    )


def _trial_frame(entry: FrameResult, compared: Metrics) -> TrialFrame:
    n_fired = sum(probe.fired for probe in entry.probes)
    return TrialFrame(frame=entry.frame, time_s=entry.time_s, n_fired=n_fired, **_means(entry.probes), **vars(compared))


def _means(probes: Sequence[ProbeResult]) -> dict[str, float | None]:
    return {name: mean(getattr(probe, name) for probe in probes) for name in ("shc_rmse", "coverage")}


def estimates_per_minute(chain: ChainResult, n_fired: int) -> float | None:
    """Estimates per minute in which a position is in view, by the frames that reach the phone; None without one."""
    times = [entry.time_s for entry in chain.frames if entry.is_delivered]
    n_steps = sum(len(entry.probes) for entry in chain.frames)
    if n_steps == 0 or len(times) < 2:
        return None
    step_s: float = (times[-1] - times[0]) / (len(times) - 1)
    return 60 * n_fired / (n_steps * step_s)


def trigger_sweep(run: PreparedRun, chain: ChainResult) -> list[TriggerFigures]:
    """Of each of FACTORS, with the mean error over positions and frames.

    Empty for estimators that do not look at the anchors, and for a path that sees no position.
    """
    if not run.estimator.uses_anchors or not any(entry.active for entry in chain.frames):
        return []
    own = run.settings.trigger_in_use
    factors = FACTORS if own.theta or own.coverage_theta else (1.0,)
    triggers = [own.scaled(factor) for factor in factors]
    sessions = run_sessions(run, chain, triggers, chain.phone.link_in_use)
    return [
        TriggerFigures(
            factor=factor,
            theta=trigger.threshold,
            coverage_theta=trigger.coverage_theta,
            per_minute=estimates_per_minute(chain, fired),
            shc_rmse=statistics.fmean(errors),
        )
        for factor, trigger, (fired, errors) in zip(factors, triggers, sessions, strict=True)
    ]
