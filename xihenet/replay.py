"""A recorded session through the chain, frame by frame: which light an app would have had, and when."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import Estimator
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame, StepReport
from xihenet.trigger import TriggerSettings

REPLAY_TRIGGER = TriggerSettings(theta=0.005, ignored_share=0.25)
"""Of a run, with five times its theta, for the noise of a sensor; no recording of a real one was at hand to measure."""


@dataclass(frozen=True, eq=False)
class ReplayedStep:
    """What one frame brought: reports by position, and the light in force there, none before the first valid one."""

    frame: int
    time_s: float
    reports: Mapping[str, StepReport]
    lights: Mapping[str, ObjectLight] = field(default_factory=dict)


def replay(
    frames: Iterable[RgbdFrame],
    positions_m: Mapping[str, ArrayF64],
    estimator: Estimator,
    *,
    trigger: TriggerSettings = REPLAY_TRIGGER,
    has_key_light: bool = False,
) -> Iterator[ReplayedStep]:
    """The steps of a session over `frames`, read as they come, with positions (3,) in their world, metres, by name.

    Every position is asked about in every frame. Light carries the exposure of the first frame.
    """
    settings = ControllerSettings(trigger, learns_out_of_view=True, has_key_light=has_key_light)
    session = XiheController(LocalBackend(estimator), settings)
    for name, position_m in positions_m.items():
        session.add_position(name, np.asarray(position_m, np.float64))
    lights: dict[str, ObjectLight] = {}
    for seen in frames:
        reports = session.step(seen, active=list(positions_m))
        for name, report in reports.items():
            if report.estimate is not None and report.estimate.is_valid:
                lights[name] = ObjectLight(report.estimate.sh_radiance, report.estimate.key)
        yield ReplayedStep(seen.frame, seen.time_s, reports, dict(lights))
