"""A session as the app on the phone lives it: its frames go into the chain, estimates come back when they arrive.

The chain is the controller's and stays as it is; the delay between an estimate and the light in use is added behind
it, here alone. A run has one session; the report makes more of them, from the same captures, with one effect left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.light.carried_light import BLEND_S, CarriedLight, blended
from xihenet.light.key_light import mean_light
from xihenet.light.reflections import fill_reflections
from xihenet.phone import EstimatesUnderWay, Link, Request
from xihenet.records import ArrayF64, ObjectLight, PointCloud, Reflections, RgbdFrame, StepReport, UnitSphereCloud


class Position(Protocol):
    """An estimation position: its name, where it is at first, and where in a frame, (3,) world, metres."""

    @property
    def name(self) -> str: ...
    @property
    def position_m(self) -> ArrayF64: ...
    def at(self, frame: int) -> ArrayF64: ...


class PhoneSession:
    """State of one session: the controller, and the estimates under way.

    Anchors and estimates carry the `reference_exposure` of `chain`, which says too whether light is carried between
    estimates. These are asked for over `link`, whose delays `seed` draws; None lets them arrive in their own frame.
    """

    def __init__(
        self, positions: Sequence[Position], chain: ControllerSettings, estimator: Estimator, link: Link | None,
        *, seed: int, others: Sequence[Estimator] = (),
    ) -> None:  # fmt: skip
        # The controller carries no light on: what is in use is decided here, behind the delay.
        kept = replace(chain, between_estimates="kept")
        self.controller = XiheController(LocalBackend(estimator), kept, others=[LocalBackend(one) for one in others])
        self.positions = {position.name: position for position in positions}
        for position in positions:
            self.controller.add_position(position.name, position.position_m)
        self.exposure = chain.reference_exposure
        self.under_way = EstimatesUnderWay(link, seed)
        self.ambient = estimators.load("ambient", estimator.n_anchors, estimator.target)
        self.unseen = UnitSphereCloud.empty(estimator.n_anchors)
        self.ambient_sh = np.zeros((9, 3))
        """Of the last frame."""
        self.is_carried = chain.between_estimates == "carried"
        self._carried: dict[str, dict[int, CarriedLight]] = {name: {} for name in self.positions}
        """By position and frame of the estimate, of those in use or still under way; empty where light is kept."""
        self._seen: dict[str, UnitSphereCloud] = {}
        """What the lights of a position have been carried on to."""
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
        for name, position in self.positions.items():
            if name in active or self.controller.settings.learns_out_of_view:
                self._move(name, position.at(seen.frame))
        reports = self.controller.step(seen, truth, active=active, points=points)
        self._carry(seen.time_s)
        requests = {}
        for name, report in reports.items():
            if report.estimate is not None:
                requests[name] = self.under_way.ask(
                    name, report.estimate, frame=seen.frame, asked_s=seen.time_s, payload_bytes=report.payload_bytes
                )
                if self.is_carried and report.estimate.is_valid:
                    self._carried[name][seen.frame] = CarriedLight(report.estimate)
        context = EstimateContext(frame=seen, reference_exposure=self.exposure)
        self.ambient_sh = self.ambient.estimate(self.unseen, context)
        return reports, requests

    def _move(self, name: str, place_m: ArrayF64) -> None:
        if not np.array_equal(place_m, self.controller.positions[name]):
            self._carried[name] = {frame: one.moved() for frame, one in self._carried[name].items()}
            self._seen.pop(name, None)
        self.controller.move_position(name, place_m)

    def _carry(self, time_s: float) -> None:
        """Have the light of all positions that the last frame was sampled at go on to it."""
        directions = self.controller.lattice.directions
        for name, lights in self._carried.items():
            last, seen = self.under_way.in_use(name, time_s), self.controller.seen(name)
            if seen is None or seen is self._seen.get(name):
                continue
            before, self._seen[name] = self._seen.get(name), seen
            wanted = {request.frame for _, request in self.under_way.shares(name, time_s, BLEND_S)}
            since = last.frame if last else None
            kept = {f: one for f, one in lights.items() if f in wanted or since is None or f > since}
            self._carried[name] = {frame: one.after(seen, before, directions) for frame, one in kept.items()}

    def light(self, name: str, time_s: float, other: str | None = None) -> ArrayF64:
        """(9, 3) the light in use at a position: its last valid estimate that arrived, until then the ambient one.

        With `other`, what the estimator of that name said beside it, ambient where it could not know. Where light is
        carried between estimates it has gone on to the last frame, and a late one blends in, see `carried_light`.
        """
        return self._light_at(name, time_s, other).sh

    def object_light(
        self, names: Sequence[str], time_s: float, other: str | None = None, *, is_reflected: bool = True
    ) -> ObjectLight:
        """The light in use of an object, of which `names` are the positions: their mean, and its key light.

        `other` as of `light`; the ambient light has no key light. Reflections, where the session has them, are those at
        the first of the positions; they are carried, and of a late estimate they come at once. Without `is_reflected`
        they are left out, for the light at single positions of an object: they are filled for one light at a time.
        """
        light = mean_light([self._light_at(name, time_s, other) for name in names])
        return self._with_reflections(light, names, time_s, other) if is_reflected else light

    def _light_at(self, name: str, time_s: float, other: str | None) -> ObjectLight:
        if not self.is_carried:
            return self._light_of(self.under_way.in_use(name, time_s), other)
        shares = self.under_way.shares(name, time_s, BLEND_S)
        if not shares:
            return ObjectLight(self.ambient_sh)
        each = [replace(one, estimate=self._carried[name][one.frame].light) for _, one in shares]
        return blended([(share, self._light_of(one, other)) for (share, _), one in zip(shares, each, strict=True)])

    def _light_of(self, request: Request | None, other: str | None) -> ObjectLight:
        """What a request brought."""
        if request is None:
            return ObjectLight(self.ambient_sh)
        estimate = request.estimate
        if other is None:
            return ObjectLight(estimate.sh_radiance, estimate.key)
        return ObjectLight(estimate.others.get(other, self.ambient_sh), estimate.other_keys.get(other))

    def _with_reflections(
        self, light: ObjectLight, names: Sequence[str], time_s: float, other: str | None
    ) -> ObjectLight:
        """Filled once for each estimate, and carried from there."""
        lattice, name = self.controller.fine_lattice, names[0]
        if lattice is None or not self.controller.settings.has_reflections:
            return light
        request = self.under_way.in_use(name, time_s)
        estimated = mean_light([self._light_of(self.under_way.in_use(one, time_s), other) for one in names])
        cloud = UnitSphereCloud.empty(len(lattice))
        if request is not None and request.estimate.reflected is not None:
            cloud = request.estimate.reflected
        made_of = estimated.tobytes() + (b"" if request is None else str(request.frame).encode())
        kept = self._filled.get((name, other))
        if kept is None or kept[0] != made_of:
            kept = self._filled[name, other] = made_of, fill_reflections(cloud, lattice, estimated)
        gain, reflections = self.gain(name, time_s), kept[1]
        if (gain != 1).any():
            reflections = replace(reflections, radiance=reflections.radiance * gain.astype(np.float32))
        return replace(light, reflections=reflections)

    def gain(self, name: str, time_s: float) -> ArrayF64:
        """(3,) by what the last estimate that arrived at a position is multiplied; 1 without one, and where kept."""
        request = self.under_way.in_use(name, time_s)
        return self._carried[name][request.frame].gain if request is not None and self.is_carried else np.ones(3)

    def expected_error(self, name: str, time_s: float) -> float | None:
        """SHC RMSE that the estimator expects of the light in use; None for the ambient one, or if it says none."""
        request = self.under_way.in_use(name, time_s)
        if request is None or not self.is_carried:
            return None if request is None else request.estimate.expected_error
        return self._carried[name][request.frame].light.expected_error

    def light_frame(self, name: str, time_s: float) -> int | None:
        """The frame from which the light in use comes; None for the ambient one."""
        request = self.under_way.in_use(name, time_s)
        return None if request is None else request.frame
