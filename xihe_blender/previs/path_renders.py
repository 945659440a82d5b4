"""The renders of a run: at each frame of the camera path the capture, and the light probes that are in view.

Read where an earlier part of the run kept them, taken over from an earlier frame where nothing has changed since, else
rendered. What is rendered is kept file by file before anything is made of it.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, load_surfaces, save_surfaces, surfaces_in
from xihe_blender.capture.reference_probe import MeasuredLight, ReferenceProbe, open_reference_probe
from xihe_blender.capture.scanner import CyclesScanner, first_layer, open_scanner
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.kept_files import kept_json, read_kept
from xihe_blender.io.outputs import copy_whole, write_json, write_picture
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihenet.json_files import read_json
from xihenet.recording import load_frame, save_frame
from xihenet.records import RgbdFrame


@dataclass(frozen=True, eq=False)
class FrameRenders:
    """The perfect capture of one frame and what stands at its light probes.

    Parameters
    ----------
    captured : before the phone has a hand in it
    references : the reference light by name of the probe
    render_s : seconds that rendering took, in whichever part of the run
    rendered_now_s : seconds of these in this process
    """

    captured: RgbdFrame
    references: Mapping[str, MeasuredLight]
    render_s: float
    rendered_now_s: float


class PathRenders:
    """Renders of one run; made by `open_path_renders`. Asked frame by frame, in order."""

    def __init__(self, run: PreparedRun, scanner: CyclesScanner, probe: ReferenceProbe) -> None:
        self.run, self.scanner, self.reference_probe = run, scanner, probe

    def at(self, frame: int) -> FrameRenders | None:
        """The renders of `frame` and of the probes in view; None where the run captures nothing."""
        # Stepped to in any case: simulations need every frame.
        self.scanner.move_to(frame)
        probes = self.run.probes_in_view(frame)
        if not probes:
            return None
        kept = self._kept(frame, probes)
        if kept is not None:
            return kept
        captured, capture_s = self._captured(frame)
        references, probes_s = self._measured(frame, probes)
        render_s = capture_s + probes_s
        outputs = self.run.outputs
        save_frame(outputs.capture(frame), captured)
        write_picture(outputs.picture("captured", frame), captured.srgb_u8)
        write_json(outputs.times(frame), {"render_s": render_s})
        return FrameRenders(captured, references, render_s, render_s)

    def _kept(self, frame: int, probes: Sequence[Probe]) -> FrameRenders | None:
        """What an earlier part of the run has left; None if it has not, or if anything of it is lost or damaged."""
        outputs = self.run.outputs
        render_s = kept_json(outputs.times(frame), lambda content: float(content["render_s"]))
        if render_s is None:
            return None
        captured = read_kept(outputs.capture(frame), load_frame)
        references = {probe.name: kept_json(self._reference(probe, frame), MeasuredLight.from_json) for probe in probes}
        measured = {name: light for name, light in references.items() if light is not None}
        is_whole = len(measured) == len(probes) and all(self._is_kept_beside(frame))
        return FrameRenders(captured, measured, render_s, 0.0) if captured is not None and is_whole else None

    def _captured(self, frame: int) -> tuple[RgbdFrame, float]:
        """The capture, and the seconds that rendering it took; what is kept beside it is written."""
        source = self.run.reuse.captures[frame]
        if source == frame:
            captured = self.scanner.acquire_environment_scan()
            self._keep_passes(frame)
            return captured, self.scanner.render_s
        for path_at in self._beside_captures():
            copy_whole(path_at(source), path_at(frame))
        captured = load_frame(self.run.outputs.capture(source))
        return replace(captured, time_s=self.scanner.time_s, frame=frame), 0.0

    def _keep_passes(self, frame: int) -> None:
        """Store what the last render has for the phone, beside the capture itself."""
        outputs, rendered = self.run.outputs, self.scanner.rendered
        if self.run.needs.radiance:
            write_radiance(outputs.radiance("captured", frame), first_layer(rendered)[0])
        if self.run.needs.surfaces:
            passes, roughness = next(iter(rendered.layers.values())), self.run.survey.frames[frame].roughness
            save_surfaces(outputs.surfaces(frame), surfaces_in(passes, roughness))

    def _is_kept_beside(self, frame: int) -> Iterator[bool]:
        """Whether each of what stands beside the capture can be read."""
        if self.run.needs.radiance:
            yield read_kept(self.run.outputs.radiance("captured", frame), read_radiance) is not None
        if self.run.needs.surfaces:
            yield read_kept(self.run.outputs.surfaces(frame), load_surfaces) is not None

    def _beside_captures(self) -> Iterator[Callable[[int], Path]]:
        """Where that is stored, by frame."""
        if self.run.needs.radiance:
            yield functools.partial(self.run.outputs.radiance, "captured")
        if self.run.needs.surfaces:
            yield self.run.outputs.surfaces

    def _measured(self, frame: int, probes: Sequence[Probe]) -> tuple[dict[str, MeasuredLight], float]:
        """The reference light of each probe, kept, and the seconds that rendering took."""
        references, render_s = {}, 0.0
        for probe in probes:
            source = self.run.reuse.probes[frame, probe.name]
            if source == frame:
                render_s += self._measure(probe, frame)
            else:
                self._take_over(probe, source, frame)
            references[probe.name] = MeasuredLight.from_json(read_json(self._reference(probe, frame)))
        return references, render_s

    def _measure(self, probe: Probe, frame: int) -> float:
        outputs, index = self.run.outputs, self._index(probe)
        light = self.reference_probe.light_at(index, frame, self.run.exposure)
        write_radiance(outputs.probe(index, probe.name, frame), light.panorama)
        write_json(outputs.reference(index, probe.name, frame), light.measured.as_json())
        return light.render_s

    def _take_over(self, probe: Probe, source: int, frame: int) -> None:
        outputs, index = self.run.outputs, self._index(probe)
        for kind in (outputs.probe, outputs.reference):
            copy_whole(kind(index, probe.name, source), kind(index, probe.name, frame))

    def _reference(self, probe: Probe, frame: int) -> Path:
        return self.run.outputs.reference(self._index(probe), probe.name, frame)

    def _index(self, probe: Probe) -> int:
        return self.run.plan.probes.index(probe)


@contextlib.contextmanager
def open_path_renders(run: PreparedRun) -> Iterator[PathRenders]:
    """The renders of `run`, with what it needs beside them."""
    probes, items = run.plan.probes, {item.name: item for item in run.plan.objects}
    positions_m, objects = [p.position_m for p in probes], [items[p.object_name] for p in probes]
    with (
        open_scanner(run.scene, run.capture) as scanner,
        open_reference_probe(run.scene, positions_m, run.reference, objects) as reference_probe,
    ):
        scanner.exposure = run.exposure
        if run.needs.surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])
        yield PathRenders(run, scanner, reference_probe)
