"""The chain of an error budget: what it renders beside the path, and the session run again with one part perfect.

Rendered are looks around and satin balls under the true light, kept file by file in the folder of the budget; where the
light does not change, one look from an object and one ball serve for all moments.

A session here has one estimation position. It takes in the frames that the phone saw and, where somebody looks around,
further frames before them, from which it learns as from frames without an object in view. Nothing is rendered for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xihe_blender.capture.all_around import N_VIEWS, open_all_around
from xihe_blender.capture.phone_surfaces import save_surfaces, surfaces_in
from xihe_blender.capture.satin_probe import satin_ball_at
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.json_records import as_json, read_record
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import is_captured
from xihe_blender.previs.simulated_phone import SimulatedPhone
from xihenet.buffers import FrameAtPosition, merge_in_sight
from xihenet.camera import unproject_frame
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.estimators import EstimateContext, Estimator
from xihenet.io.recording import load_frame, save_frame
from xihenet.phone import Link
from xihenet.phone.session import PhoneSession
from xihenet.records import ArrayF32, ArrayF64, PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_again, sample_unit_sphere
from xihenet.satin_ball import SatinBall
from xihenet.sphere import AnchorLattice
from xihenet.trigger import RULES, TriggerSettings

EVERY_FRAME = RULES["every-frame"]
MOST_STOPS = 10
"""By so many stops an exposure is lowered at most so that nothing is clipped."""

FROM_PATH = "path"
"""The place from which the phone itself looks around."""

View = tuple[RgbdFrame, ArrayF32]
"""A picture, and its scene radiance (H, W, 3)."""


@dataclass(frozen=True, eq=False)
class Sight:
    """A frame that a session takes in, and its points at the session's exposure."""

    seen: RgbdFrame
    points: PointCloud


@dataclass(frozen=True, eq=False)
class LightInUse:
    """(9, 3) at the session's exposure, and the frame it was estimated from; None for the ambient light."""

    sh: ArrayF64
    light_frame: int | None


@dataclass(frozen=True, eq=False)
class SessionParts:
    """What a session is made of; `replace` makes one of them perfect."""

    sights: Sequence[Sight]
    trigger: TriggerSettings
    link: Link | None
    estimator: Estimator
    looks: Mapping[int, Sequence[Sight]]
    """Further sights, by the number of the frame before which they are taken in."""


def sights_of_path(run: PreparedRun, phone: SimulatedPhone) -> list[Sight]:
    """What `phone` sees of the captured path of `run`."""
    captures = (load_frame(run.outputs.capture(frame)) for frame in run.plan.frames if frame in run.needs.captured)
    return [sight(phone.see(captured, run.outputs)[0], run.exposure) for captured in captures]


def sight(seen: RgbdFrame, exposure: float) -> Sight:
    """`seen` with its points at the session's `exposure`."""
    return Sight(seen, unproject_frame(seen, reference_exposure=exposure))


def lights_in_use(run: PreparedRun, probe: Probe, parts: SessionParts, moments: Sequence[int]) -> dict[int, LightInUse]:
    """The light in use at `probe` after each of the frames `moments`."""
    chain = replace(run.settings.chain(run.exposure), trigger=parts.trigger)
    session, lights = PhoneSession([probe], chain, parts.estimator, parts.link, seed=run.settings.seed), {}
    for one in parts.sights:
        frame, time_s = one.seen.frame, one.seen.time_s
        session.controller.move_position(probe.name, probe.at(frame))
        for look in parts.looks.get(frame, ()):
            session.controller.step(look.seen, active=[], points=look.points)
        if isinstance(parts.estimator, Unclipped):
            parts.estimator.see(frame, probe.at(frame))
        session.step(one.seen, {}, [probe.name] if probe in run.probes_in_view(frame) else [], one.points)
        if frame in moments:
            lights[frame] = LightInUse(session.light(probe.name, time_s), session.light_frame(probe.name, time_s))
    return lights


# ------------------------------------------------------------------------------------------------------------ clipping


def exposure_without_clipping(pictures: Sequence[ArrayF32], exposure: float) -> float:
    """At which no picture (H, W, 3) of scene radiance is clipped, from `exposure` down to MOST_STOPS below it."""
    brightest = max((float(np.nan_to_num(picture, posinf=0.0).max(initial=0.0)) for picture in pictures), default=0.0)
    return exposure if brightest * exposure <= 1 else max(1 / brightest, exposure / 2**MOST_STOPS)


def with_radiance(points: PointCloud, radiance: ArrayF32, exposure: float) -> PointCloud:
    """`points` in the colours of their pixels' radiance (H, W, 3) at `exposure`, not rounded to 8 bits."""
    finite = np.nan_to_num(radiance.reshape(-1, 3).astype(np.float64), nan=0.0, posinf=1e30, neginf=0.0)
    colours = linear_to_srgb(np.clip(finite * exposure, 0, 1)).astype(np.float32)
    return replace(points, srgb=colours)


