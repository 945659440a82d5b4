"""The chain, run along the camera path: what is rendered, and what does the phone believe about the light in a frame?

    capture -> unproject -> sample -> merge -> trigger -> encode -> estimate

First all captures are rendered, then all light probes that are in view: Cycles keeps a room's geometry between the
renders of one scene, and builds it anew when another scene has been rendered in between. In a furnished room of others
a capture and a light probe took 22 s by turns, and 11 s so. What an earlier part of the run kept is not rendered again,
and what is as in an earlier frame is taken over from there. Everything is kept file by file before anything is made of
it.

Then each captured frame, in order, is seen by the phone (`simulated_phone`) and goes through the controller of its
session (`xihenet.phone.session`); estimates come back over its network. Before that comes the camera path, `survey`,
and after it apply, in `previs`, and compare, `compare_path`.
"""

from __future__ import annotations

import bisect
import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, load_surfaces, save_surfaces, surfaces_in
from xihe_blender.capture.reference_probe import MeasuredLight, ReferenceProbe
from xihe_blender.capture.scanner import CyclesScanner, first_layer, open_scanner
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.json_records import as_json, read_record
from xihe_blender.io.kept_files import kept_json, kept_record, read_kept
from xihe_blender.io.outputs import RunOutputs, copy_whole, finite_or_none, write_json, write_picture
from xihe_blender.io.run_lights import as_coefficients, as_rgb
from xihe_blender.io.run_results import CaptureRender, FrameResult, OtherLight, ProbeRender, ProbeResult, Rendering
from xihe_blender.jobs import Job, Steps, shown, timed
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.simulated_phone import CaptureNeeds, SimulatedPhone, facts_of_capture, simulate_phone
from xihe_blender.previs.true_light import TrueLight
from xihe_blender.scene.units import seconds_of
from xihenet.camera import invalid_pixels
from xihenet.invalid import CLAMPED, added
from xihenet.io.json_files import read_json
from xihenet.io.recording import load_frame, save_frame
from xihenet.light.key_light import with_positions
from xihenet.metrics import share_above_white, shc_rmse
from xihenet.phone import Request
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
    chain, link = run.settings.chain(run.exposure), phone.link_in_use
    seed, others = run.settings.seed, run.estimators[1:]
    session = PhoneSession(run.plan.probes, chain, run.estimator, link, seed=seed, others=others)
    truth, result = TrueLight(run, session.controller), ChainResult(phone)
    rendered = "reference light" if run.has_truth else "capture"
    for frame in run.plan.frames:
        # Of 2,000 frames with 60 positions it takes minutes.
        yield run.progress(rendered, 1, f"estimating the light from frame {frame}")
        start = time.perf_counter()
        if frame in run.needs.captured:
            entry = _take_in(run, frame, phone, session, truth, keeps_session=keeps_session)
            entry = replace(entry, work_s=time.perf_counter() - start + work_s.get(frame, 0.0) + looked_s)
        else:
            time_s, is_delivered = run.survey.frames[frame].time_s, frame in run.needs.delivered
            entry = FrameResult(frame=frame, time_s=time_s, active=False, is_delivered=is_delivered)
        if entry.active or result.lights:
            result.lights[frame] = _lights_in_use(run, frame, session, truth)
        result.frames.append(entry)
    return result


# ------------------------------------------------------------------------------------------------------------- capture


def render_path(run: PreparedRun) -> Job[dict[int, float]]:
    """A job: render and keep what is not kept yet; seconds of work beside rendering, by frame. Of a recording, whose
    frames are kept before, nothing is rendered."""
    work_s = yield from render_captures(run)
    if run.has_truth:
        yield from _measure_missing(run, work_s)
    return work_s


def render_captures(run: PreparedRun) -> Job[dict[int, float]]:
    """A job: as `render_path`, the captures alone."""
    work_s: dict[int, float] = {}
    asked = [frame for frame in run.plan.frames if frame in run.needs.captured]
    missing = [frame for frame in asked if not is_whole(run.outputs, run.needs, frame)]
    if not missing:
        return work_s
    with open_scanner(run.scene, run.capture) as scanner:
        scanner.exposure = run.exposure
        if run.needs.surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])
        done_share = _done_shares([run.reuse.captures[frame] == frame for frame in missing])
        # Stepped to in any case: simulations need every frame.
        for frame in run.plan.frames[: run.plan.frames.index(missing[-1]) + 1]:
            if frame in missing:
                yield run.progress("capture", next(done_share), f"capturing frame {frame}")
            start = time.perf_counter()
            scanner.move_to(frame)
            if frame in missing:
                rendered_s = _capture(run, frame, scanner)
                work_s[frame] = time.perf_counter() - start - rendered_s
    return work_s


