"""Ways to compute: what light each makes of a walk that is captured already, and what it costs in error and time.

A session of its own for every measurement, over the same frames: the controller of a run, with the choice's estimator,
anchors and trigger. Only the steps are timed; what a session prepares once, its tables and its network, is not. All
choices are judged at the same places, frame and position, wherever a position is in view of the whole frame.

Two kinds of error, of coefficients and of the irradiance they bring to surfaces, relative to the light that is held
against, so that scenes can be compared: 0.1 is a tenth of the light. Against the exhaustive setting: what a shortcut
adds, for ways that have the default estimator in common. Against the rendered light probe ("_truth"): what is left of
the truth, the only ground on which estimators can be compared. Lights of different order are compared as if the bands
that one lacks were 0.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from xihe_blender.jobs import Job, Progress, part_of
from xihe_blender.lab.frontier.choices import EXHAUSTIVE
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice
from xihe_blender.lab.frontier.timing import Clock, interleaved
from xihe_blender.previs.sample_count import SMALLEST_LIGHT
from xihe_blender.previs.settings import PREVIS_TRIGGER
from xihenet import estimators
from xihenet.camera import unproject_frame
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext, Estimator
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import irradiance, project_anchors
from xihenet.sphere import AnchorLattice

ORDER = 4
N_COEFFICIENTS = (ORDER + 1) ** 2
N_NORMALS = 256
KINDS = ("coefficients", "irradiance")
AGAINST_TRUTH = "_truth"
N_BRUTE_FRAMES = 2
Light = tuple[tuple[float, float, float], ...]
"""(25, 3) coefficients, as a record holds them."""

_SMALLEST_IRRADIANCE = SMALLEST_LIGHT * float(np.sqrt(np.pi * N_NORMALS / 4))
"""Of the same grey light: pi times its radiance on every normal."""


@dataclass(frozen=True, eq=False)
class Walk:
    """A captured walk."""

    frames: Sequence[RgbdFrame]  # captures, at least one
    active: Sequence[Sequence[str]]  # for each frame the names of the positions in view
    positions: Mapping[str, ArrayF64]  # (3,) world, metres, by name, where they have not `moved`
    truths: Sequence[Mapping[str, ArrayF64]]  # (25, 3) coefficients of the rendered light probe for each frame, by name
    exposure: float  # of the session
    moved: Mapping[int, Mapping[str, Sequence[float]]] = field(default_factory=dict)  # where positions are, by frame

    def at(self, name: str, frame: int) -> ArrayF64:
        """(3,) world, metres: where a position is in a frame."""
        return np.asarray(self.moved.get(frame, {}).get(name, self.positions[name]), np.float64)

    @property
    def n_places(self) -> int:
        return sum(map(len, self.active))


@dataclass(frozen=True, eq=False)
class Walked:
    """The light in use at each place (25, 3), how many estimates it took, and milliseconds per frame."""

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


def walk_through(backend: ChoiceBackend, walk: Walk, clock: Clock = time.thread_time) -> Walked:
    """Run a session over `walk`, with the choice that `backend` was made for."""
    choice = backend.choice
    # Where an estimate is wanted in every frame, no newly seen anchor is too few.
    coverage_theta = PREVIS_TRIGGER.coverage_theta if choice.theta > 0 else 0.0
    trigger = replace(PREVIS_TRIGGER, theta=choice.theta, coverage_theta=coverage_theta)
    settings = ControllerSettings(
        trigger, nearest=choice.nearest, table_size=choice.cells, reference_exposure=walk.exposure
    )
    session = XiheController(backend, settings)
    for name, position in walk.positions.items():
        session.add_position(name, position)
    frames = [with_every_pixel(frame, choice.every_pixel) for frame in walk.frames]
    in_use = {name: padded(np.zeros((9, 3))) for name in walk.positions}
    lights: list[ArrayF64] = []
    n_estimates, elapsed_ms = 0, 0.0
    for frame, active in zip(frames, walk.active, strict=True):
        backend.made.clear()
        for name in walk.positions:
            session.move_position(name, walk.at(name, frame.frame))
        start = clock()
        reports = session.step(frame, active=active)
        elapsed_ms += 1e3 * (clock() - start)
        fired = [name for name in active if reports[name].estimate is not None]
        for name, light in zip(fired, backend.made, strict=True):
            in_use[name] = padded(light)
        n_estimates += len(fired)
        lights += [in_use[name] for name in active]
    return Walked(lights, n_estimates, elapsed_ms / len(frames))


def light_of_frame(backend: ChoiceBackend, frame: RgbdFrame, position_m: ArrayF64) -> ArrayF64:
    """(25, 3) from one frame alone, whatever the trigger thinks of it."""
    choice = backend.choice
    seen = with_every_pixel(frame, choice.every_pixel)
    points = unproject_frame(seen)
    lattice = AnchorLattice(choice.n_anchors)
    cloud = sample_unit_sphere(points, position_m, lattice, method=choice.nearest, table_size=choice.cells)
    context = EstimateContext(seen, points, position_m, None, frame.exposure)
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


def measure_compute(
    backends: dict[ComputeChoice, ChoiceBackend], walk: Walk, n_rounds: int, rng: np.random.Generator
) -> Job[list[Measured]]:
    """Errors and times of each way to compute; the exhaustive one must be among them."""
    walked: dict[ComputeChoice, Walked] = {}
    # The walk's start is enough for brute force, which takes 40 times as long and nearly the same in every frame.
    n = N_BRUTE_FRAMES
    start = replace(walk, frames=walk.frames[:n], active=walk.active[:n], truths=walk.truths[:n])

    def frame_ms(choice: ComputeChoice) -> float:
        return walk_through(backends[choice], start if choice.nearest == "brute" else walk).frame_ms

    rounds = interleaved([functools.partial(frame_ms, choice) for choice in backends], n_rounds, rng)
    for number, (choice, backend) in enumerate(backends.items()):
        yield Progress(0.2 * number / len(backends), 1, f"computing: {choice.label}")
        walked[choice] = walk_through(backend, walk)
    times_ms = yield from part_of(1, 0.2, 0.8, rounds)
    truth = [truths[name] for truths, names in zip(walk.truths, walk.active, strict=True) for name in names]
    measured = []
    for (choice, own), of_choice in zip(walked.items(), times_ms, strict=True):
        settings = ChoiceSettings(computing=choice, estimates=own.n_estimates, steps=walk.n_places)
        against_truth = {kind + AGAINST_TRUTH: each for kind, each in square_errors(own.lights, truth).items()}
        comparable = choice.estimator == EXHAUSTIVE.estimator
        errors = square_errors(own.lights, walked[EXHAUSTIVE].lights) if comparable else {}
        measured.append(Measured(choice.label, settings, errors | against_truth, tuple(of_choice)))
    return measured


# -------------------------------------------------------------------------------------------------- errors


def padded(sh_radiance: ArrayF64) -> ArrayF64:
    """(25, 3): coefficients of any order up to 4 with zeros behind."""
    light = np.zeros((N_COEFFICIENTS, 3))
    light[: len(sh_radiance)] = sh_radiance
    return light


def square_errors(lights: Sequence[ArrayF64], references: Sequence[ArrayF64]) -> dict[str, tuple[float, ...]]:
    """By kind of error, the squared relative error at each place, of lights (25, 3) or less.

    A dark reference counts as grey light at the key.
    """
    pairs = [(padded(light), padded(reference)) for light, reference in zip(lights, references, strict=True)]
    normals = AnchorLattice(N_NORMALS).directions
    lit = [(irradiance(light, normals), irradiance(reference, normals)) for light, reference in pairs]
    return {
        "coefficients": tuple(_square(*pair, SMALLEST_LIGHT) for pair in pairs),
        "irradiance": tuple(_square(*pair, _SMALLEST_IRRADIANCE) for pair in lit),
    }


def _square(light: ArrayF64, reference: ArrayF64, smallest: float) -> float:
    norm = max(float(np.sqrt((reference**2).sum())), smallest)
    return float(((light - reference) ** 2).sum()) / norm**2
