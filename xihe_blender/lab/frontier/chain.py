"""What light does one way to compute make of a walk that is captured already, and how long does it take?

A session of its own for every measurement, over the same frames: the controller of a run, with the choice's estimator,
anchors and trigger. Only the steps are timed; what a session prepares once, its tables and its network, is not. All
choices are judged at the same places, frame and position, wherever a position is in view of the whole frame.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xihe_blender.lab.frontier.choices import ComputeChoice
from xihe_blender.lab.frontier.light_errors import padded
from xihe_blender.lab.frontier.timing import Clock
from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet import estimators
from xihenet.camera import unproject_frame
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice


@dataclass(frozen=True, eq=False)
class Walk:
    """A captured walk.

    Parameters
    ----------
    frames : captures, at least one
    active : for each frame the names of the positions in view
    positions : (3,) world, metres, by name
    truths : (25, 3) coefficients of the rendered light probe for each frame, by name
    exposure : of the session
    """

    frames: Sequence[RgbdFrame]
    active: Sequence[Sequence[str]]
    positions: Mapping[str, ArrayF64]
    truths: Sequence[Mapping[str, ArrayF64]]
    exposure: float

    @property
    def n_places(self) -> int:
        return sum(map(len, self.active))

    def start(self, n_frames: int) -> Walk:
        """The first frames of it, or all."""
        return replace(
            self,
            frames=self.frames[:n_frames],
            active=self.active[:n_frames],
            truths=self.truths[:n_frames],
        )

    def truth_by_place(self) -> list[ArrayF64]:
        return [truths[name] for truths, names in zip(self.truths, self.active, strict=True) for name in names]


@dataclass(frozen=True, eq=False)
class Walked:
    """The light in force at each place (25, 3), how many estimates it took, and milliseconds per frame."""

    lights: Sequence[ArrayF64]
    n_estimates: int
    frame_ms: float


class ChoiceBackend:
    """An `InferenceBackend` that estimates as a choice says; `made` are its lights, of any order, since last asked."""

    def __init__(self, choice: ComputeChoice) -> None:
        self.choice = choice
        self.estimator: Estimator = estimators.load(choice.estimator, choice.n_anchors)
        self.name, self.n_anchors = choice.estimator, choice.n_anchors
        self.made: list[ArrayF64] = []

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64:
        """(9, 3); higher bands are in `made` alone."""
        if self.choice.wire is not None:
            payload = encode_cloud(cloud, self.choice.wire)
            cloud = decode_cloud(payload, self.n_anchors, method=self.choice.wire)
        if self.choice.estimator == "projection":
            light = project_anchors(cloud, AnchorLattice(self.n_anchors), self.choice.order)
        else:
            light = self.estimator.estimate_with_error(cloud, context)[0]
        self.made.append(light)
        return light if len(light) == 9 else padded(light)[:9]


def walk_through(choice: ComputeChoice, backend: ChoiceBackend, walk: Walk, clock: Clock = time.thread_time) -> Walked:
    """Run a session over `walk`, with a `backend` made for `choice`."""
    trigger = replace(PREVIS_TRIGGER, theta=choice.theta, coverage_theta=_coverage_theta(choice))
    settings = ControllerSettings(
        trigger, nearest=choice.nearest, table_size=choice.cells, reference_exposure=walk.exposure
    )
    session = XiheController(backend, settings)
    for name, position in walk.positions.items():
        session.add_position(name, position)
    frames = [with_every_pixel(frame, choice.every_pixel) for frame in walk.frames]
    in_force = {name: padded(np.zeros((9, 3))) for name in walk.positions}
    lights: list[ArrayF64] = []
    n_estimates, elapsed_ms = 0, 0.0
    for frame, active in zip(frames, walk.active, strict=True):
        backend.made.clear()
        start = clock()
        reports = session.step(frame, active=active)
        elapsed_ms += 1e3 * (clock() - start)
        fired = [name for name in active if reports[name].estimate is not None]
        for name, light in zip(fired, backend.made, strict=True):
            in_force[name] = padded(light)
        n_estimates += len(fired)
        lights += [in_force[name] for name in active]
    return Walked(lights, n_estimates, elapsed_ms / len(frames))


def _coverage_theta(choice: ComputeChoice) -> float:
    """Threshold for newly seen anchors: none where an estimate is wanted in every frame."""
    return PREVIS_TRIGGER.coverage_theta if choice.theta > 0 else 0.0


def light_of_frame(
    choice: ComputeChoice, backend: ChoiceBackend, frame: RgbdFrame, position_m: ArrayF64, exposure: float
) -> ArrayF64:
    """(25, 3) from one frame alone, whatever the trigger thinks of it."""
    seen = with_every_pixel(frame, choice.every_pixel)
    points = unproject_frame(seen, reference_exposure=exposure)
    lattice = AnchorLattice(choice.n_anchors)
    cloud = sample_unit_sphere(points, position_m, lattice, method=choice.nearest, table_size=choice.cells)
    context = EstimateContext(seen, points, position_m, None, exposure)
    backend.made.clear()
    backend.estimate(cloud, context)
    return padded(backend.made[0])


def with_every_pixel(frame: RgbdFrame, step: int) -> RgbdFrame:
    """Every `step`-th pixel of every `step`-th row of `frame`, where they were: a smaller frame of the same view."""
    if step == 1:
        return frame
    seen = frame.intrinsics
    width, height = -(-seen.width // step), -(-seen.height // step)
    # The centre of pixel 0 stays where it is, half a pixel from the edge of either frame.
    cx, cy = ((centre - 0.5) / step + 0.5 for centre in (seen.cx, seen.cy))
    smaller = Intrinsics(width, height, seen.fx / step, seen.fy / step, cx, cy)
    colour, plane_depth_m = frame.srgb_u8[::step, ::step], frame.plane_depth_m[::step, ::step]
    return replace(frame, srgb_u8=colour, plane_depth_m=plane_depth_m, intrinsics=smaller)