def _measure_missing(run: PreparedRun, work_s: dict[int, float]) -> Job[None]:
    asked = [(frame, probe) for frame in run.plan.frames for probe in run.probes_in_view(frame)]
    missing = [(frame, probe) for frame, probe in asked if not _is_measured(run, frame, probe)]
    if not missing:
        return
    with run.open_probes(run.plan.probes) as reference_probe:
        done_shares = _done_shares([run.reuse.probes[frame, probe.name] == frame for frame, probe in missing])
        for (frame, probe), done_share in zip(missing, done_shares, strict=True):
            doing = f"measuring the light at {probe.name} in frame {frame}"
            progress = run.progress("reference light", done_share, doing)
            yield progress
            measuring = shown(_measure(run, frame, probe, reference_probe), progress)
            rendered_s, worked_s = yield from timed(measuring)
            work_s[frame] = work_s.get(frame, 0.0) + worked_s - rendered_s


def _done_shares(are_rendered: Sequence[bool]) -> Iterator[float]:
    """The share of the renders that is done before each piece; those that are taken over are no work."""
    n_before = np.cumsum([0, *are_rendered])
    yield from (n_before[:-1] / max(1, n_before[-1])).tolist()


def _capture(run: PreparedRun, frame: int, scanner: CyclesScanner) -> float:
    """Keep the capture of `frame`, at which `scanner` is, and what belongs beside it; the seconds of rendering."""
    source, outputs = run.reuse.captures[frame], run.outputs
    if source == frame:
        captured, rendered = scanner.acquire_environment_scan(), scanner.rendered
        render_s = rendered.render_s
        if run.needs.radiance:
            write_radiance(outputs.radiance("captured", frame), first_layer(rendered)[0])
        if run.needs.surfaces:
            save_surfaces(outputs.surfaces(frame), surfaces_in(rendered.passes, run.survey.frames[frame].roughness))
    else:
        beside = (_beside_capture(outputs, run.needs, one) for one in (source, frame))
        for (kept, _), (path, _) in zip(*beside, strict=True):
            copy_whole(kept, path)
        captured = replace(load_frame(outputs.capture(source)), time_s=seconds_of(scanner.scene, frame), frame=frame)
        render_s = 0.0
    save_frame(outputs.capture(frame), captured)
    write_picture(outputs.picture("captured", frame), captured.srgb_u8)
    write_json(outputs.times(frame), {"render_s": render_s})
    return render_s


def is_whole(outputs: RunOutputs, needs: CaptureNeeds, frame: int) -> bool:
    """Whether a capture and its times can be read."""
    times = kept_json(outputs.times(frame), lambda content: float(content["render_s"]))
    return times is not None and is_captured(outputs, needs, frame)


def is_captured(outputs: RunOutputs, needs: CaptureNeeds, frame: int) -> bool:
    """Whether each piece of a capture can be read."""
    pieces: list[tuple[Path, Callable[[Path], object]]] = [(outputs.capture(frame), load_frame)]
    pieces += _beside_capture(outputs, needs, frame)
    return all(read_kept(path, read) is not None for path, read in pieces)


def _beside_capture(
    outputs: RunOutputs, needs: CaptureNeeds, frame: int
) -> Iterator[tuple[Path, Callable[[Path], object]]]:
    """What is kept beside a capture for the phone, and how it is read."""
    if needs.radiance:
        yield outputs.radiance("captured", frame), read_radiance
    if needs.surfaces:
        yield outputs.surfaces(frame), load_surfaces


