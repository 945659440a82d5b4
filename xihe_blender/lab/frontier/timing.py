"""Timing of several things, on a machine that does other things as well.

All candidates take turns: each round measures every one of them once, and each round in another order, so that what
slows the machine for a while, or what one candidate leaves in the caches, falls on all alike. The first round only
warms up. Of the rounds the median counts, and the distance between the quartiles says how far it can be trusted.

Time is the processor's, not the wall's: it hardly feels what else runs. Renders count all threads. Computing counts the
thread that does it: the threads of NumPy's libraries go on to spin for some 30 ms after their work, and all threads
together then charge that to whoever comes next (in one run it made the quartiles of 10 ms lie 7 ms apart). Rejected:
the smallest of many, which is steadier but is not what a run takes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

import numpy as np

from xihe_blender.jobs import Job, Progress

Clock = Callable[[], float]
Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def median_and_spread(values: Sequence[float]) -> tuple[float, float]:
    """Median of some measurements, one at least, and the distance between their quartiles."""
    low, middle, high = np.percentile(values, (25, 50, 75))
    return float(middle), float(high - low)


def timed(run: Callable[Arguments, Result], *args: Arguments.args, **kwargs: Arguments.kwargs) -> tuple[Result, float]:
    """What `run` gives, and the milliseconds of processor time it takes, all threads together."""
    start = time.process_time()
    result = run(*args, **kwargs)
    return result, 1e3 * (time.process_time() - start)


def interleaved(
    candidates: Sequence[Callable[[], float]], n_rounds: int, rng: np.random.Generator
) -> Job[list[list[float]]]:
    """What each candidate gives, round by round, in `n_rounds` rounds after one to warm up.

    Each candidate measures itself when it is called, so that it can leave out what does not count.
    """
    measured: list[list[float]] = [[] for _ in candidates]
    for done in range(n_rounds + 1):
        for number in rng.permutation(len(candidates)):
            value = candidates[number]()
            if done > 0:
                measured[number].append(value)
        yield Progress(done + 1, n_rounds + 1, f"timing {len(candidates)} ways to compute, round {done}")
    return measured
