"""One session as the app on the phone lives it: its frames go into the chain, estimates come back when they arrive.

The chain is the controller's and stays as it is; the delay between an estimate and the light in force is added behind
it, here alone. A run has one session; the report makes more of them, from the same captures, with one effect left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.settings import PrevisSettings
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.light.key_light import mean_light
from xihenet.light.reflections import fill_reflections
from xihenet.phone import EstimatesUnderWay, Link, Request
from xihenet.records import ArrayF64, ObjectLight, PointCloud, Reflections, RgbdFrame, StepReport, UnitSphereCloud


class PhoneSession:
    """State of one session: the controller, and the estimates under way.

    Anchors and estimates carry the session's `exposure`. Estimates are asked for over `link`; None lets them arrive in
    their own frame.
    """

    def __init__(
        self, plan: PrevisPlan, settings: PrevisSettings, exposure: float, estimator: Estimator, link: Link | None,
        others: Sequence[Estimator] = (),
    ) -> None:  # fmt: skip
        chain = ControllerSettings(
            settings.trigger,
            reference_exposure=exposure,
            following=settings.following,
            learns_out_of_view=settings.captured == "path",
            has_key_light=settings.has_key_light,
            has_reflections=settings.has_reflections,
        )
        self.controller = XiheController(LocalBackend(estimator), chain, others=[LocalBackend(one) for one in others])
        self.probes = {probe.name: probe for probe in plan.probes}
        for probe in plan.probes:
            self.controller.add_position(probe.name, probe.position_m)
        self.exposure = exposure
        self.under_way = EstimatesUnderWay(link, settings.seed)
        self.ambient = estimators.load("ambient", settings.n_anchors, settings.target)
        self.unseen = UnitSphereCloud.empty(settings.n_anchors)
        self.ambient_sh = np.zeros((9, 3))
        """Of the last frame."""
        self._filled: dict[tuple[str, str | None], tuple[bytes, Reflections]] = {}
        """The last reflections by position and other estimator, and what they were filled with."""

    def step(
        self, seen: RgbdFrame, truth: dict[str, ArrayF64], active: Sequence[str], points: PointCloud | None = None
    ) -> tuple[dict[str, StepReport], dict[str, Request]]:
        """Run the chain on a frame of the phone, and send for the estimates that it makes.

        Gives reports and requests by position. `truth` are (9, 3) coefficients of the rendered probe by position,
        `active` the positions in view of the true camera, whatever pose the phone believes in, `points` the frame's at
        the session's exposure, where they are known already.
        """
        for name, probe in self.probes.items():
            if name in active or self.controller.settings.learns_out_of_view:
                self.controller.move_position(name, probe.at(seen.frame))
        reports = self.controller.step(seen, truth, active=active, points=points)
        requests = {}
        for name, report in reports.items():
            if report.estimate is not None:
                requests[name] = self.under_way.ask(
                    name, report.estimate, frame=seen.frame, asked_s=seen.time_s, payload_bytes=report.payload_bytes
                )
        context = EstimateContext(frame=seen, reference_exposure=self.exposure)
        self.ambient_sh = self.ambient.estimate(self.unseen, context)
        return reports, requests

    def light(self, name: str, time_s: float, other: str | None = None) -> ArrayF64:
        """(9, 3) the light in force at a position: its last valid estimate that arrived, until then the ambient one.

        With `other`, what the estimator of that name said beside it, ambient where it could not know.
        """
        request = self.under_way.in_force(name, time_s)
        if request is None:
            return self.ambient_sh
        return request.estimate.sh_radiance if other is None else request.estimate.others.get(other, self.ambient_sh)

    def object_light(self, names: Sequence[str], time_s: float, other: str | None = None) -> ObjectLight:
        """The light in force of an object, of which `names` are the positions: their mean, and its key light.

        `other` as of `light`; the ambient light has no key light. Reflections, where the session has them, are those at
        the first of the positions.
        """
        lights = []
        for name in names:
            request, key = self.under_way.in_force(name, time_s), None
            if request is not None:
                key = request.estimate.key if other is None else request.estimate.other_keys.get(other)
            lights.append(ObjectLight(self.light(name, time_s, other), key))
        return self._with_reflections(mean_light(lights), names[0], time_s, other)

    def _with_reflections(self, light: ObjectLight, name: str, time_s: float, other: str | None) -> ObjectLight:
        lattice, request = self.controller.fine_lattice, self.under_way.in_force(name, time_s)
        if lattice is None:
            return light
        cloud = UnitSphereCloud.empty(len(lattice))
        if request is not None and request.estimate.reflected is not None:
            cloud = request.estimate.reflected
        made_of = light.tobytes() + (b"" if request is None else str(request.frame).encode())
        kept = self._filled.get((name, other))
        if kept is None or kept[0] != made_of:
            kept = self._filled[name, other] = made_of, fill_reflections(cloud, lattice, light)
        return replace(light, reflections=kept[1])

    def expected_error(self, name: str, time_s: float) -> float | None:
        """SHC RMSE that the estimator expects of the light in force; None for the ambient one, or if it says none."""
        request = self.under_way.in_force(name, time_s)
        return None if request is None else request.estimate.expected_error

    def light_frame(self, name: str, time_s: float) -> int | None:
        """The frame from which the light in force comes; None for the ambient one."""
        request = self.under_way.in_force(name, time_s)
        return None if request is None else request.frame
