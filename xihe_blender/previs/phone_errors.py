"""The errors of a phone: how much of a run's error does each of its effects make?

Nothing is rendered: the phone sees the captures of the run again, and the whole chain runs on what it saw. So the
difference is what a user would gain by a phone without that flaw; since triggers may fire in other frames then, a small
one is chance. Rejected: errors of effects alone on a perfect phone, which say nothing of how they add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from xihe_blender.io.run_results import PhoneErrors
from xihe_blender.jobs import Job
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import ChainResult
from xihe_blender.report.values import mean
from xihenet.io.recording import load_frame
from xihenet.metrics import shc_rmse
from xihenet.phone import NETWORK, Link
from xihenet.phone.session import PhoneSession
from xihenet.trigger import TriggerSettings

NOT_REPEATED = "frame_rate"
"""Frames that the phone did not deliver were never captured."""


def measure_phone(run: PreparedRun, chain: ChainResult) -> Job[PhoneErrors | None]:
    """A job: the errors of the chain with the phone's effects, without each of them, and with a perfect phone.

    None for a phone without any effect, and for a recording; an error is None without an active frame.
    """
    phone = chain.phone
    if not phone.on or not run.has_truth:
        return None
    all_on = mean(probe.shc_rmse for entry in chain.frames for probe in entry.probes)
    without: dict[str, float | None] = {}
    for effect in [name for name in phone.effects if name in phone.on]:
        yield run.progress("methods", 1, f"measuring the light without {effect}")
        without[effect] = None if effect == NOT_REPEATED else _mean_error(run, chain, phone.on - {effect})
    yield run.progress("methods", 1, "measuring the light with a perfect phone")
    return PhoneErrors(all_on=all_on, perfect=_mean_error(run, chain, frozenset()), without=without)


def _mean_error(run: PreparedRun, chain: ChainResult, effects: frozenset[str]) -> float | None:
    """Mean SHC RMSE over probes and frames of a session with `effects`; None without a frame."""
    phone = replace(chain.phone, of_camera=effects - {NETWORK})
    link = chain.phone.link_in_use if NETWORK in effects else None
    ((_, errors),) = run_sessions(run, replace(chain, phone=phone), [run.settings.trigger_in_use], link)
    return mean(errors)


def run_sessions(
    run: PreparedRun, chain: ChainResult, triggers: Sequence[TriggerSettings], link: Link | None
) -> list[tuple[int, list[float]]]:
    """The session of `chain` with its phone again, over `link` and with each of `triggers`; of light in nine SH alone.

    By trigger the number of estimates, and SHC RMSE at each position in view of each frame.
    """
    how, seed = replace(run.settings, light="sh").chain(run.exposure), run.settings.seed
    each = [replace(how, trigger=trigger) for trigger in triggers]
    sessions = [PhoneSession(run.plan.probes, one, run.estimator, link, seed=seed) for one in each]
    errors: list[list[float]] = [[] for _ in triggers]
    n_fired = [0] * len(triggers)
    for entry in [entry for entry in chain.frames if entry.captured]:
        seen, _ = chain.phone.see(load_frame(run.outputs.capture(entry.frame)), run.outputs)
        truth = {probe.name: np.array(probe.sh_truth) for probe in entry.probes}
        for index, session in enumerate(sessions):
            reports, _ = session.step(seen, truth, list(truth))
            n_fired[index] += sum(report.decision.fire for report in reports.values())
            errors[index] += [shc_rmse(session.light(name, seen.time_s), light) for name, light in truth.items()]
    return list(zip(n_fired, errors, strict=True))
