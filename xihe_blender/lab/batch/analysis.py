"""Analysis of the trials of a batch: pairs, distributions and worst cases, as numbers; words are elsewhere.

Trials are compared only with trials of the same scene, seed and, where estimators are compared, phone. An estimator or
a phone is judged on the pairs that have both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from xihe_blender.lab.batch.results import Trial, TrialFrame
from xihenet.paired import PairedDifference, paired_difference

NOT_FOR_SHIPPING = ("truth",)
"""What no phone could compute: it stands in the tables as a bound."""

AS_GOOD = 0.05
"""An error larger by this share is as good, when it is asked how often the chain must run."""

Row = TypeVar("Row")


@dataclass(frozen=True)
class Measure:
    """A column of trials and frames that estimators are judged by."""

    key: str
    title: str
    is_better_low: bool
    unit: str = ""

    def of(self, one: Trial | TrialFrame) -> float | None:
        value: float | None = getattr(one, self.key)
        return value


MEASURES = (
    Measure("shc_rmse", "Coefficient error (SHC RMSE)", True),
    Measure("psnr", "Picture, psnr on the objects", False, "dB"),
)


@dataclass(frozen=True)
class Comparison:
    """`first` against `second` in one measure."""

    first: str
    second: str
    difference: PairedDifference


def values_of(trials: Sequence[Trial], measure: Measure, **which: str) -> list[float]:
    """The measure of every trial with these values, where it is known."""
    return [value for trial in chosen(trials, **which) if (value := measure.of(trial)) is not None]


def chosen(rows: Sequence[Row], **which: str) -> list[Row]:
    """Those with these values."""
    return [row for row in rows if all(getattr(row, key) == value for key, value in which.items())]


def ranked(trials: Sequence[Trial], measure: Measure, names: Sequence[str]) -> list[str]:
    """`names` of estimators by the mean of `measure`, the best first; those without a value are left out."""
    means = {name: np.mean(values) for name in names if (values := values_of(trials, measure, estimator=name))}
    return sorted(means, key=lambda name: means[name] if measure.is_better_low else -means[name])


def best_of(trials: Sequence[Trial], measure: Measure) -> str | None:
    """The best estimator that could be shipped; None where no trial of one has a value."""
    return next(iter(ranked(trials, measure, shippable(trials))), None)


def shippable(trials: Sequence[Trial]) -> list[str]:
    """Estimators that a phone could run, in the order of the batch."""
    return [name for name in names_of(trials, "estimator") if name not in NOT_FOR_SHIPPING]


def names_of(rows: Sequence[object], key: str) -> list[str]:
    """The values of a column, each once, in order."""
    return list(dict.fromkeys(getattr(row, key) for row in rows))


def compared(trials: Sequence[Trial], measure: Measure, key: str, first: str, second: str) -> Comparison | None:
    """`first` against `second`, two values of the column `key`, over all else that is the same; None without a pair."""
    same = [name for name in ("unit", "phone", "estimator") if name != key]
    of_first, of_second = (
        {tuple(getattr(trial, name) for name in same): trial for trial in chosen(trials, **{key: side})}
        for side in (first, second)
    )
    pairs = [
        (a, b, trial.scene)
        for which, trial in of_first.items()
        if which in of_second
        and (a := measure.of(trial)) is not None
        and (b := measure.of(of_second[which])) is not None
    ]
    if not pairs:
        return None
    a_values, b_values, scenes = zip(*pairs, strict=True)
    return Comparison(first, second, paired_difference(a_values, b_values, scenes, np.random.default_rng(0)))


def against_the_best(trials: Sequence[Trial], measure: Measure) -> list[Comparison]:
    """Every other estimator against the best that could be shipped."""
    best = best_of(trials, measure)
    if best is None:
        return []
    others = ranked(trials, measure, [name for name in names_of(trials, "estimator") if name != best])
    found = [compared(trials, measure, "estimator", name, best) for name in others]
    return [one for one in found if one is not None]


@dataclass(frozen=True)
class TriggerPoint:
    """What a trigger scaled by `factor` does on average over trials.

    Parameters
    ----------
    per_minute : estimates for a position in view
    error : mean SHC RMSE
    more : error than with an estimate in every frame; None for that itself
    """

    factor: float
    theta: float
    per_minute: float
    error: float
    more: PairedDifference | None


def trigger_points(trials: Sequence[Trial], estimator: str) -> list[TriggerPoint]:
    """By rising threshold; empty for an estimator that no trigger matters to."""
    known = [trial for trial in chosen(trials, estimator=estimator) if trial.thetas]
    known = [trial for trial in known if all(one.per_minute is not None for one in trial.thetas)]
    eager = [trial.thetas[0].shc_rmse for trial in known]
    scenes = [trial.scene for trial in known]
    points = []
    for index, same in enumerate(zip(*(trial.thetas for trial in known), strict=True)):
        errors = [one.shc_rmse for one in same]
        per_minute = float(np.mean([one.per_minute for one in same]))
        more = paired_difference(errors, eager, scenes, np.random.default_rng(0)) if index else None
        points.append(TriggerPoint(same[0].factor, same[0].theta, per_minute, float(np.mean(errors)), more))
    return points


def laziest_as_good(points: Sequence[TriggerPoint]) -> TriggerPoint:
    """The trigger with the fewest estimates whose mean error is within AS_GOOD of that of every frame."""
    as_good = [point for point in points if point.error <= (1 + AS_GOOD) * points[0].error]
    return min(as_good, key=lambda point: point.per_minute)


@dataclass(frozen=True)
class WorstCase:
    """The worst compared frame of one trial."""

    trial: Trial
    frame: int
    psnr: float
    rmse: float | None


def worst_cases(trials: Sequence[Trial], n: int) -> list[WorstCase]:
    """The `n` worst frames of estimators that could be shipped, one per scene and estimator, the worst first."""
    worst: dict[tuple[str, str], WorstCase] = {}
    for trial in trials:
        known = [(frame.psnr, frame.frame, frame.rmse) for frame in trial.frames if frame.psnr is not None]
        if not known or trial.estimator in NOT_FOR_SHIPPING:
            continue
        psnr, number, rmse = min(known, key=lambda one: one[:2])
        case = WorstCase(trial, number, psnr, rmse)
        which = trial.scene, trial.estimator
        if which not in worst or case.psnr < worst[which].psnr:
            worst[which] = case
    return sorted(worst.values(), key=lambda case: case.psnr)[:n]


def frame_values(trials: Sequence[Trial], measure: Measure, estimator: str) -> list[float]:
    """The measure of every frame of an estimator's trials."""
    frames = [frame for trial in chosen(trials, estimator=estimator) for frame in trial.frames]
    return [value for frame in frames if (value := measure.of(frame)) is not None]
