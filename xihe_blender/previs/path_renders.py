"""What does a run render at each frame of the camera path: the capture, and the light probes that are in view?

Read where an earlier part of the run kept them, taken over from an earlier frame where nothing has changed since, else
rendered. What is rendered is kept file by file before anything is made of it.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from xihe_blender.capture.reference_probe import MeasuredLight, ReferenceProbe, open_reference_probe
from xihe_blender.capture.scanner import CyclesScanner, open_scanner
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.outputs import copy_whole, write_json, write_picture
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihenet.recording import load_frame, save_frame
from xihenet.records import RgbdFrame


class KeepsRenders(Protocol):
    """Whoever looks at the renders: a `PhoneCapture`, or several that share them."""

    delivered: frozenset[int]

    def prepare(self, scanner: CyclesScanner) -> None: ...
    def keep(self, scanner: CyclesScanner, frame: int) -> None: ...
    def take_over(self, source: int, frame: int) -> None: ...


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

    def __init__(self, run: PreparedRun, phone: KeepsRenders, scanner: CyclesScanner, probe: ReferenceProbe) -> None:
        self.run, self.phone, self.scanner, self.reference_probe = run, phone, scanner, probe

    def move_to(self, frame: int) -> tuple[float, list[Probe]]:
        """The time of `frame`, and the probes that its camera sees; none if the phone does not deliver it."""
        seen = self.run.plan.probes_in_view(self.scanner, frame)
        return self.scanner.time_s, seen if frame in self.phone.delivered else []

    def at(self, frame: int, probes: Sequence[Probe]) -> FrameRenders:
        """The renders of `frame`, to which `move_to` has moved, and of `probes`, those in view."""
        # Asked in any case: the first frame that asks is the one that holds the render.
        kept = self.run.kept
        source, sources = kept.capture(frame), {probe.name: kept.probe(frame, probe.name) for probe in probes}
        if self.run.outputs.times(frame).exists():
            return self._kept(frame, probes)
        captured, capture_s = self._captured(frame, source)
        references, probes_s = self._measured(frame, probes, sources)
        render_s = capture_s + probes_s
        outputs = self.run.outputs
        save_frame(outputs.capture(frame), captured)
        write_picture(outputs.picture("captured", frame), captured.srgb_u8)
        write_json(outputs.times(frame), {"render_s": render_s})
        return FrameRenders(captured, references, render_s, render_s)

    def _kept(self, frame: int, probes: Sequence[Probe]) -> FrameRenders:
        outputs = self.run.outputs
        render_s = float(json.loads(outputs.times(frame).read_text(encoding="utf-8"))["render_s"])
        references = {probe.name: self._read_reference(probe, frame) for probe in probes}
        return FrameRenders(load_frame(outputs.capture(frame)), references, render_s, 0.0)

    def _captured(self, frame: int, source: int) -> tuple[RgbdFrame, float]:
        """The capture, and the seconds that rendering it took."""
        if source == frame:
            captured = self.scanner.acquire_environment_scan()
            self.phone.keep(self.scanner, frame)
            return captured, self.scanner.render_s
        self.phone.take_over(source, frame)
        captured = load_frame(self.run.outputs.capture(source))
        return replace(captured, time_s=self.scanner.time_s, frame=frame), 0.0

    def _measured(
        self, frame: int, probes: Sequence[Probe], sources: Mapping[str, int]
    ) -> tuple[dict[str, MeasuredLight], float]:
        """The reference light of each probe, kept, and the seconds that rendering took."""
        references, render_s = {}, 0.0
        for probe in probes:
            source = sources[probe.name]
            if source == frame:
                render_s += self._measure(probe, frame)
            else:
                self._take_over(probe, source, frame)
            references[probe.name] = self._read_reference(probe, frame)
        return references, render_s

    def _measure(self, probe: Probe, frame: int) -> float:
        outputs, place = self.run.outputs, self._place(probe)
        light = self.reference_probe.light_at(place, frame, self.run.exposure)
        write_radiance(outputs.probe(place, probe.name, frame), light.panorama)
        write_json(outputs.reference(place, probe.name, frame), light.measured.as_json())
        return light.render_s

    def _take_over(self, probe: Probe, source: int, frame: int) -> None:
        outputs, place = self.run.outputs, self._place(probe)
        for kind in (outputs.probe, outputs.reference):
            copy_whole(kind(place, probe.name, source), kind(place, probe.name, frame))

    def _read_reference(self, probe: Probe, frame: int) -> MeasuredLight:
        path = self.run.outputs.reference(self._place(probe), probe.name, frame)
        return MeasuredLight.from_json(json.loads(path.read_text(encoding="utf-8")))

    def _place(self, probe: Probe) -> int:
        return self.run.plan.probes.index(probe)


@contextlib.contextmanager
def open_path_renders(run: PreparedRun, phone: KeepsRenders) -> Iterator[PathRenders]:
    """The renders of `run`, with what `phone` needs of them."""
    probes, items = run.plan.probes, {item.name: item for item in run.plan.objects}
    positions_m, objects = [p.position_m for p in probes], [items[p.object_name] for p in probes]
    with (
        open_scanner(run.scene, run.capture) as scanner,
        open_reference_probe(run.scene, positions_m, run.reference, objects) as reference_probe,
    ):
        scanner.exposure = run.exposure
        phone.prepare(scanner)
        yield PathRenders(run, phone, scanner, reference_probe)
