"""The renders of a run: at each frame of the camera path the capture, and the light probes that are in view.

All captures are rendered first, then all light probes: Cycles keeps a room's geometry between the renders of one scene,
and builds it anew when another scene has been rendered in between. In a furnished room of others a capture and a light
probe took 22 s by turns, and 11 s so. What an earlier part of the run kept is not rendered again, and what is as in an
earlier frame is taken over from there. Everything is kept file by file before anything is made of it.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, load_surfaces, save_surfaces, surfaces_in
from xihe_blender.capture.reference_probe import MeasuredLight, ReferenceProbe, open_reference_probe
from xihe_blender.capture.scanner import CyclesScanner, first_layer, open_scanner, session_time_s
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.json_records import Json, as_json
from xihe_blender.io.kept_files import kept_json, read_kept
from xihe_blender.io.outputs import copy_whole, write_json, write_picture
from xihe_blender.jobs import Progress
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihenet.json_files import read_json
from xihenet.recording import load_frame, save_frame
from xihenet.records import RgbdFrame


@dataclass(frozen=True, eq=False)
class FrameRenders:
    """The capture of one frame before the phone has a hand in it, and the reference lights by name of the probe.

    `render_s` are the seconds that rendering took, in whichever part of the run.
    """

    captured: RgbdFrame
    references: Mapping[str, MeasuredLight]
    render_s: float


class PathRenders:
    """What is kept of the renders of one run."""

    def __init__(self, run: PreparedRun) -> None:
        self.run, self.outputs = run, run.outputs

    def at(self, frame: int) -> FrameRenders | None:
        """The renders of `frame` and of the probes in view; None where the run captures nothing.

        They have been made before, by `render_path`: ValueError or OSError where one is lost since.
        """
        probes = self.run.probes_in_view(frame)
        if not probes:
            return None
        lights = {probe.name: _kept_light(read_json(self.reference(probe, frame))) for probe in probes}
        capture_s = float(read_json(self.outputs.times(frame))["render_s"])
        render_s = capture_s + sum(probe_s for _, probe_s in lights.values())
        references = {name: light for name, (light, _) in lights.items()}
        return FrameRenders(load_frame(self.outputs.capture(frame)), references, render_s)

    def is_captured(self, frame: int) -> bool:
        """Whether each piece of a capture can be read."""
        if kept_json(self.outputs.times(frame), lambda content: float(content["render_s"])) is None:
            return False
        pieces: list[tuple[Path, Callable[[Path], object]]] = [(self.outputs.capture(frame), load_frame)]
        pieces += self._beside_capture(frame)
        return all(read_kept(path, read) is not None for path, read in pieces)

    def _beside_capture(self, frame: int) -> Iterator[tuple[Path, Callable[[Path], object]]]:
        """What is kept beside a capture for the phone, and how it is read."""
        if self.run.needs.radiance:
            yield self.outputs.radiance("captured", frame), read_radiance
        if self.run.needs.surfaces:
            yield self.outputs.surfaces(frame), load_surfaces

    def capture(self, frame: int, scanner: CyclesScanner) -> float:
        """Keep the capture of `frame`, at which `scanner` is, and what belongs beside it; the seconds of rendering."""
        source, outputs = self.run.reuse.captures[frame], self.outputs
        if source == frame:
            captured, rendered = scanner.acquire_environment_scan(), scanner.rendered
            render_s = rendered.render_s
            if self.run.needs.radiance:
                write_radiance(outputs.radiance("captured", frame), first_layer(rendered)[0])
            if self.run.needs.surfaces:
                roughness = self.run.survey.frames[frame].roughness
                save_surfaces(outputs.surfaces(frame), surfaces_in(rendered.passes, roughness))
        else:
            for (kept, _), (path, _) in zip(self._beside_capture(source), self._beside_capture(frame), strict=True):
                copy_whole(kept, path)
            captured = replace(load_frame(outputs.capture(source)), time_s=session_time_s(scanner.scene), frame=frame)
            render_s = 0.0
        save_frame(outputs.capture(frame), captured)
        write_picture(outputs.picture("captured", frame), captured.srgb_u8)
        write_json(outputs.times(frame), {"render_s": render_s})
        return render_s

    def measure(self, frame: int, probe: Probe, reference_probe: ReferenceProbe) -> float:
        """Keep the reference light at `probe` in `frame`; seconds of rendering."""
        source, index = self.run.reuse.probes[frame, probe.name], self.run.plan.probes.index(probe)
        panorama = functools.partial(self.outputs.probe, index, probe.name)
        if source == frame:
            reference_probe.move(index, probe.at(frame))
            light = reference_probe.light_at(index, frame, self.run.exposure)
            measured, render_s = light.measured, light.render_s
            write_radiance(panorama(frame), light.panorama)
        else:
            measured, render_s = _kept_light(read_json(self.reference(probe, source)))[0], 0.0
            copy_whole(panorama(source), panorama(frame))
        write_json(self.reference(probe, frame), {"light": as_json(measured), "render_s": render_s})
        return render_s

    def reference(self, probe: Probe, frame: int) -> Path:
        return self.outputs.reference(self.run.plan.probes.index(probe), probe.name, frame)


def _kept_light(content: Json) -> tuple[MeasuredLight, float]:
    return MeasuredLight.from_json(content["light"]), float(content["render_s"])


def render_path(run: PreparedRun) -> Generator[Progress, None, dict[int, float]]:
    """A job: render and keep what is not kept yet; seconds of work beside rendering, by frame."""
    renders, work_s = PathRenders(run), dict[int, float]()
    yield from _capture_missing(run, renders, work_s)
    yield from _measure_missing(run, renders, work_s)
    return work_s


def _capture_missing(run: PreparedRun, renders: PathRenders, work_s: dict[int, float]) -> Iterator[Progress]:
    missing = [frame for frame in run.plan.frames if run.probes_in_view(frame) and not renders.is_captured(frame)]
    if not missing:
        return
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
                rendered_s = renders.capture(frame, scanner)
                work_s[frame] = time.perf_counter() - start - rendered_s


def _measure_missing(run: PreparedRun, renders: PathRenders, work_s: dict[int, float]) -> Iterator[Progress]:
    asked = [(frame, probe) for frame in run.plan.frames for probe in run.probes_in_view(frame)]
    missing = [(f, probe) for f, probe in asked if kept_json(renders.reference(probe, f), _kept_light) is None]
    if not missing:
        return
    probes, items = run.plan.probes, {item.name: item for item in run.plan.objects}
    positions_m, objects = [p.position_m for p in probes], [items[p.object_name] for p in probes]
    with open_reference_probe(run.scene, positions_m, run.reference, objects) as reference_probe:
        done_shares = _done_shares([run.reuse.probes[frame, probe.name] == frame for frame, probe in missing])
        for (frame, probe), done_share in zip(missing, done_shares, strict=True):
            yield run.progress("reference light", done_share, f"measuring the light at {probe.name} in frame {frame}")
            start = time.perf_counter()
            rendered_s = renders.measure(frame, probe, reference_probe)
            work_s[frame] = work_s.get(frame, 0.0) + time.perf_counter() - start - rendered_s


def _done_shares(are_rendered: Sequence[bool]) -> Iterator[float]:
    """The share of the renders that is done before each piece; those that are taken over are no work."""
    n_before = np.cumsum([0, *are_rendered])
    yield from (n_before[:-1] / max(1, n_before[-1])).tolist()
