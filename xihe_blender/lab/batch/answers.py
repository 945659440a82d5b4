"""Answers of a batch: pairs, distributions and worst cases as numbers, then a sentence or two per question.

Trials are compared only with trials of the same scene, seed and, where estimators are compared, phone. An estimator or
a phone is judged on the pairs that have both. A difference is called one only where its 95 % interval leaves 0 out.
What a batch cannot say, it says how to find out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from xihe_blender.lab.batch.results import Trial, TrialFrame
from xihe_blender.report.values import FEW_PIXELS, code, escape, mean, too_small_to_judge
from xihenet.formats import MINUS, format_count, format_list, format_number, format_percent, format_signed
from xihenet.paired import CONFIDENCE, PairedDifference, held_at_most, paired_difference

NOT_FOR_SHIPPING = ("truth",)
"""What no phone could compute: it stands in the tables as a bound."""

AS_GOOD = 0.05
"""An error larger by this share is as good, when it is asked how often the chain must run."""

Row = TypeVar("Row")
WorstCase = tuple[Trial, TrialFrame]
"""A trial, and one of its compared frames."""


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
    Measure("shc_rmse", "Light error (SHC RMSE)", True),
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


def chosen(rows: Sequence[Row], **which: str | bool) -> list[Row]:
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
    """What a trigger scaled by `factor` does on average over trials: estimates, SHC RMSE.

    `more` is the error that it has more than one that estimates in every frame; None for that itself.
    """

    factor: float
    thetas: tuple[float, float]  # the least and the greatest: each scene's is above the noise of its captures
    per_minute: float
    error: float
    more: PairedDifference | None

    @property
    def theta(self) -> str:
        """In words: "0.02", or "0.02 to 0.031"."""
        return " to ".join(dict.fromkeys(map(format_number, self.thetas)))


def trigger_points(trials: Sequence[Trial], estimator: str) -> list[TriggerPoint]:
    """By rising threshold; empty for an estimator that no trigger matters to."""
    own = [trial for trial in chosen(trials, estimator=estimator) if trial.trigger_sweep]
    known = [trial for trial in own if all(one.per_minute is not None for one in trial.trigger_sweep)]
    eager = [trial.trigger_sweep[0].shc_rmse for trial in known]
    scenes = [trial.scene for trial in known]
    points = []
    for index, same in enumerate(zip(*(trial.trigger_sweep for trial in known), strict=True)):
        errors = [one.shc_rmse for one in same]
        per_minute = float(np.mean([one.per_minute for one in same]))
        more = paired_difference(errors, eager, scenes, np.random.default_rng(0)) if index else None
        thetas = [one.theta for one in same]
        between = (min(thetas), max(thetas))
        points.append(TriggerPoint(same[0].factor, between, per_minute, float(np.mean(errors)), more))
    return points


def laziest_as_good(points: Sequence[TriggerPoint]) -> TriggerPoint:
    """The trigger with the fewest estimates whose mean error is within AS_GOOD of that of every frame.

    Among equals it is the trigger in use: another would save nothing.
    """
    as_good = [point for point in points if point.error <= (1 + AS_GOOD) * points[0].error]
    return min(as_good, key=lambda point: (point.per_minute, point.factor != 1))


def worst_cases(trials: Sequence[Trial], n: int) -> list[WorstCase]:
    """The `n` worst frames of estimators that could be shipped, one per scene and estimator, the worst first."""
    could_be_shipped = [trial for trial in trials if trial.estimator not in NOT_FOR_SHIPPING]
    known = [(one.psnr, trial, one) for trial in could_be_shipped for one in trial.frames if one.psnr is not None]
    worst: dict[tuple[str, str], WorstCase] = {}
    for _, trial, one in sorted(known, key=lambda case: case[0]):
        worst.setdefault((trial.scene, trial.estimator), (trial, one))
    return list(worst.values())[:n]


# ---------------------------------------------------------------------------------------------- in words


def format_interval(difference: PairedDifference) -> str:
    """ "+0.021 (95 %: +0.010 to +0.030)"."""
    low, middle, high = map(format_signed, (difference.low, difference.mean, difference.high))
    return f"{middle} (one pair)" if difference.low is None else f"{middle} (95 %: {low} to {high})"


def what_it_stands_on(trials: Sequence[Trial]) -> str:
    """Scenes, seeds and phones, and what so few scenes can say."""
    scenes, seeds, phones = (names_of(trials, key) for key in ("scene", "seed", "phone"))
    counts = [format_count(len(scenes), "scene"), format_count(len(seeds), "seed"), format_count(len(phones), "phone")]
    words = f"{format_list(counts)}, {format_count(len(trials), 'trial')}."
    if small := dict.fromkeys(one.scene for one in trials if too_small_to_judge(one.object_pixels) is not None):
        words += f" In {format_list([escape(scene) for scene in small])} virtual objects cover fewer than {FEW_PIXELS}"
        words += " pixels of a picture, too few to judge pictures by."
    if len(scenes) == 1:
        words += " One scene says nothing about others: intervals are over the trials in it."
        n_pairs = len(seeds) * len(phones)
        if held_at_most(n_pairs) < CONFIDENCE:
            words += f" With {format_count(n_pairs, 'trial')} of each estimator no difference is called clear: give"
            words += " more of --seeds."
        return words
    if (held := held_at_most(len(scenes))) < CONFIDENCE:
        return (
            f"{words} Intervals over {len(scenes)} scenes hold the truth in at most {format_percent(held)} of all "
            "cases, so no difference is called clear: give more scenes."
        )
    return f"{words} Intervals are over scenes: what another set of such scenes would give."


def which_estimator(trials: Sequence[Trial]) -> str:
    measure, picture = MEASURES
    names = ranked(trials, measure, shippable(trials))
    if not names:
        return "No trial of an estimator that a phone could run has a light to be judged by."
    best, *others = names
    error = format_number(mean(values_of(trials, measure, estimator=best)))
    if not others:
        return f"Only {code(best)} was tried, with a mean light error of {error}: give more of --estimators."
    rivals = [one for one in against_the_best(trials, measure) if one.first in others]
    clear = [one.first for one in rivals if one.difference.is_clear]
    words = f"Ship {code(best)}: its mean light error, {error}, is the lowest"
    words += f", clearly below that of {format_list([code(name) for name in clear])}" if clear else ""
    for one in rivals:
        if not one.difference.is_clear:
            words += f"; against {code(one.first)} the difference, {format_interval(one.difference)}, may be chance"
    return f"{words}. {_in_the_picture(trials, picture, best)}"


def _in_the_picture(trials: Sequence[Trial], picture: Measure, best: str) -> str:
    first = best_of(trials, picture)
    if first is None:
        return "No picture was compared."
    if first == best:
        rivals = [one for one in against_the_best(trials, picture) if one.first in shippable(trials)]
        chance = [code(one.first) for one in rivals if not one.difference.is_clear]
        how_sure = f", by what may be chance against {format_list(chance)}" if chance else ""
        return f"It has the best pictures too{how_sure}."
    one = compared(trials, picture, "estimator", first, best)
    if one is None:
        return f"Its pictures have no psnr, those of {code(first)} do: they are as the ground truth, or show no object."
    ahead = f"{code(first)} is ahead by {format_interval(one.difference)} dB"
    return f"In the pictures {ahead}, {_how_sure(one.difference)}."


def _how_sure(difference: PairedDifference) -> str:
    return "and that is clear" if difference.is_clear else "which may be chance"


def is_a_better_phone_worth_it(trials: Sequence[Trial]) -> str:
    found = phone_differences(trials)
    if not found:
        return "One phone was tried. Give two or more, such as <code>--profiles perfect,ipad_pro_lidar</code>."
    best = best_of(trials, MEASURES[0])
    assert best is not None
    return f"With {code(best)}, {'; '.join(_better_phone(trials, best, one) for one in found)}."


def _better_phone(trials: Sequence[Trial], best: str, one: Comparison) -> str:
    """ "`perfect` has 0.013 less light error than `cheap`, 8 % of it (95 %: ...), which may be chance"."""
    difference = one.difference
    better, worse = (one.first, one.second) if difference.mean < 0 else (one.second, one.first)
    own = mean(values_of(trials, MEASURES[0], estimator=best, phone=worse))
    share = "" if not own else f", {format_percent(abs(difference.mean) / own)} of it"
    less = format_number(abs(difference.mean), 2)
    return (
        f"{code(better)} has {less} less light error than {code(worse)}{share}, {_how_sure(difference)}; "
        f"{escape(one.first)} {MINUS} {escape(one.second)}: {format_interval(difference)}"
    )


def phone_differences(trials: Sequence[Trial]) -> list[Comparison]:
    """Light error of every phone against every earlier one, with the estimator that one would ship."""
    best = best_of(trials, MEASURES[0])
    phones = names_of(trials, "phone")
    own = [trial for trial in trials if trial.estimator == best]
    pairs = [(first, second) for index, first in enumerate(phones) for second in phones[:index]]
    found = [compared(own, MEASURES[0], "phone", first, second) for first, second in pairs]
    return [one for one in found if one is not None]


def how_often(trials: Sequence[Trial]) -> str:
    """Of the best estimator that the trigger matters to: it may not be the one to ship."""
    best = best_of([trial for trial in trials if trial.trigger_sweep], MEASURES[0])
    points = trigger_points(trials, best) if best is not None else []
    if not points:
        return "No estimator that looks at the room was tried on a path that sees an object."
    own = next(point for point in points if point.factor == 1)
    own_error = format_number(own.error)
    if len(points) == 1:  # A rule without a threshold to scale.
        return (
            f"With {code(best)}, an estimate in every frame is {_rate(own)} per position in view, for an error of "
            f"{own_error}. Leave out --trigger to see what fewer would cost."
        )
    always, least = points[0], laziest_as_good(points)
    least_error = format_number(least.error)
    words = (
        f"With {code(best)}, the trigger as it is asks {_rate(own)} per position in view, for an error of {own_error}; "
        f"an estimate in every frame is {_rate(always)}, for {format_number(always.error)}. "
    )
    limit = f"within {format_number(100 * AS_GOOD, 1)} % of that"
    if least.factor == 0:
        return words + f"No lazier trigger stays {limit}."
    if least.factor == own.factor:
        return words + f"It is the laziest that stays {limit}."
    times = f"{least.factor:g} times the thresholds (theta {least.theta})"
    sure = "" if least.more is None or least.more.is_clear else ", which cannot be told from chance"
    return words + f"The laziest trigger that stays {limit} has {times}: {_rate(least)}, for {least_error}{sure}."


def _rate(point: TriggerPoint) -> str:
    return f"{format_number(point.per_minute, 2)} times a minute"
