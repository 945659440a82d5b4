"""The Pareto front: which choices are worth considering, when each has an error and a cost? Less is better of both.

A choice is dominated if another is no worse in both and better in one; those that are not form the front. Ties stay
together: two choices of equal error and equal cost are both on it, or both off. The front is that of the plain numbers,
with no tolerance, so that anyone who has them finds the same one. How far it can be trusted is a question of its own:
`front_share` measures it again and again on resampled measurements. Rejected: a margin within which choices count as
equal, which makes being on the front depend on a number that nobody has measured.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayBool, ArrayF64, ArrayInt


def on_front(errors: ArrayLike, costs: ArrayLike) -> ArrayBool:
    """(C,) whether each of C choices is dominated by no other; C may be 0.

    ValueError for shapes that differ, and for NaN. Infinity is legal: no worse than another infinity.
    """
    error, cost = _checked(errors, costs)
    is_on_front = np.zeros(len(error), bool)
    best_error, its_cost = np.inf, np.inf
    for index, choice in enumerate(np.lexsort((error, cost))):
        is_tie = error[choice] == best_error and cost[choice] == its_cost
        if index == 0 or error[choice] < best_error or is_tie:
            is_on_front[choice] = True
            best_error, its_cost = error[choice], cost[choice]
    return is_on_front


def dominators(errors: ArrayLike, costs: ArrayLike) -> ArrayInt:
    """(C,) for each choice the number of the one to take instead: itself, if it is on the front.

    Of the choices on the front that dominate it, the one of least error, which costs no more than the choice itself.
    Raises as `on_front`.
    """
    error, cost = _checked(errors, costs)
    front = np.flatnonzero(on_front(error, cost))
    instead = np.arange(len(error))
    for choice in np.setdiff1d(instead, front):
        affordable = front[cost[front] <= cost[choice]]
        instead[choice] = affordable[np.argmin(error[affordable])]
    return instead


def front_share(
    square_errors: ArrayLike, costs: ArrayLike, rng: np.random.Generator, n_resamples: int = 200
) -> ArrayF64:
    """In what share of resampled measurements each choice is on the front: near 0 or 1 for one that does not flicker.

    A choice's error is the root of the mean of its squared errors (P, C) at P places, its cost the median of (R, C)
    over R rounds. Rounds and places are drawn with replacement, whole: what disturbs a round disturbs all choices
    alike. (C,) 0 to 1. ValueError without a place, a round or a resample, and for NaN.
    """
    squares, rounds = np.asarray(square_errors, np.float64), np.asarray(costs, np.float64)
    if squares.ndim != 2 or rounds.ndim != 2 or squares.shape[1] != rounds.shape[1]:
        raise ValueError(f"front_share: expected (P, C) and (R, C), got {squares.shape} and {rounds.shape}")
    if not (len(squares) and len(rounds) and n_resamples > 0):
        raise ValueError("front_share: expected a place, a round and a resample at least, got none")
    drawn_places, drawn_rounds = (rng.integers(n, size=(n_resamples, n)) for n in (len(squares), len(rounds)))
    # All at once: one after the other took four times as long.
    resampled = zip(np.sqrt(squares[drawn_places].mean(axis=1)), np.median(rounds[drawn_rounds], axis=1), strict=True)
    share: ArrayF64 = np.mean([on_front(error, cost) for error, cost in resampled], axis=0)
    return share


def _checked(errors: ArrayLike, costs: ArrayLike) -> tuple[ArrayF64, ArrayF64]:
    error, cost = np.asarray(errors, np.float64), np.asarray(costs, np.float64)
    if error.shape != cost.shape or error.ndim != 1:
        raise ValueError(f"front: expected an error and a cost for each choice, got {error.shape} and {cost.shape}")
    if np.isnan(error).any() or np.isnan(cost).any():
        raise ValueError("front: expected numbers, got NaN")
    return error, cost
