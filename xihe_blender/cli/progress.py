"""Progress and notes of a command on stderr, and the exit codes that all commands share."""

from __future__ import annotations

import bisect
import contextlib
import itertools
import logging
import os
import unicodedata
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from xihenet.formats import format_duration

if TYPE_CHECKING:
    from xihe_blender.jobs import Progress

EXIT_IN_PART = 1
EXIT_USER_ERROR = 2
EXIT_INTERRUPTED = 130

CUT = "..."
MANY_COLUMNS, USUAL_COLUMNS = 10**6, 79
"""Of a terminal that does not say how wide it is: for what is written, and for what is written over."""


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

    is_rewritten, last = _can_rewrite(stream), ("", "")

    def show(progress: Progress, elapsed_s: float) -> None:
        nonlocal last
        left = time_left.after(progress, elapsed_s)
        remaining = "" if left is None or progress.done >= progress.total else f", {format_duration(left)} left"
        share = f"{progress.done / progress.total:4.0%}  "
        doing = " ".join(progress.doing.split())
        last, before = (share, doing), last
        if last == before and not is_rewritten:
            return
        if is_rewritten:
            # What does not fit would go on in a second line, and stay there.
            doing = _cut_to(_n_columns(stream) - len(share + remaining) - 1, doing)
        end = "\n" if not is_rewritten or progress.done >= progress.total else ""
        print(_wiped(stream) + share + doing + remaining, file=stream, end=end, flush=True)

    return show


def _can_rewrite(stream: Any) -> bool:
    """Whether `stream` is a terminal that can go back and write a line anew."""
    return bool(stream.isatty()) and os.environ.get("TERM") != "dumb"


def _wiped(stream: Any) -> str:
    """What has `stream` begin its line anew: spaces over what stands there, since not every console of Windows knows
    escape sequences; nothing where it is no terminal."""
    n_columns = _n_columns(stream)
    return (
        f"\r{' ' * (USUAL_COLUMNS if n_columns == MANY_COLUMNS else n_columns - 1)}\r" if _can_rewrite(stream) else ""
    )


def _n_columns(stream: Any) -> int:
    try:
        return os.get_terminal_size(stream.fileno()).columns or MANY_COLUMNS
    except OSError:
        return MANY_COLUMNS


def _cut_to(n_columns: int, words: str) -> str:
    """`words` as far as there is room for them; signs of Chinese, Japanese and Korean take two columns."""
    ends = list(itertools.accumulate(1 + (unicodedata.east_asian_width(sign) in "WF") for sign in words))
    if not ends or ends[-1] <= n_columns:
        return words
    return words[: bisect.bisect_right(ends, n_columns - len(CUT))] + CUT


@contextlib.contextmanager
def notes_on(stream: Any) -> Iterator[None]:
    """Show on `stream` what is logged during the block, a line each; on a terminal in place of the line of progress."""
    handler = logging.StreamHandler(stream)
    handler.setFormatter(logging.Formatter(f"{_wiped(stream)}xihe: note: %(message)s"))
    logger = logging.getLogger("xihe_blender")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