def _measure(run: PreparedRun, frame: int, probe: Probe, reference_probe: ReferenceProbe) -> Steps[float]:
    """Keep the reference light at `probe` in `frame`; seconds of rendering."""
    source, index = run.reuse.probes[frame, probe.name], run.plan.probes.index(probe)
    panorama = functools.partial(run.outputs.probe, index, probe.name)
    if source == frame:
        reference_probe.move(index, probe.at(frame))
        light = yield from reference_probe.light_by_steps(index, frame, run.exposure)
        measured = light.measured
        write_radiance(panorama(frame), light.panorama)
        if run.settings.has_reflections:
            ball, render_s = reference_probe.mirror_ball(index, frame)
            write_radiance(run.outputs.mirror_ball(index, probe.name, frame), ball)
            measured = replace(measured, render_s=measured.render_s + render_s)
    else:
        measured = replace(read_record(MeasuredLight, _reference(run, probe, source)), render_s=0.0)
        copy_whole(panorama(source), panorama(frame))
    write_json(_reference(run, probe, frame), as_json(measured))
    return measured.render_s


def _is_measured(run: PreparedRun, frame: int, probe: Probe) -> bool:
    """Whether each piece of a reference light can be read."""
    if kept_record(MeasuredLight, _reference(run, probe, frame)) is None:
        return False
    index, is_rendered = run.plan.probes.index(probe), run.reuse.probes[frame, probe.name] == frame
    pieces = [run.outputs.probe(index, probe.name, frame)]
    if run.settings.has_reflections and is_rendered:
        pieces.append(run.outputs.mirror_ball(index, probe.name, frame))
    return all(read_kept(path, read_radiance) is not None for path in pieces)


def _reference(run: PreparedRun, probe: Probe, frame: int) -> Path:
    return run.outputs.reference(run.plan.probes.index(probe), probe.name, frame)


# ----------------------------------------------------------------------------------------------- unproject to estimate


def phone_of_captures(run: PreparedRun) -> SimulatedPhone:
    """The phone of `run`, of which all is captured."""
    facts, metering = {}, run.settings.metering_in_force
    for frame in sorted(run.needs.captured) if run.phone.sees else ():
        surfaces = load_surfaces(run.outputs.surfaces(frame)) if run.needs.surfaces else None
        radiance = read_radiance(run.outputs.radiance("captured", frame)) if run.needs.radiance else None
        positions_m = np.array([probe.at(frame) for probe in run.plan.probes])
        captured = load_frame(run.outputs.capture(frame))
        facts[frame] = facts_of_capture(captured, positions_m, metering, surfaces, radiance)
    return simulate_phone(run.phone, facts, run.exposure)


def _take_in(
    run: PreparedRun, frame: int, phone: SimulatedPhone, session: PhoneSession, truth: TrueLight, *, keeps_session: bool
) -> FrameResult:
    """The capture of `frame`, as the phone sees it, through the chain; `stage_ms` adds up its positions."""
    captured, in_view = load_frame(run.outputs.capture(frame)), run.probes_in_view(frame)
    references = {one.name: read_record(MeasuredLight, _reference(run, one, frame)) for one in in_view if run.has_truth}
    truth.see(frame, references)
    seen, n_lost = phone.see(captured, run.outputs)
    if seen is not captured and keeps_session:
        save_frame(run.outputs.seen(frame), seen)
    if not np.array_equal(seen.srgb_u8, captured.srgb_u8):
        write_picture(run.outputs.picture("captured", frame), seen.srgb_u8)
    true_sh = {name: light.of(run.settings.target) for name, light in references.items()}
    reports, requests = session.step(seen, true_sh, [probe.name for probe in in_view])
    probes = tuple(
        _probe_result(run, probe, reports[probe.name], requests.get(probe.name), seen, session, truth)
        for probe in in_view
    )
    render_s = float(read_json(run.outputs.times(frame))["render_s"])
    estimates = [report.estimate for report in reports.values() if report.estimate is not None]
    left_out = invalid_pixels(seen)
    return FrameResult(
        frame=frame,
        time_s=seen.time_s,
        active=bool(probes),
        captured=True,
        exposure=seen.exposure,
        render_s=render_s + sum(light.render_s for light in references.values()),
        stage_ms=added([session.controller.out_of_view_ms, *(report.stage_ms for report in reports.values())]),
        others_ms=added(estimate.other_ms for estimate in estimates),
        ambient_radiance=None if seen.ambient is None else as_rgb(seen.ambient),
        n_invalid_pixels=sum(left_out.values()),
        n_lost_pixels=n_lost,
        invalid=left_out | {reason: n for reason, n in seen.invalid.items() if reason in CLAMPED},
        probes=probes,
        rendering=_rendering(frame, references, run) if run.has_truth else None,
    )


