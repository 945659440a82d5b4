"""How is a part of long work written without knowing how large a part of the whole it is?

As a generator that yields how much of itself is done, 0 to 1, and what comes next in words; `part_of` makes `Progress`
of the whole of that, for a job (see `xihe_blender.jobs`).
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

from xihe_blender.jobs import Job, Progress

Result = TypeVar("Result")
Steps = Generator[tuple[float, str], None, Result]


def part_of(whole: float, done: float, share: float, steps: Steps[Result], scene: str = "") -> Job[Result]:
    """Drive `steps`, which is `share` of the units of `whole`, of which `done` are done before it."""
    prefix = f"{scene}: " if scene else ""
    while True:
        try:
            own, doing = next(steps)
        except StopIteration as finished:
            result: Result = finished.value
            return result
        yield Progress(done + share * own, whole, prefix + doing)
