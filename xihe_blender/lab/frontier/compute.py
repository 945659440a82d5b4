"""What does each way to compute cost in error and time, on one captured walk?

Two kinds of error in coefficients and in irradiance each. Against the exhaustive setting: what a shortcut adds, for
ways that have the default estimator in common. Against the rendered light probe ("_truth"): what is left of the truth,
the only ground on which estimators can be compared.
"""

from __future__ import annotations

import numpy as np

from xihe_blender.lab.frontier.chain import ChoiceBackend, Walk, walk_through
from xihe_blender.lab.frontier.choices import EXHAUSTIVE, ComputeChoice
from xihe_blender.lab.frontier.light_errors import square_errors
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.steps import Steps, told_as, within
from xihe_blender.lab.frontier.timing import interleaved, torch_on_one_thread
from xihenet.records import ArrayF64

AGAINST_TRUTH = "_truth"
N_BRUTE_FRAMES = 2


def loaded(choices: list[ComputeChoice]) -> tuple[dict[ComputeChoice, ChoiceBackend], list[str]]:
    """A backend for each choice whose estimator can be loaded; names of the estimators that cannot."""
    backends, missing = {}, []
    for choice in choices:
        try:
            backends[choice] = ChoiceBackend(choice)
        except (ImportError, ValueError):
            missing.append(choice.estimator)
    return backends, sorted(set(missing))


def measure_compute(
    backends: dict[ComputeChoice, ChoiceBackend], walk: Walk, n_rounds: int, rng: np.random.Generator
) -> Steps[list[Measured]]:
    """Errors and times of each way to compute; the exhaustive one must be among them."""
    lights: dict[ComputeChoice, list[ArrayF64]] = {}
    estimates: dict[ComputeChoice, int] = {}
    candidates = [
        lambda choice=choice, backend=backend: walk_through(choice, backend, _timed_part(choice, walk)).frame_ms
        for choice, backend in backends.items()
    ]
    rounds = told_as(
        interleaved(candidates, n_rounds, rng),
        lambda done: ((done + 1) / (n_rounds + 1), f"timing {len(candidates)} ways to compute, round {done}"),
    )
    with torch_on_one_thread():
        for number, (choice, backend) in enumerate(backends.items()):
            yield 0.2 * number / len(backends), f"computing: {choice.label}"
            walked = walk_through(choice, backend, walk)
            lights[choice], estimates[choice] = list(walked.lights), walked.n_estimates
        times = dict(zip(backends, (yield from within(0.2, 0.8, rounds)), strict=True))
    truth = walk.truth_by_place()
    return [
        Measured(
            choice.label,
            choice.as_json() | {"estimates": estimates[choice], "steps": walk.n_places},
            _errors(choice, lights, truth),
            times[choice],
        )
        for choice in backends
    ]


def _timed_part(choice: ComputeChoice, walk: Walk) -> Walk:
    """The walk, or its start for brute force, which takes 40 times as long and nearly the same in every frame."""
    return walk.start(N_BRUTE_FRAMES) if choice.nearest == "brute" else walk


def _errors(
    choice: ComputeChoice, lights: dict[ComputeChoice, list[ArrayF64]], truth: list[ArrayF64]
) -> dict[str, list[float]]:
    against_truth = {kind + AGAINST_TRUTH: e for kind, e in square_errors(lights[choice], truth).items()}
    if choice.estimator != EXHAUSTIVE.estimator:
        return against_truth
    return square_errors(lights[choice], lights[EXHAUSTIVE]) | against_truth
