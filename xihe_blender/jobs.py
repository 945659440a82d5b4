"""How is long work run so that it shows progress, stops cleanly and can be driven in two ways?

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
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import TypeVar

Result = TypeVar("Result")


@dataclass(frozen=True)
class Progress:
    """`done` of `total` units of work, and what comes next in words."""

    done: float
    total: float
    doing: str

    def seconds_left(self, elapsed_s: float) -> float | None:
        """At the pace so far; None before there is a pace."""
        return elapsed_s * (self.total - self.done) / self.done if self.done > 0 else None


Job = Generator[Progress, None, Result]


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


@contextlib.contextmanager
def interrupted_between_steps() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back during the block; the function given says whether it came. A second Ctrl-C is not held back.

    Off the main thread Python allows no signal handlers; the function then always says no.
    """
    pressed = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield pressed.is_set
        return

    def remember(_signal: int, _frame: FrameType | None) -> None:
        if pressed.is_set():
            raise KeyboardInterrupt
        pressed.set()

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield pressed.is_set
    finally:
        # None: whole Blender had set a handler of its own in C, which Python cannot put back.
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
