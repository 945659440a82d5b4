"""The session of a run, kept: what its phone saw, from which light at any other place follows without a render.

The captures of a run hide the virtual objects and do not depend on them. So the chain of the run is run again on its
kept frames, with the same settings, for other positions: light, coverage and expected error there are those that a
whole run would have found, in its frames and at its exposure. What needs a render is not here: reference light and
ground truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults, read_results
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.phone_session import PhoneSession
from xihe_blender.previs.plan import PrevisPlan, Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihenet.camera import in_view, unproject_frame
from xihenet.estimators import Estimator
from xihenet.light_change import LightFollowing
from xihenet.recording import SessionFacts, load_frame
from xihenet.records import ArrayF64, Intrinsics, ObjectLight, PointCloud, RgbdFrame
from xihenet.trigger import TriggerSettings


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """One frame as the phone saw it, its points, and the camera as it truly was: intrinsics and (4, 4) pose."""

    seen: RgbdFrame
    points: PointCloud
    camera: tuple[Intrinsics, ArrayF64]


@dataclass(eq=False)
class FoundLight:
    """What a session comes to know of one position, by frame.

    `lights` are those in force, carrying the session's exposure: until the first estimate the ambient one.
    `coverage` is the share of the anchors that are known, `expected_error` SHC RMSE, None for an estimator that expects
    none or before there is an estimate. `was_in_view` says whether the position ever was.
    """

    lights: dict[int, ObjectLight] = field(default_factory=dict)
    coverage: dict[int, float] = field(default_factory=dict)
    expected_error: dict[int, float | None] = field(default_factory=dict)
    was_in_view: bool = False

    @property
    def sh(self) -> dict[int, ArrayF64]:
        """(9, 3) coefficients of all of the light."""
        return {frame: light.sh for frame, light in self.lights.items()}


@dataclass(frozen=True, eq=False)
class KeptSession:
    """All that the chain of a run needs to be run again; made by `open_kept_session`."""

    settings: PrevisSettings
    size: tuple[int, int]
    exposure: float
    frames: tuple[SeenFrame, ...]

    @cached_property
    def _estimator(self) -> Estimator:
        return load_estimators(self.settings)[0]

    def find_light(self, places_m: Mapping[str, ArrayF64]) -> Job[dict[str, FoundLight]]:
        """A job, a step per frame: the light at positions ((3,) world, metres) that stay where they are, by name.

        Nothing is rendered. The same as a run's, to the last bit.
        """
        probes = tuple(Probe(name, name, np.asarray(place, np.float64)) for name, place in places_m.items())
        numbers = tuple(one.seen.frame for one in self.frames)
        plan = PrevisPlan(numbers, self.size, (), probes)
        session = PhoneSession(plan, self.settings, self.exposure, self._estimator, self.settings.link)
        found, positions_m = {name: FoundLight() for name in places_m}, np.array(list(places_m.values())).reshape(-1, 3)
        for done, one in enumerate(self.frames):
            yield Progress(done, len(self.frames), f"estimating the light from frame {one.seen.frame}")
            are_seen = in_view(positions_m, *one.camera)
            active = [name for name, is_seen in zip(places_m, are_seen, strict=True) if is_seen]
            session.step(one.seen, {}, active, one.points)
            for name, light in found.items():
                frame, time_s = one.seen.frame, one.seen.time_s
                light.lights[frame] = session.object_light([name], time_s)
                light.coverage[frame] = session.controller.coverage(name)
                light.expected_error[frame] = session.expected_error(name, time_s)
                light.was_in_view |= name in active
        return found


def open_kept_session(folder: Path) -> Job[KeptSession]:
    """A job, a step per frame: read the frames that the run in `folder` keeps.

    UserError where they are gone, or where the run's estimator needs more than frames: `truth` is rendered.
    """
    results = read_results(folder)
    captured = [entry.frame for entry in results.captured_frames]
    if not captured:
        raise UserError(f"the run in {folder} captured nothing: run again")
    of_run = results.settings
    return (
        yield from kept_session(
            RunOutputs(folder), _settings_of(results), of_run.size, of_run.reference_exposure, captured
        )
    )


def kept_session(
    outputs: RunOutputs, settings: PrevisSettings, size: tuple[int, int], exposure: float, captured: Sequence[int]
) -> Job[KeptSession]:
    """A job, a step per frame: the session of a run whose frames `captured` are in `outputs`; errors as above.

    Without reflections: filling their sphere from all frames takes seconds, and a move has to be answered at once.
    """
    if settings.has_reflections:
        settings = replace(settings, light="sh+key")
    if settings.estimator == "truth":
        raise UserError("the light of `truth` is rendered: run again, or choose another estimator")
    frames = []
    for done, frame in enumerate(captured):
        yield Progress(done, len(captured), f"reading frame {frame}")
        frames.append(_seen_frame(outputs, frame, exposure))
    return KeptSession(settings, size, exposure, tuple(frames))


def kept_facts(run: PreparedRun) -> SessionFacts:
    """The session.json of a run: the frames that it keeps, as its phone saw them."""
    outputs = run.outputs
    paths = [(outputs.seen(frame), outputs.capture(frame)) for frame in sorted(run.needs.captured)]
    seen_by = f"rendered, as the phone {run.settings.phone} saw it" if run.has_truth else "recorded by a phone"
    return SessionFacts(
        f"{outputs.scene}, {seen_by}",
        reference_exposure=run.exposure,
        trigger=run.settings.trigger,
        files=tuple(outputs.relative(seen if seen.exists() else capture) for seen, capture in paths),
    )


def _seen_frame(outputs: RunOutputs, frame: int, exposure: float) -> SeenFrame:
    try:
        captured = load_frame(outputs.capture(frame))
        seen = load_frame(outputs.seen(frame)) if outputs.seen(frame).exists() else captured
    except (OSError, ValueError) as error:
        raise UserError(f"the captures of the last run are gone or damaged ({error}): run again") from error
    points = unproject_frame(seen, reference_exposure=exposure)
    return SeenFrame(seen, points, (captured.intrinsics, captured.world_from_camera))


def _settings_of(results: RunResults) -> PrevisSettings:
    """Of the chain; what only rendering needs is left as it comes."""
    of_run = results.settings
    following = None if of_run.following is None else LightFollowing(**of_run.following)  # type: ignore[arg-type]
    return PrevisSettings(
        estimator=of_run.estimator,
        target=of_run.target,
        light=of_run.light,
        n_anchors=of_run.n_anchors,
        seed=of_run.seed,
        captured=of_run.captured,
        trigger=TriggerSettings(**of_run.trigger),  # type: ignore[arg-type]
        following=following,
        between_estimates=of_run.between_estimates,
        network=of_run.network,
    )
