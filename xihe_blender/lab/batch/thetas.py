"""How often must the chain estimate? The same walk with a more and a less eager trigger, from the captures it has.

Both thresholds of the trigger are scaled by one factor, from 0, which estimates in every frame, to 64. Nothing is
rendered. Not here: pictures, which would have to be.
"""

from __future__ import annotations

import statistics
from dataclasses import replace
from typing import Any

import numpy as np

from xihe_blender.lab.batch.rows import estimates_per_minute
from xihe_blender.previs.phone_session import PhoneSession
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import WalkedPath
from xihenet.metrics import shc_rmse
from xihenet.recording import load_frame

FACTORS = (0.0, 0.25, 1.0, 4.0, 16.0, 64.0)
WITHOUT_ANCHORS = ("ambient", "truth")
"""Estimators that look at nothing the trigger watches."""


def sweep_theta(run: PreparedRun, walked: WalkedPath) -> list[dict[str, Any]]:
    """[{factor, theta, coverage_theta, per_minute, shc_rmse}] of `run`, with the mean error over positions and frames.

    Empty for estimators that do not look at the anchors, and for a path that sees no position.
    """
    active = [entry for entry in walked.frames if entry["active"]]
    if run.settings.estimator in WITHOUT_ANCHORS or not active:
        return []
    sessions = [_session(run, walked, factor) for factor in FACTORS]
    errors: list[list[float]] = [[] for _ in FACTORS]
    n_fired = [0] * len(FACTORS)
    for entry in active:
        seen, _ = walked.phone.see(load_frame(run.outputs.capture(entry["frame"])), run.outputs)
        truth = {probe["name"]: np.array(probe["sh_truth"]) for probe in entry["probes"]}
        for place, session in enumerate(sessions):
            step = session.step(seen, truth, list(truth))
            n_fired[place] += sum(report.decision.fire for report in step.reports.values())
            errors[place] += [shc_rmse(session.light(name, seen.time_s), light) for name, light in truth.items()]
    trigger = run.settings.trigger
    return [
        {
            "factor": factor,
            "theta": factor * trigger.theta,
            "coverage_theta": min(1.0, factor * trigger.coverage_theta),
            "per_minute": estimates_per_minute(walked, fired),
            "shc_rmse": statistics.fmean(of_one),
        }
        for factor, fired, of_one in zip(FACTORS, n_fired, errors, strict=True)
    ]


def _session(run: PreparedRun, walked: WalkedPath, factor: float) -> PhoneSession:
    trigger = run.settings.trigger
    scaled = replace(trigger, theta=factor * trigger.theta, coverage_theta=min(1.0, factor * trigger.coverage_theta))
    settings = replace(run.settings, trigger=scaled)
    return PhoneSession(run.plan, settings, run.exposure, run.estimator, walked.phone.link_in_use)
