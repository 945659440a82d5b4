"""Answers of a batch, in words: one sentence or two per question, with the numbers that they rest on.

A difference is called one only where its 95 % interval leaves 0 out. What a batch cannot say, it says how to find out.
"""

from __future__ import annotations

from collections.abc import Sequence

from xihe_blender.lab.batch.analysis import (
    AS_GOOD,
    MEASURES,
    Comparison,
    Measure,
    TriggerPoint,
    against_the_best,
    best_of,
    compared,
    laziest_as_good,
    names_of,
    ranked,
    shippable,
    trigger_points,
    values_of,
)
from xihe_blender.lab.batch.results import Trial
from xihe_blender.report.values import code, escape, mean
from xihenet.formats import MINUS, format_count, format_list, format_number, format_percent, format_signed
from xihenet.paired import CONFIDENCE, PairedDifference, held_at_most


def format_interval(difference: PairedDifference) -> str:
    """ "+0.021 (95 %: +0.010 to +0.030)"."""
    if difference.low is None:
        return f"{format_signed(difference.mean)} (one pair)"
    return (
        f"{format_signed(difference.mean)} (95 %: {format_signed(difference.low)} to {format_signed(difference.high)})"
    )


def what_it_stands_on(trials: Sequence[Trial]) -> str:
    """Scenes, seeds and phones, and what so few scenes can say."""
    scenes, seeds, phones = (names_of(trials, key) for key in ("scene", "seed", "phone"))
    counts = [format_count(len(scenes), "scene"), format_count(len(seeds), "seed"), format_count(len(phones), "phone")]
    words = f"{format_list(counts)}, {format_count(len(trials), 'trial')}."
    if len(scenes) == 1:
        return f"{words} One scene says nothing about others: intervals are over the trials in it."
    if (held := held_at_most(len(scenes))) < CONFIDENCE:
        return (
            f"{words} Intervals over {len(scenes)} scenes hold the truth in at most {format_percent(held)} of all "
            "cases, so no difference is called clear: give more scenes."
        )
    return f"{words} Intervals are over scenes: what another set of such scenes would give."


def which_estimator(trials: Sequence[Trial]) -> str:
    """Which estimator should I ship?"""
    measure, picture = MEASURES
    names = ranked(trials, measure, shippable(trials))
    if not names:
        return "No trial of an estimator that a phone could run has a light to be judged by."
    best, *others = names
    error = format_number(mean(values_of(trials, measure, estimator=best)))
    if not others:
        return f"Only {code(best)} was tried, with a mean coefficient error of {error}: give more of --estimators."
    rivals = [one for one in against_the_best(trials, measure) if one.first in others]
    clear = [one.first for one in rivals if one.difference.is_clear]
    words = f"Ship {code(best)}: its mean coefficient error, {error}, is the lowest"
    words += f", clearly below that of {format_list([code(name) for name in clear])}" if clear else ""
    open_ones = [one for one in rivals if not one.difference.is_clear]
    for one in open_ones:
        words += f"; against {code(one.first)} the difference, {format_interval(one.difference)}, may be chance"
    return f"{words}. {_in_the_picture(trials, picture, best)}"


def _in_the_picture(trials: Sequence[Trial], picture: Measure, best: str) -> str:
    first = best_of(trials, picture)
    if first is None:
        return "No picture was compared."
    if first == best:
        rivals = [one for one in against_the_best(trials, picture) if one.first in shippable(trials)]
        chance = [code(one.first) for one in rivals if not one.difference.is_clear]
        return (
            f"It has the best pictures too{f', by what may be chance against {format_list(chance)}' if chance else ''}."
        )
    one = compared(trials, picture, "estimator", first, best)
    assert one is not None
    sure = "and that is clear" if one.difference.is_clear else "which may be chance"
    return f"In the pictures {code(first)} is ahead by {format_interval(one.difference)} dB, {sure}."


def is_a_better_phone_worth_it(trials: Sequence[Trial]) -> str:
    """Is a better phone worth it?"""
    found = phone_differences(trials, MEASURES[0])
    if not found:
        return "One phone was tried. Give two or more, such as <code>--profiles perfect,ipad_pro_lidar</code>."
    best = best_of(trials, MEASURES[0])
    assert best is not None
    return f"With {code(best)}, {'; '.join(_better_phone(trials, best, one) for one in found)}."


def _better_phone(trials: Sequence[Trial], best: str, one: Comparison) -> str:
    """ "`perfect` has 0.013 less coefficient error than `cheap`, 8 % of it (95 %: ...), which may be chance"."""
    difference = one.difference
    better, worse = (one.first, one.second) if difference.mean < 0 else (one.second, one.first)
    own = mean(values_of(trials, MEASURES[0], estimator=best, phone=worse))
    share = "" if not own else f", {format_percent(abs(difference.mean) / own)} of it"
    interval = format_interval(difference)
    sure = "and that is clear" if difference.is_clear else "which may be chance"
    less = format_number(abs(difference.mean), 2)
    return (
        f"{code(better)} has {less} less coefficient error than {code(worse)}{share}, {sure}; "
        f"{escape(one.first)} {MINUS} {escape(one.second)}: {interval}"
    )


def phone_differences(trials: Sequence[Trial], measure: Measure) -> list[Comparison]:
    """Every phone against every earlier one, with the estimator that one would ship."""
    best = best_of(trials, MEASURES[0])
    phones = names_of(trials, "phone")
    own = [trial for trial in trials if trial.estimator == best]
    pairs = [(first, second) for index, first in enumerate(phones) for second in phones[:index]]
    found = [compared(own, measure, "phone", first, second) for first, second in pairs]
    return [one for one in found if one is not None]


def how_often(trials: Sequence[Trial]) -> str:
    """How often must it run?"""
    best = best_of(trials, MEASURES[0])
    points = trigger_points(trials, best) if best is not None else []
    if not points:
        return "No estimator that looks at the room was tried on a path that sees an object."
    always, own, least = points[0], next(point for point in points if point.factor == 1), laziest_as_good(points)
    words = (
        f"With {code(best)}, the trigger as it is asks {_rate(own)} per position in view, for an error of "
        f"{format_number(own.error)}; an estimate in every frame is {_rate(always)}, for "
        f"{format_number(always.error)}. "
    )
    limit = f"within {format_number(100 * AS_GOOD, 1)} % of that"
    if least.factor == 0:
        return words + f"No lazier trigger stays {limit}."
    if least.factor == own.factor:
        return words + f"It is the laziest that stays {limit}."
    times = f"{least.factor:g} times the thresholds (theta {least.theta:g})"
    sure = "" if least.more is None or least.more.is_clear else ", which cannot be told from chance"
    return words + (
        f"The laziest trigger that stays {limit} has {times}: {_rate(least)}, for {format_number(least.error)}{sure}."
    )


def _rate(point: TriggerPoint) -> str:
    return f"{format_number(point.per_minute, 2)} times a minute"
