"""Trials of a unit: what is recorded of each, and how it would have fared with a more and a less eager trigger.

The trigger is swept over the captures that are there: both of its thresholds are scaled by one factor, from 0, which
estimates in every frame, to 64. Nothing is rendered, so the sweep has no pictures. Nothing in a record tells the time
or the machine: the same batch gives the same bytes, whoever computes it.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from xihe_blender.io.run_results import METRICS, FrameResult, Metrics
from xihe_blender.lab.batch.results import TrialFigures, TrialFrame, TriggerFigures
from xihe_blender.previs.phone_session import PhoneSession
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import WalkedPath
from xihe_blender.report.values import mean
from xihenet.metrics import shc_rmse
from xihenet.recording import load_frame

FACTORS = (0.0, 0.25, 1.0, 4.0, 16.0, 64.0)
WITHOUT_ANCHORS = ("ambient", "truth")
"""Estimators that look at nothing the trigger watches."""


def trial_figures(
    run: PreparedRun, walked: WalkedPath, compared: Mapping[int, Metrics], swept: Sequence[TriggerFigures]
) -> TrialFigures:
    """One trial: its means, its frames, and what a more or less eager trigger would have done."""
    active = [entry for entry in walked.frames if entry.active]
    probes = [probe for entry in active for probe in entry.probes]
    n_fired = sum(probe.fired for probe in probes)
    not_compared = Metrics(**dict.fromkeys(METRICS))
    frames = tuple(_trial_frame(entry, compared.get(entry.frame, not_compared)) for entry in active)
    return TrialFigures(
        phone=run.settings.phone,
        estimator=run.settings.estimator,
        n_frames=len(walked.frames),
        n_active_frames=len(active),
        n_compared_frames=len(compared),
        n_estimates=n_fired,
        estimates_per_minute=estimates_per_minute(walked, n_fired),
        shc_rmse=mean(probe.shc_rmse for probe in probes),
        coverage=mean(probe.coverage for probe in probes),
        **{metric: mean(getattr(frame, metric) for frame in frames) for metric in METRICS},
        payload_bytes=sum(probe.payload_bytes for probe in probes),
        frames=frames,
        thetas=tuple(swept),
    )


def _trial_frame(entry: FrameResult, compared: Metrics) -> TrialFrame:
    return TrialFrame(
        frame=entry.frame,
        time_s=entry.time_s,
        n_fired=sum(probe.fired for probe in entry.probes),
        shc_rmse=mean(probe.shc_rmse for probe in entry.probes),
        coverage=mean(probe.coverage for probe in entry.probes),
        **vars(compared),
    )


def estimates_per_minute(walked: WalkedPath, n_fired: int) -> float | None:
    """Estimates per minute in which a position is in view, at the path's own frame rate; None without one in view."""
    times = [entry.time_s for entry in walked.frames]
    n_steps = sum(len(entry.probes) for entry in walked.frames)
    if n_steps == 0 or len(times) < 2:
        return None
    step_s: float = (times[-1] - times[0]) / (len(times) - 1)
    return 60 * n_fired / (n_steps * step_s)


def trigger_sweep(run: PreparedRun, walked: WalkedPath) -> list[TriggerFigures]:
    """Of each of FACTORS, with the mean error over positions and frames.

    Empty for estimators that do not look at the anchors, and for a path that sees no position.
    """
    active = [entry for entry in walked.frames if entry.active]
    if run.settings.estimator in WITHOUT_ANCHORS or not active:
        return []
    own = run.settings.trigger
    triggers = [replace(own, theta=f * own.theta, coverage_theta=min(1.0, f * own.coverage_theta)) for f in FACTORS]
    settings = [replace(run.settings, trigger=trigger) for trigger in triggers]
    link = walked.phone.link_in_use
    sessions = [PhoneSession(run.plan, one, run.exposure, run.estimator, link) for one in settings]
    errors: list[list[float]] = [[] for _ in FACTORS]
    n_fired = [0] * len(FACTORS)
    for entry in active:
        seen, _ = walked.phone.see(load_frame(run.outputs.capture(entry.frame)), run.outputs)
        truth = {probe.name: np.array(probe.sh_truth) for probe in entry.probes}
        for index, session in enumerate(sessions):
            step = session.step(seen, truth, list(truth))
            n_fired[index] += sum(report.decision.fire for report in step.reports.values())
            errors[index] += [shc_rmse(session.light(name, seen.time_s), light) for name, light in truth.items()]
    return [
        TriggerFigures(
            factor=factor,
            theta=trigger.theta,
            coverage_theta=trigger.coverage_theta,
            per_minute=estimates_per_minute(walked, fired),
            shc_rmse=statistics.fmean(of_one),
        )
        for factor, trigger, fired, of_one in zip(FACTORS, triggers, n_fired, errors, strict=True)
    ]
