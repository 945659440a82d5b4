"""An error budget over several seeds: which of its parts would come out the same if all were rendered again?

With another seed the pictures have other grain, the phone's sensor and the network draw other numbers, and the trigger
may fire in another frame. Each part is measured so with each seed, and what is said of it is the mean, and the interval
in which the mean over all seeds lies in 95 of 100 cases: Student's t, since three seeds tell their own spread badly.

Rejected: intervals from the moments of one session, whose errors all come from the same captures and go up and down
together; and from what noise each picture has, which cannot know what a trigger makes of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, stdev

from xihe_blender.io.budget_results import PARTS, BudgetPart, ObjectBudget
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.previs.prepare import PreparedRun
from xihenet.paired import t_975

N_SEEDS = 3


@dataclass(frozen=True)
class SeedErrors:
    """Of one object, measured with one seed: root mean squares over its positions and moments."""

    brightness: float
    error: float
    least_squares: float | None
    with_perfect: Mapping[str, float]
    """What is left of the error by part; a part that is not simulated is not in it."""


def with_seed(run: PreparedRun, number: int) -> PreparedRun:
    """`run` with the `number`-th seed from its own on, exposure and samples as they are; the first is the run itself.

    What it renders lies in a folder of its own.
    """
    if number == 0:
        return run
    settings = replace(run.settings, seed=run.settings.seed + number)
    outputs = RunOutputs(run.outputs.folder / "work" / f"seed_{number}", run.outputs.scene)
    return replace(run, settings=settings, outputs=outputs, phone=replace(run.phone, settings=settings))


def over_seeds(name: str, moments: tuple[int, ...], seeds: Sequence[SeedErrors]) -> ObjectBudget:
    """The budget of object `name` from its errors with each seed; of one that was never in view there are none."""
    if not seeds:
        return ObjectBudget(name=name, moments=())
    least_squares = [one.least_squares for one in seeds if one.least_squares is not None]
    return ObjectBudget(
        name=name,
        moments=moments,
        brightness=fmean(one.brightness for one in seeds),
        error=fmean(one.error for one in seeds),
        least_squares_error=fmean(least_squares) if least_squares else None,
        parts=tuple(_part(part, seeds) for part in PARTS),
    )


def _part(name: str, seeds: Sequence[SeedErrors]) -> BudgetPart:
    error = fmean(one.error for one in seeds)
    if name not in seeds[0].with_perfect:
        return BudgetPart(name=name, state="not simulated", error=error, gain=0.0)
    left = fmean(one.with_perfect[name] for one in seeds)
    interval = interval_of_mean([one.error - one.with_perfect[name] for one in seeds])
    return BudgetPart(name=name, state="measured", error=left, gain=error - left, interval=interval)


def interval_of_mean(values: Sequence[float]) -> tuple[float, float] | None:
    """The 95 % confidence interval of the mean of independent `values`, by Student's t; None for a single one."""
    if len(values) < 2:
        return None
    middle, half = fmean(values), t_975(len(values) - 1) * stdev(values) / math.sqrt(len(values))
    return middle - half, middle + half
