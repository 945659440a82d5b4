"""Jobs: long work that shows progress, stops cleanly and can be driven in two ways.

A job is a generator that yields `Progress` between its steps and has nothing half-written at any yield. `run_blocking`
drives one from the command line or a script; the panel's modal operator drives the same generator one step per tick.

Ctrl-C: Cycles calls back into Python while it renders, and an exception raised there is swallowed and the engine left
broken. So the signal only sets a flag, and the job is closed at its next yield.
"""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from bisect import insort
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field
from types import FrameType
from typing import TypeVar

Result = TypeVar("Result")
Step = TypeVar("Step")


@dataclass(frozen=True)
class Progress:
    """`done` of `total` units of work, and what comes next in words.

    `left` are the units that are left by stage, the one under way first; empty for a job of one stage.
    """

    done: float
    total: float
    doing: str
    left: Mapping[str, float] = field(default_factory=dict)

    @property
    def stages(self) -> Mapping[str, float]:
        """`left`, of a job of one stage too."""
        return self.left or {"": self.total - self.done}


@dataclass
class _Stage:
    """Units and seconds of the first step of a stage, and the seconds per unit of those that follow, in rising order:
    sorted anew at each step, those of 10,000 took 7 s."""

    units: float
    seconds: float
    paces: list[float] = field(default_factory=list)

    @property
    def pace(self) -> float:
        """Seconds per unit: the median."""
        paces = self.paces or [self.seconds / self.units]
        return (paces[(len(paces) - 1) // 2] + paces[len(paces) // 2]) / 2


class TimeLeft:
    """The time that is left of a job, from the pace of each of its stages; told of every Progress, in order.

    The first step of a stage carries set-up (Cycles builds the scene), so the pace is the median of those that follow.
    Stages that are still to come are taken to go at the pace of the last one, by their units, with as much set-up. Of
    jobs that follow each other each counts in units of its own.
    """

    def __init__(self) -> None:
        self.known: dict[str, _Stage] = {}
        self.before: tuple[Progress, float] | None = None

    def after(self, progress: Progress, elapsed_s: float) -> float | None:
        """Seconds left; None before there are two steps."""
        since_s = elapsed_s
        if self.before is not None and _is_of_another_job(progress, self.before[0]):
            self.known.clear()
        elif self.before is not None:
            last, then_s = self.before
            stage = next(iter(last.stages))
            units = last.stages[stage] - progress.stages.get(stage, 0.0)
            if units > 0 and stage in self.known:
                insort(self.known[stage].paces, (elapsed_s - then_s) / units)
            elif units > 0:
                self.known[stage] = _Stage(units, elapsed_s - then_s)
            elif stage in progress.stages and (stage in self.known or progress == last):
                since_s = then_s  # What is told within a unit does not end it.
        self.before = progress, since_s
        paces = {name: stage.pace for name, stage in self.known.items()}
        if sum(1 + len(stage.paces) for stage in self.known.values()) < 2:
            return None  # One step is mostly set-up.
        set_ups = [stage.seconds - stage.units * stage.pace for stage in self.known.values() if stage.paces]
        set_up_s, last_pace = max(0.0, *set_ups, 0.0), list(paces.values())[-1]
        return sum(
            units * paces[stage] if stage in paces else units * last_pace + set_up_s
            for stage, units in progress.stages.items()
            if units > 0
        )


def _is_of_another_job(progress: Progress, last: Progress) -> bool:
    if progress.left or last.left:
        return bool(progress.left) != bool(last.left)
    return progress.total != last.total or progress.done < last.done


Job = Generator[Progress, None, Result]
Steps = Generator[None, None, Result]
"""Work that can be left between its steps, of which its caller says what they show: by `shown` it is a job."""


def run_blocking(job: Job[Result], on_progress: Callable[[Progress, float], None] | None = None) -> Result:
    """Drive `job` to its end and return its result.

    `on_progress` gets each Progress and the seconds since the start. KeyboardInterrupt is raised after Ctrl-C, once
    the step under way has ended and the job has cleaned up.
    """
    start = time.perf_counter()
    with interrupted_between_steps() as is_interrupted, contextlib.closing(job):
        while True:
            try:
                progress = next(job)
            except StopIteration as finished:
                result: Result = finished.value
                return result
            if on_progress is not None:
                on_progress(progress, time.perf_counter() - start)
            if is_interrupted():
                raise KeyboardInterrupt


def part_of(whole: float, done: float, share: float, job: Job[Result], scene: str = "") -> Job[Result]:
    """`job` as `share` of the units of `whole`, of which `done` are done before it."""
    prefix = f"{scene}: " if scene else ""
    return shown(job, lambda own: Progress(done + share * (own.done / own.total), whole, prefix + own.doing))


def shown(steps: Generator[Step, None, Result], say: Progress | Callable[[Step], Progress]) -> Job[Result]:
    """A job of `steps`, which yield something else, or Progress of their own; `say` is, or says, what each shows."""
    with contextlib.closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as finished:
                result: Result = finished.value
                return result
            yield say if isinstance(say, Progress) else say(step)


def timed(job: Job[Result]) -> Job[tuple[Result, float]]:
    """A job: the result of `job`, and the seconds that it worked; between its steps a window waits for its user."""
    spent_s = 0.0
    with contextlib.closing(job):
        while True:
            start = time.perf_counter()
            try:
                progress = next(job)
            except StopIteration as finished:
                return finished.value, spent_s + time.perf_counter() - start
            spent_s += time.perf_counter() - start
            yield progress


@contextlib.contextmanager
def interrupted_between_steps() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back during the block; the function given says whether it came. A second Ctrl-C is not held back.

    Off the main thread Python allows no signal handlers; the function then always says no.
    """
    # No threading.Event: a second signal while the first one sets it would wait for its lock for ever.
    pressed: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return

    def remember(number: int, _frame: FrameType | None) -> None:
        if pressed:
            raise KeyboardInterrupt
        pressed.append(number)

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield lambda: bool(pressed)
    finally:
        # None: whole Blender had set a handler of its own in C, which Python cannot put back.
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
