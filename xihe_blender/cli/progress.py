"""Progress and notes of a command on stderr, and the exit codes that all commands share."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from xihenet.formats import format_duration

if TYPE_CHECKING:
    from xihe_blender.jobs import Progress

EXIT_IN_PART = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130


def when_news(show: Callable[[Progress, float], None]) -> Callable[[Progress, float], None]:
    """`show`, called only when more is done than before: for jobs that yield while they wait."""
    last = -1.0

    def show_news(progress: Progress, elapsed_s: float) -> None:
        nonlocal last
        if progress.done > last:
            last = progress.done
            show(progress, elapsed_s)

    return show_news


def progress_line(stream: Any) -> Callable[[Progress, float], None]:
    """Shows progress on `stream`: on one line that is rewritten on a terminal, line by line elsewhere."""

    from xihe_blender.jobs import TimeLeft

    time_left = TimeLeft()

    def show(progress: Progress, elapsed_s: float) -> None:
        left = time_left.after(progress, elapsed_s)
        remaining = "" if left is None or progress.done >= progress.total else f", {format_duration(left)} left"
        line = f"{progress.done / progress.total:4.0%}  {progress.doing}{remaining}"
        end = "\n" if not stream.isatty() or progress.done >= progress.total else ""
        print(f"\r\033[K{line}" if stream.isatty() else line, file=stream, end=end, flush=True)

    return show


@contextlib.contextmanager
def notes_on(stream: Any) -> Iterator[None]:
    """Show on `stream` what is logged during the block, a line each; on a terminal in place of the line of progress."""
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logging.Formatter(("\r\033[K" if stream.isatty() else "") + "xihe: note: %(message)s"))
    logger = logging.getLogger("xihe_blender")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
