"""Times of calls that take turns, so that what else the machine does, and its drift, falls on all of them alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

N_WARM = 3


def interleaved_ms(
    calls: Mapping[str, Callable[[], object]], repeats: int, *, is_called_before: bool = False
) -> dict[str, list[float]]:
    """Milliseconds of each call, after some rounds to warm up; each after a call that is not timed, where asked."""
    elapsed_ms: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + N_WARM):
        for name, call in calls.items():
            if is_called_before:
                call()
            start = time.perf_counter()
            call()
            if turn >= N_WARM:
                elapsed_ms[name].append(1e3 * (time.perf_counter() - start))
    return elapsed_ms
