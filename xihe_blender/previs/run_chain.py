"""The chain, run along the camera path: what does the phone believe about the light at each frame?

    capture -> unproject -> sample -> merge -> trigger -> encode -> estimate

Each frame that the phone takes in goes through the controller; where an estimation position is in view, light probes
are rendered and estimates made. The frames of a phone that is not perfect are derived from the captures of the whole
path, and estimates come back over its network; see `simulated_phone`, `xihenet.phone.session`.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from xihe_blender.capture.phone_surfaces import load_surfaces
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.outputs import finite_or_none, write_picture
from xihe_blender.io.run_lights import as_coefficients, as_rgb
from xihe_blender.io.run_results import FrameResult, OtherLight, ProbeResult
from xihe_blender.jobs import Job
from xihe_blender.previs.path_renders import FrameRenders, kept_renders, render_path, rendering
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.simulated_phone import CaptureFacts, SimulatedPhone, facts_of_capture, simulate_phone
from xihe_blender.previs.true_light import TrueLight
from xihenet.camera import invalid_pixels
from xihenet.invalid import CLAMPED
from xihenet.io.recording import load_frame, save_frame
from xihenet.light.key_light import with_positions
from xihenet.metrics import share_above_white, shc_rmse
from xihenet.phone import Request, first_frame_after
from xihenet.phone.session import PhoneSession
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame, StepReport

Lights = dict[str, dict[str, ObjectLight]]
"""By method and virtual object."""


@dataclass(frozen=True, eq=False)
class ChainResult:
    """What the chain brought: frames not yet compared, and the light in use from the first frame captured on."""

    phone: SimulatedPhone
    frames: list[FrameResult] = field(default_factory=list)
    lights: dict[int, Lights] = field(default_factory=dict)


def run_chain(run: PreparedRun, *, keeps_session: bool = False) -> Job[ChainResult]:
    """A job: render the path of `run`, as far as it is not rendered yet, and run the chain on it.

    With `keeps_session` what a phone with flaws saw is kept beside the captures, see `kept_session`.
    """
    work_s = yield from render_path(run)
    start = time.perf_counter()
    phone = phone_of_captures(run)
    looked_s = (time.perf_counter() - start) / max(1, len(run.needs.captured))
    captured_s = {frame: work_s.get(frame, 0.0) + looked_s for frame in run.needs.captured}
    chain = _ChainRun(run, phone, captured_s, keeps_session=keeps_session)
    for frame in run.plan.frames:
        chain.step(frame)
    return chain.result


def phone_of_captures(run: PreparedRun) -> SimulatedPhone:
    """The phone of `run`, of which all is captured."""
    facts = _facts_of_captures(run) if run.phone.sees else {}
    return simulate_phone(run.phone, facts, run.exposure)


def _facts_of_captures(run: PreparedRun) -> dict[int, CaptureFacts]:
    """What the phone will be derived from, by captured frame."""
    facts, metering = {}, run.settings.metering_in_force
    for frame in [frame for frame in run.plan.frames if frame in run.needs.captured]:
        surfaces = load_surfaces(run.outputs.surfaces(frame)) if run.needs.surfaces else None
        radiance = read_radiance(run.outputs.radiance("captured", frame)) if run.needs.radiance else None
        positions_m = np.array([probe.at(frame) for probe in run.plan.probes])
        captured = load_frame(run.outputs.capture(frame))
        facts[frame] = facts_of_capture(captured, positions_m, metering, surfaces, radiance)
    return facts


class _ChainRun:
    """The state of the chain under way; `captured_s` is the earlier work on each frame, without rendering."""

    def __init__(
        self, run: PreparedRun, phone: SimulatedPhone, captured_s: dict[int, float], *, keeps_session: bool
    ) -> None:
        self.run, self.phone, self.captured_s, self.keeps_session = run, phone, captured_s, keeps_session
        chain, seed = run.settings.chain(run.exposure), run.settings.seed
        self.session = PhoneSession(
            run.plan.probes, chain, run.estimator, phone.link_in_use, seed=seed, others=run.estimators[1:]
        )
        self.result = ChainResult(phone)
        self.truth = TrueLight(run, self.session.controller)

    def step(self, frame: int) -> None:
        start = time.perf_counter()
        rendered, time_s = kept_renders(self.run, frame), self.run.survey.frames[frame].time_s
        if rendered is not None:
            entry = self._captured_frame(rendered, start)
        else:
            is_delivered = frame in self.run.needs.delivered
            entry = FrameResult(frame=frame, time_s=time_s, active=False, is_delivered=is_delivered)
        if entry.active or self.result.lights:
            self.result.lights[frame] = self._lights_in_use(frame, time_s)
        self.result.frames.append(entry)

    def _captured_frame(self, rendered: FrameRenders, start: float) -> FrameResult:
        """A frame, as the phone saw it, that goes through the chain; `stage_ms` adds up its positions."""
        run, target = self.run, self.run.settings.target
        self.truth.see(rendered.captured.frame, rendered.references)
        truth = {name: light.of(target) for name, light in rendered.references.items()}
        seen, n_lost = self.phone.see(rendered.captured, run.outputs)
        if seen is not rendered.captured and self.keeps_session:
            save_frame(run.outputs.seen(seen.frame), seen)
        if not np.array_equal(seen.srgb_u8, rendered.captured.srgb_u8):
            write_picture(run.outputs.picture("captured", seen.frame), seen.srgb_u8)
        in_view = run.probes_in_view(seen.frame)
        reports, requests = self.session.step(seen, truth, [probe.name for probe in in_view])
        probes = tuple(
            self._probe_result(probe, reports[probe.name], requests.get(probe.name), seen) for probe in in_view
        )
        work_s = time.perf_counter() - start + self.captured_s[seen.frame]
        stage_ms: dict[str, float] = defaultdict(float)
        for of_position in (self.session.controller.out_of_view_ms, *(one.stage_ms for one in reports.values())):
            for stage, ms in of_position.items():
                stage_ms[stage] += ms
        others_ms: dict[str, float] = defaultdict(float)
        for report in reports.values():
            for name, ms in report.estimate.other_ms.items() if report.estimate else ():
                others_ms[name] += ms
        left_out = invalid_pixels(seen)
        return FrameResult(
            frame=seen.frame,
            time_s=seen.time_s,
            active=bool(probes),
            captured=True,
            exposure=seen.exposure,
            render_s=rendered.render_s,
            work_s=work_s,
            stage_ms=stage_ms,
            others_ms=others_ms,
            ambient_radiance=None if seen.ambient is None else as_rgb(seen.ambient),
            n_invalid_pixels=sum(left_out.values()),
            n_lost_pixels=n_lost,
            invalid=left_out | {reason: n for reason, n in seen.invalid.items() if reason in CLAMPED},
            probes=probes,
            rendering=rendering(seen.frame, rendered.references, run) if run.has_truth else None,
        )

    def _lights_in_use(self, frame: int, time_s: float) -> Lights:
        """Light of every method on every virtual object: the mean over the object's estimation positions, and each.

        Truth here is the whole light, not clipped, whatever the target: it shows what order 2 can do in the picture.
        A position that was never in view has no light of its own yet and gets the ambient one.
        """
        ambient_sh, chosen, others = self.session.ambient_sh, self.run.settings.estimator, self.run.settings.others
        lights: Lights = {method: {} for method in self.run.methods}
        for item in self.run.plan.objects:
            places = {probe.name: probe.at(frame) for probe in self.run.plan.probes_of(item.name)}
            for method in (chosen, *others):
                other = None if method == chosen else method
                light = self.session.object_light(list(places), time_s, other)
                if len(places) > 1:
                    each = {name: self.session.object_light([name], time_s, other) for name in places}
                    light = with_positions(light, places, each)
                lights[method][item.name] = light
            lights["ambient"][item.name] = ObjectLight(ambient_sh)
            if self.run.has_truth:
                lights["truth"][item.name] = self.truth.object_light(places, ambient_sh)
        return lights

    def _probe_result(self, probe: Probe, report: StepReport, request: Request | None, seen: RgbdFrame) -> ProbeResult:
        """What one step did at one position, and the light in use there after it."""
        reference, time_s = self.truth.measured(probe.name), seen.time_s
        light = self.session.light(probe.name, time_s)
        others = {other: self.session.light(probe.name, time_s, other) for other in self.run.settings.others}
        truth = None if reference is None else reference.of(self.run.settings.target)
        arrival_frame, latency_ms = _arrival(request, self.run.phone.times_s)
        return ProbeResult(
            name=probe.name,
            object=probe.object_name,
            position_m=as_rgb(probe.at(seen.frame)),
            coverage=report.coverage,
            fired=report.decision.fire,
            reason=report.decision.reason,
            change=finite_or_none(report.decision.change),
            threshold=finite_or_none(report.decision.threshold),
            n_changed_anchors=report.decision.n_changed_anchors,
            n_invalid_points=report.n_invalid_points,
            invalid=dict(report.invalid),
            is_valid=not report.unknown_because,
            unknown_because=report.unknown_because or None,
            light_frame=self.session.light_frame(probe.name, time_s),
            n_followed_anchors=report.n_followed_anchors,
            light_gain=as_rgb(self.session.gain(probe.name, time_s)),
            payload_bytes=report.payload_bytes,
            arrival_frame=arrival_frame,
            latency_ms=latency_ms,
            sh=as_coefficients(light),
            sh_truth=None if truth is None else as_coefficients(truth),
            shc_rmse=_error(light, truth),
            expected_error=finite_or_none(self.session.expected_error(probe.name, time_s)),
            ambient_shc_rmse=_error(self.session.ambient_sh, truth),
            others={
                name: OtherLight(sh=as_coefficients(other), shc_rmse=_error(other, truth))
                for name, other in others.items()
            },
            share_above_white=None if reference is None else share_above_white(reference.ldr, reference.hdr),
        )


def _arrival(request: Request | None, times_s: Mapping[int, float]) -> tuple[int | None, float | None]:
    """Frame and latency, in ms, of one step's estimate; None without one, for a lost one, or after the last frame.

    `times_s` are those of the path's frames, by number.
    """
    if request is None:
        return None, None
    frames = list(times_s)
    index = int(first_frame_after([request.arrival_s], list(times_s.values()))[0])
    latency_s = request.latency_s
    return frames[index] if index < len(frames) else None, None if latency_s is None else 1e3 * latency_s


def _error(light: ArrayF64, truth: ArrayF64 | None) -> float | None:
    """SHC RMSE of coefficients (9, 3); None where there is no truth."""
    return None if truth is None else shc_rmse(light, truth)
