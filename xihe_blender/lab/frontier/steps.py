"""Steps of long work, written without knowing how large a part of the whole they are.

As a generator that yields how much of itself is done, 0 to 1, and what comes next in words. `within` makes it a part of
a larger one, and `part_of` makes `Progress` of it, for a job (see `xihe_blender.jobs`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from typing import TypeVar

from xihe_blender.jobs import Job, Progress

Changed = TypeVar("Changed")
Own = TypeVar("Own")
Result = TypeVar("Result")
Steps = Generator[tuple[float, str], None, Result]


def mapped_steps(
    steps: Generator[Own, None, Result], change: Callable[[Own], Changed]
) -> Generator[Changed, None, Result]:
    """`steps`, each thing that it yields made another by `change`; closed with it."""
    with contextlib.closing(steps):
        while True:
            try:
                own = next(steps)
            except StopIteration as finished:
                result: Result = finished.value
                return result
            yield change(own)


def within(start: float, share: float, steps: Steps[Result]) -> Steps[Result]:
    """`steps` as the part of a larger work from `start` on."""
    return mapped_steps(steps, lambda step: (start + share * step[0], step[1]))


def part_of(whole: float, done: float, share: float, steps: Steps[Result], scene: str = "") -> Job[Result]:
    """Drive `steps`, which is `share` of the units of `whole`, of which `done` are done before it."""
    prefix = f"{scene}: " if scene else ""
    return mapped_steps(steps, lambda step: Progress(done + share * step[0], whole, prefix + step[1]))
