"""The renders of a run: the capture at each frame that the phone takes in, and the light probes that are in view.

All captures are rendered first, then all light probes: Cycles keeps a room's geometry between the renders of one scene,
and builds it anew when another scene has been rendered in between. In a furnished room of others a capture and a light
probe took 22 s by turns, and 11 s so. What an earlier part of the run kept is not rendered again, and what is as in an
earlier frame is taken over from there. Everything is kept file by file before anything is made of it.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, load_surfaces, save_surfaces, surfaces_in
from xihe_blender.capture.reference_probe import MeasuredLight, ReferenceProbe
from xihe_blender.capture.scanner import CyclesScanner, first_layer, open_scanner
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.json_records import as_json, read_record
from xihe_blender.io.kept_files import kept_json, kept_record, read_kept
from xihe_blender.io.outputs import RunOutputs, copy_whole, finite_or_none, write_json, write_picture
from xihe_blender.io.run_results import CaptureRender, ProbeRender, Rendering
from xihe_blender.jobs import Job, Steps, shown, timed
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.simulated_phone import CaptureNeeds
from xihe_blender.scene.units import seconds_of
from xihenet.io.json_files import read_json
from xihenet.io.recording import load_frame, save_frame
from xihenet.records import RgbdFrame


@dataclass(frozen=True, eq=False)
class FrameRenders:
    """The capture of one frame before the phone has a hand in it, and the reference lights by name of the probe.

    `render_s` are the seconds that rendering took, in whichever part of the run.
    """

    captured: RgbdFrame
    references: Mapping[str, MeasuredLight]
    render_s: float


def kept_renders(run: PreparedRun, frame: int) -> FrameRenders | None:
    """The renders of `frame` and of the probes in view; None where the run captures nothing.

    They have been made before, by `render_path`: ValueError or OSError where one is lost since.
    """
    if frame not in run.needs.captured:
        return None
    probes = run.probes_in_view(frame) if run.has_truth else []
    references = {probe.name: read_record(MeasuredLight, _reference(run, probe, frame)) for probe in probes}
    capture_s = float(read_json(run.outputs.times(frame))["render_s"])
    render_s = capture_s + sum(light.render_s for light in references.values())
    return FrameRenders(load_frame(run.outputs.capture(frame)), references, render_s)


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
    if not run.settings.has_reflections or run.reuse.probes[frame, probe.name] != frame:
        return True
    mirror_ball = run.outputs.mirror_ball(run.plan.probes.index(probe), probe.name, frame)
    return read_kept(mirror_ball, read_radiance) is not None


def rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> Rendering:
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


def _reference(run: PreparedRun, probe: Probe, frame: int) -> Path:
    return run.outputs.reference(run.plan.probes.index(probe), probe.name, frame)


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

    def is_whole(frame: int) -> bool:
        times = kept_json(run.outputs.times(frame), lambda content: float(content["render_s"]))
        return times is not None and is_captured(run.outputs, run.needs, frame)

    missing = [frame for frame in run.plan.frames if frame in run.needs.captured and not is_whole(frame)]
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
