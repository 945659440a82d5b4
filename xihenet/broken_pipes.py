"""Broken pipes: a write to a connection or a pipe whose other end is gone is an OSError, inside Blender too.

Python by itself ignores SIGPIPE and raises BrokenPipeError. Blender's Python leaves the signal as it is, and it would
end Blender. To ignore it for the whole process was rejected: Blender and other add-ons have a say in that.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator


@contextlib.contextmanager
def broken_pipes_raise() -> Iterator[None]:
    """For writes of this thread inside the block."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows, which has no such signal
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE not in before and signal.SIGPIPE in signal.sigpending():
            signal.sigwait({signal.SIGPIPE})
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