class Unclipped(Estimator):
    """`inner` on clouds in which nothing is clipped at white, for a session of one position.

    Trigger, merging and delay go on to see clipped pictures. Beside them the true radiance of each anchor is kept; what
    lies above white is put into the cloud, which `inner` is given at an exposure that holds it. A clipped colour that
    follows a change of the light takes the light above white along.
    """

    name = "unclipped"

    def __init__(self, inner: Estimator, run: PreparedRun, sights: Sequence[Sight]) -> None:
        super().__init__(inner.n_anchors, inner.target)
        self.inner, self.lattice = inner, AnchorLattice(inner.n_anchors)
        pictures = {one.seen.frame: read_radiance(run.outputs.radiance("captured", one.seen.frame)) for one in sights}
        exposure = exposure_without_clipping(list(pictures.values()), run.exposure)
        self.points = {one.seen.frame: with_radiance(one.points, pictures[one.seen.frame], exposure) for one in sights}
        self.frames = {one.seen.frame: one.seen for one in sights}
        self.ratio = exposure / run.exposure
        self.bright, self.position_m = UnitSphereCloud.empty(self.n_anchors), np.full(3, np.nan)

    def see(self, frame: int, position_m: ArrayF64) -> None:
        """Take in the true radiance of a frame of the session."""
        if np.isfinite(self.position_m).all() and not np.array_equal(position_m, self.position_m):
            self.bright = sample_again(self.bright, position_m - self.position_m, self.lattice)
        self.position_m = position_m
        sampled = sample_unit_sphere(self.points[frame], position_m, self.lattice)
        self.bright = merge_in_sight(
            self.bright, sampled, FrameAtPosition(self.frames[frame], position_m, self.lattice)
        )

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        return self.inner.unknown_because(cloud, context)

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        seen, true = (srgb_to_linear(one.srgb.astype(np.float64)) for one in (cloud, self.bright))
        brighter = np.maximum(true / self.ratio, 1.0)
        colours = linear_to_srgb(np.clip(seen * brighter * self.ratio, 0, 1)).astype(np.float32)
        exposure = None if context.reference_exposure is None else context.reference_exposure * self.ratio
        lower = replace(context, reference_exposure=exposure)
        light: ArrayF64 = self.inner.estimate(replace(cloud, srgb=colours), lower) / self.ratio
        return light


# ----------------------------------------------------------------------------------------------- looks and satin balls


def view_outputs(run: PreparedRun, place: str, view: int) -> RunOutputs:
    """Where the `view`-th of the pictures around a place is kept, by frame as captures are."""
    return RunOutputs(run.outputs.folder / "work" / "around" / place / str(view))


def place_of(run: PreparedRun, probe: Probe) -> str:
    """The place of an estimation position, as part of a path."""
    return f"position_{run.plan.probes.index(probe)}"


def look_around(run: PreparedRun, places: Mapping[str, Mapping[int, ArrayF64]]) -> Job[None]:
    """A job: render what is not kept yet of all pictures around `places`, world positions (3,) by place and frame."""
    wanted = sorted((frame, place) for place, at in places.items() for frame in at)
    keeping = replace(run.needs, radiance=True)
    missing = [
        (frame, place)
        for frame, place in wanted
        if not all(is_captured(view_outputs(run, place, view), keeping, frame) for view in range(N_VIEWS))
    ]
    if not missing:
        return
    with open_all_around(run.scene, run.capture, exposure=run.exposure, with_surfaces=run.needs.surfaces) as around:
        for done, (frame, place) in enumerate(missing):
            yield Progress(done, len(missing), f"looking around in frame {frame}")
            around.scanner.scene.frame_set(frame)
            for view in range(N_VIEWS):
                outputs = view_outputs(run, place, view)
                seen, radiance = around.look(view, places[place][frame])
                if run.needs.surfaces:
                    roughness = run.survey.frames[frame].roughness
                    save_surfaces(outputs.surfaces(frame), surfaces_in(around.scanner.rendered.passes, roughness))
                write_radiance(outputs.radiance("captured", frame), radiance)
                outputs.capture(frame).parent.mkdir(parents=True, exist_ok=True)
                save_frame(outputs.capture(frame), seen)


def kept_views(run: PreparedRun, place: str, frame: int) -> list[View]:
    """The six pictures around a place, which `look_around` rendered."""
    kept = (view_outputs(run, place, view) for view in range(N_VIEWS))
    return [(load_frame(one.capture(frame)), read_radiance(one.radiance("captured", frame))) for one in kept]


# --------------------------------------------------------------------------------------------------------- satin balls


def measure_balls(run: PreparedRun, wanted: Iterable[tuple[int, Probe]]) -> Job[None]:
    """A job: render the satin ball at each position in each frame that is not kept yet."""
    missing = [(f, probe) for f, probe in wanted if kept_record(SatinBall, _ball_file(run, f, probe)) is None]
    if not missing:
        return
    with run.open_probes(run.plan.probes) as reference_probe:
        for done, (frame, probe) in enumerate(missing):
            yield Progress(done, len(missing), f"measuring the light at {probe.name} in frame {frame}")
            index, samples = run.plan.probes.index(probe), run.reference.max_samples
            reference_probe.move(index, probe.at(frame))
            ball = satin_ball_at(reference_probe, index, frame, exposure=run.exposure, samples=samples)
            write_json(_ball_file(run, frame, probe), as_json(ball))


def kept_ball(run: PreparedRun, frame: int, probe: Probe) -> SatinBall:
    """What `measure_balls` rendered."""
    return read_record(SatinBall, _ball_file(run, frame, probe))


def _ball_file(run: PreparedRun, frame: int, probe: Probe) -> Path:
    return run.outputs.folder / "work" / f"satin_ball_{run.plan.probes.index(probe)}_{frame:04d}.json"