def _probe_result(
    run: PreparedRun, probe: Probe, report: StepReport, request: Request | None, seen: RgbdFrame, session: PhoneSession,
    truth: TrueLight,
) -> ProbeResult:  # fmt: skip
    """What one step did at one position, and the light in use there after it."""
    reference, time_s = truth.measured(probe.name), seen.time_s
    light = session.light(probe.name, time_s)
    others = {other: session.light(probe.name, time_s, other) for other in run.settings.others}
    true_sh = None if reference is None else reference.of(run.settings.target)
    arrival_frame, latency_ms = _arrival(request, run.phone.times_s)
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
        light_frame=session.light_frame(probe.name, time_s),
        n_followed_anchors=report.n_followed_anchors,
        light_gain=as_rgb(session.gain(probe.name, time_s)),
        payload_bytes=report.payload_bytes,
        arrival_frame=arrival_frame,
        latency_ms=latency_ms,
        sh=as_coefficients(light),
        sh_truth=None if true_sh is None else as_coefficients(true_sh),
        shc_rmse=_error(light, true_sh),
        expected_error=finite_or_none(session.expected_error(probe.name, time_s)),
        ambient_shc_rmse=_error(session.ambient_sh, true_sh),
        others={
            name: OtherLight(sh=as_coefficients(other), shc_rmse=_error(other, true_sh))
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
    index = bisect.bisect_left(list(times_s.values()), request.arrival_s)
    latency_s = request.latency_s
    return frames[index] if index < len(frames) else None, None if latency_s is None else 1e3 * latency_s


def _error(light: ArrayF64, truth: ArrayF64 | None) -> float | None:
    """SHC RMSE of coefficients (9, 3); None where there is no truth."""
    return None if truth is None else shc_rmse(light, truth)


def _rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> Rendering:
    """What was rendered for `frame`, with how many samples and what noise, and what an earlier frame had already."""
    source, count = run.reuse.captures[frame], run.sample_count
    capture = CaptureRender(
        rendered=source == frame,
        same_as=None if source == frame else source,
        samples=count.capture_samples,
        noise=finite_or_none(count.capture_noise),
    )
    probes = {
        name: _probe_render(frame, run.reuse.probes[frame, name], light, run) for name, light in references.items()
    }
    return Rendering(capture=capture, probes=probes)


def _probe_render(frame: int, source: int, light: MeasuredLight, run: PreparedRun) -> ProbeRender:
    target, aim = run.settings.target, run.reference
    samples, noise = light.samples(target), light.noise(target)
    is_too_noisy = noise is not None and aim.noise_target is not None and noise > aim.noise_target
    return ProbeRender(
        rendered=source == frame,
        same_as=None if source == frame else source,
        samples=samples,
        noise=finite_or_none(noise),
        expected_error=finite_or_none(light.expected_error(target)),
        is_capped=is_too_noisy and samples >= aim.max_samples,
    )


def _lights_in_use(run: PreparedRun, frame: int, session: PhoneSession, truth: TrueLight) -> Lights:
    """Light of every method on every virtual object: the mean over the object's estimation positions, and each.

    Truth here is the whole light, not clipped, whatever the target: it shows what order 2 can do in the picture.
    A position that was never in view has no light of its own yet and gets the ambient one.
    """
    ambient_sh, chosen, others = session.ambient_sh, run.settings.estimator, run.settings.others
    time_s = run.survey.frames[frame].time_s
    lights: Lights = {method: {} for method in run.methods}
    for item in run.plan.objects:
        places = {probe.name: probe.at(frame) for probe in run.plan.probes_of(item.name)}
        for method in (chosen, *others):
            other = None if method == chosen else method
            light = session.object_light(list(places), time_s, other)
            if len(places) > 1:
                # What they reflect is the object's.
                each = {name: session.object_light([name], time_s, other, is_reflected=False) for name in places}
                light = with_positions(light, places, each)
            lights[method][item.name] = light
        lights["ambient"][item.name] = ObjectLight(ambient_sh)
        if run.has_truth:
            lights["truth"][item.name] = truth.object_light(places, ambient_sh)
    return lights
