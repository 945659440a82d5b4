"""The true light at each estimation position: what the method `truth` lights objects with, as rendered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from xihe_blender.capture.reference_probe import MeasuredLight
from xihe_blender.io.exr import read_radiance
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihenet.colour import linear_to_srgb
from xihenet.controller import XiheController
from xihenet.light.key_light import find_key_light, mean_light, with_positions
from xihenet.light.reflections import rendered_reflections
from xihenet.mirror_ball import seen_in_ball
from xihenet.panorama import panorama_directions, solid_angles
from xihenet.records import ArrayF64, KeyLight, ObjectLight, Reflections, UnitSphereCloud
from xihenet.sphere import AnchorLattice


@dataclass(frozen=True, eq=False)
class _AtProbe:
    """The light at one probe as rendered for the frame `source`; a key light and reflections where the run has any."""

    source: int
    measured: MeasuredLight
    key: KeyLight | None
    reflections: Reflections | None


class TrueLight:
    """The light at each probe of `run` as last measured, in the directions in which its `controller` looks."""

    def __init__(self, run: PreparedRun, controller: XiheController) -> None:
        self.run, self.lattice, self.fine_lattice = run, controller.lattice, controller.fine_lattice
        self.at: dict[str, _AtProbe] = {}

    def see(self, frame: int, references: Mapping[str, MeasuredLight]) -> None:
        """Take in the reference lights of `frame`, by name of the probe."""
        for probe in (one for one in self.run.plan.probes if one.name in references):
            source, before = self.run.reuse.probes[frame, probe.name], self.at.get(probe.name)
            if before is not None and before.source == source:
                continue
            measured, key, reflections = references[probe.name], None, None
            if self.run.settings.has_key_light:
                view, previous = true_view(self.run, probe, frame, self.lattice), None if before is None else before.key
                key = find_key_light(measured.hdr, view, self.lattice, previous, is_exposed=False)
            is_first = probe == self.run.plan.probes_of(probe.object_name)[0]
            if self.fine_lattice is not None and self.run.settings.has_reflections and is_first:
                reflections = true_reflections(self.run, probe, frame, self.fine_lattice)
            self.at[probe.name] = _AtProbe(source, measured, key, reflections)

    def measured(self, name: str) -> MeasuredLight | None:
        """The last reference light of a probe; None before the first."""
        return self.at[name].measured if name in self.at else None

    def object_light(self, places_m: Mapping[str, ArrayF64], ambient_sh: ArrayF64) -> ObjectLight:
        """The light on an object whose probes are at `places_m`, by name: their mean, and each where there are several.

        What is reflected is that of the first probe. A probe that was never in view gets the ambient light.
        """
        each = {name: ObjectLight(ambient_sh) for name in places_m}
        each |= {name: ObjectLight(seen.measured.hdr, seen.key) for name, seen in self.at.items() if name in places_m}
        first = self.at.get(next(iter(places_m)))
        light = replace(mean_light(list(each.values())), reflections=None if first is None else first.reflections)
        return with_positions(light, places_m, each) if len(each) > 1 else light


def true_reflections(run: PreparedRun, probe: Probe, frame: int, lattice: AnchorLattice) -> Reflections:
    """What glossy things at `probe` reflect in `frame`, rendered, at the run's exposure."""
    source, index = run.reuse.probes[frame, probe.name], run.plan.probes.index(probe)
    ball = read_radiance(run.outputs.mirror_ball(index, probe.name, source))
    return rendered_reflections(ball * np.float32(run.exposure), lattice)


def true_view(run: PreparedRun, probe: Probe, frame: int, lattice: AnchorLattice) -> UnitSphereCloud:
    """All that can be seen from `probe` in `frame`, rendered, as bright as it is: 1 is the brightest there is.

    As glossy things see it where the run has that, else as cameras do, without lamps that are hidden from them.
    """
    source, index = run.reuse.probes[frame, probe.name], run.plan.probes.index(probe)
    panorama = read_radiance(run.outputs.probe(index, probe.name, source))
    height, width, _ = panorama.shape
    directions = panorama_directions(height, width).reshape(-1, 3)
    radiance = panorama.reshape(-1, 3)
    if run.settings.has_reflections:
        radiance = seen_in_ball(read_radiance(run.outputs.mirror_ball(index, probe.name, source)), directions)
    means, is_set = lattice.means(directions, radiance.clip(0), solid_angles(height, width).ravel())
    shown = linear_to_srgb(means / max(float(means.max()), 1e-12)).astype(np.float32)
    return UnitSphereCloud(shown, is_set.astype(np.float32), is_set)
