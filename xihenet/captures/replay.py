"""A recorded session through the chain, frame by frame: which light an app would have had, and when."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from xihenet.backend import InferenceBackend, LocalBackend
from xihenet.camera import behind_m, in_view
from xihenet.captures.capture import Capture
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import Estimator
from xihenet.light import BetweenEstimates
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame, StepReport, UnitSphereCloud
from xihenet.trigger import TriggerSettings

REPLAY_TRIGGER = TriggerSettings(theta=0.005, ignored_share=0.25)
"""Of a run, with five times its theta, for the noise of a sensor; no recording of a real one was at hand to measure."""


@dataclass(frozen=True, eq=False)
class ReplayedStep:
    """What one frame brought: reports by position, and what is known there after it.

    `lights` are those in use, none before the first valid one, and `gains` (3,) what their estimates were multiplied
    by to carry them here, see `xihenet.light.carried_light`; `known` gives what the session knows of a position when it
    is asked, which may be after later steps. `hidden` are positions in view that lie behind what the frame shows there.
    """

    frame: int
    time_s: float
    reports: Mapping[str, StepReport]
    lights: Mapping[str, ObjectLight]
    gains: Mapping[str, ArrayF64]
    known: Callable[[str], UnitSphereCloud]
    hidden: Collection[str] = ()


def replay(
    frames: Iterable[RgbdFrame],
    positions_m: Mapping[str, ArrayF64],
    estimator: Estimator | InferenceBackend,
    *,
    trigger: TriggerSettings = REPLAY_TRIGGER,
    has_key_light: bool = False,
    has_reflections: bool = False,
    reference_exposure: float | None = None,
    never_in_view: Collection[str] = (),
    between_estimates: BetweenEstimates = "carried",
) -> Iterator[ReplayedStep]:
    """The steps of a session over `frames`, read as they come, with positions (3,) in their world, metres, by name.

    A position is asked about where the camera sees it, as an app does, and learns from the other frames; those of
    `never_in_view` are asked about in every frame, or they would have no light. Light carries `reference_exposure`,
    that of the first frame if it is None.
    """
    settings = ControllerSettings(
        trigger,
        reference_exposure=reference_exposure,
        learns_out_of_view=True,
        has_key_light=has_key_light,
        has_reflections=has_reflections,
        between_estimates=between_estimates,
    )
    backend = LocalBackend(estimator) if isinstance(estimator, Estimator) else estimator
    session = XiheController(backend, settings)
    for name, position_m in positions_m.items():
        session.add_position(name, np.asarray(position_m, np.float64))
    for seen in frames:
        looked_at = session.active(seen.intrinsics, seen.world_from_camera)
        reports = session.step(
            seen, active=[name for name in positions_m if name in looked_at or name in never_in_view]
        )
        lights = {name: light for name in positions_m if (light := session.light(name)) is not None}
        gains = {name: session.gain(name) for name in lights}
        in_use = {name: ObjectLight(light.sh_radiance, light.key) for name, light in lights.items()}
        hidden = [name for name in looked_at if behind_m(positions_m[name], seen)]
        yield ReplayedStep(seen.frame, seen.time_s, reports, in_use, gains, session.known, hidden)


def never_in_view(capture: Capture, positions_m: Mapping[str, ArrayF64]) -> list[str]:
    """The positions, as of `replay`, that no frame sees; no picture is read."""
    names, points_m = list(positions_m), np.array(list(positions_m.values())).reshape(-1, 3)
    was_seen = np.zeros(len(names), bool)
    for frame in capture.frames:
        was_seen |= in_view(points_m, frame.camera.intrinsics, frame.camera.world_from_camera)
    return [name for name, is_seen in zip(names, was_seen, strict=True) if not is_seen]
