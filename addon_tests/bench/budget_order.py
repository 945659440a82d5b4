"""The order of an error budget's parts: are the largest in the same order when everything is rendered anew?

Strictly: the three parts that take off most are in the same order anew, however little they differ and whether or not
the budget says that they may as well harm.

With intervals: of the three that take off most among those that surely do something, every pair whose 95 % intervals
are apart is in the same order anew. A pair that the budget does not tell apart counts neither way; by how much it
differs anew is printed, and so is how many pairs there were. Wide intervals make this figure easy to reach, so it
stands beside the strict one and not in its place.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from xihe_blender.io.budget_results import BudgetPart, ObjectBudget


@dataclass(frozen=True)
class Order:
    """How the order of an object's largest parts, in the budget, is found `anew`.

    `strict` says whether the three that take off most are in the same order. Of the pairs among the three that take off
    most and surely do something, `apart` says of those whose intervals are apart whether they are in the same order,
    and `untold` by how much the others differ, in per cent of the brightness.
    """

    strict: bool
    apart: dict[tuple[str, str], bool]
    untold: dict[tuple[str, str], float]


def largest(item: ObjectBudget) -> list[BudgetPart]:
    """The three parts that take off most, sure or not."""
    measured = [part for part in item.parts if part.state == "measured"]
    return sorted(measured, key=lambda part: -part.gain)[:3]


def largest_that_are_certain(item: ObjectBudget) -> list[BudgetPart]:
    return [part for part in item.largest_first if part.is_certain][:3]


def order_of(item: ObjectBudget, anew: ObjectBudget) -> Order:
    """KeyError if one of these parts was not measured anew."""
    gains = {part.name: 100 * anew.relative(part.gain) for part in anew.parts if part.state == "measured"}
    in_order = [gains[part.name] for part in largest(item)]
    apart, untold = {}, {}
    for more, less in itertools.combinations(largest_that_are_certain(item), 2):
        names, difference = (more.name, less.name), gains[more.name] - gains[less.name]
        if more.is_apart_from(less):
            apart[names] = difference > 0
        else:
            untold[names] = difference
    return Order(all(more > less for more, less in itertools.pairwise(in_order)), apart, untold)


def print_case(scene: str, item: ObjectBudget, anew: ObjectBudget, order: Order) -> None:
    """What was measured of an object, and what the order of its parts is held to be."""
    now, then = (100 * one.relative(one.error or 0.0) for one in (item, anew))
    print(f"{scene}, {item.name}: error {now:.1f} %, rendered anew {then:.1f} %")
    found = {part.name: part for part in anew.parts if part.state == "measured"}
    for part in (part for part in item.largest_first if part.name in found):
        doubt = "" if part.is_certain else "  not certain"
        print(f"    {part.name:14} {format_part(item, part)}   anew {format_part(anew, found[part.name])}{doubt}")
    print(f"    strictly: the three largest are {'' if order.strict else 'not '}in the same order")
    print(f"    with intervals: {sum(order.apart.values())} of {len(order.apart)} pairs apart are in the same order")
    for (more, less), difference in order.untold.items():
        print(f"        {more} and {less}, not told apart: anew {difference:+.1f}")
    print(end="", flush=True)


def format_part(item: ObjectBudget, part: BudgetPart) -> str:
    gain, low, high = (100 * item.relative(value) for value in (part.gain, part.low, part.high))
    return f"{gain:6.1f}" + (f" ({low:.1f} to {high:.1f})" if part.interval else "")


def print_all(orders: Sequence[Order]) -> None:
    """Both figures over all scenes."""
    apart = [order.apart for order in orders]
    n_right = sum(all(pairs.values()) for pairs in apart)
    print(
        f"strictly: the three largest are in the same order in {sum(o.strict for o in orders)} of {len(orders)} scenes"
    )
    print(
        f"with intervals: every pair apart is in the same order in {n_right} of {len(orders)} scenes, "
        f"{sum(sum(pairs.values()) for pairs in apart)} of {sum(map(len, apart))} pairs"
    )
