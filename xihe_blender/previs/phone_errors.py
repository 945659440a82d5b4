"""The errors of a phone: how much of a run's error does each of its effects make?

Nothing is rendered: the phone sees the captures of the run again, and the whole chain runs on what it saw. So the
difference is what a user would gain by a phone without that flaw; since triggers may fire in other frames then, a small
one is chance. Rejected: errors of effects alone on a perfect phone, which say nothing of how they add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from xihe_blender.io.run_results import FrameResult, PhoneErrors
from xihe_blender.jobs import Job
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import ChainResult
from xihe_blender.previs.simulated_phone import SimulatedPhone
from xihe_blender.report.values import mean
from xihenet.io.recording import load_frame
from xihenet.metrics import shc_rmse
from xihenet.phone import NETWORK, Link
from xihenet.phone.session import PhoneSession

NOT_REPEATED = "frame_rate"
"""Frames that the phone did not deliver were never captured."""


def measure_phone(run: PreparedRun, chain: ChainResult) -> Job[PhoneErrors | None]:
    """A job: the errors of the chain with the phone's effects, without each of them, and with a perfect phone.

    None for a phone without any effect, and for a recording; an error is None without an active frame.
    """
    phone = chain.phone
    if not phone.on or not run.has_truth:
        return None
    captured = [entry for entry in chain.frames if entry.captured]
    all_on = mean(probe.shc_rmse for entry in captured for probe in entry.probes)
    without: dict[str, float | None] = {}
    for effect in [name for name in phone.effects if name in phone.on]:
        yield run.progress("methods", 1, f"measuring the light without {effect}")
        link = None if effect == NETWORK else phone.link_in_use
        effects = phone.on - {effect}
        without[effect] = None if effect == NOT_REPEATED else _mean_error(run, phone, captured, effects, link)
    yield run.progress("methods", 1, "measuring the light with a perfect phone")
    perfect = _mean_error(run, phone, captured, frozenset(), None)
    return PhoneErrors(all_on=all_on, perfect=perfect, without=without)


def _mean_error(
    run: PreparedRun, phone: SimulatedPhone, captured: Sequence[FrameResult], effects: frozenset[str], link: Link | None
) -> float | None:
    """Mean SHC RMSE over probes and frames of a session with `effects` over `link`; None without a frame."""
    phone = replace(phone, of_camera=effects - {NETWORK})
    chain = replace(run.settings, light="sh").chain(run.exposure)
    session = PhoneSession(run.plan.probes, chain, run.estimator, link, seed=run.settings.seed)
    errors = []
    for entry in captured:
        seen, _ = phone.see(load_frame(run.outputs.capture(entry.frame)), run.outputs)
        truth = {probe.name: np.array(probe.sh_truth) for probe in entry.probes}
        session.step(seen, truth, list(truth))
        errors += [shc_rmse(session.light(name, seen.time_s), light) for name, light in truth.items()]
    return mean(errors)
