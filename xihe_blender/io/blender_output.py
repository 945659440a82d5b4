"""Blender's own output, kept away from ours at the level of file descriptors, since Cycles writes there from C++."""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


@contextlib.contextmanager
def blender_output_aside() -> Iterator[tuple[Any, Any]]:
    """Send what is written to file descriptors 1 and 2 nowhere during the block; give the real stdout and stderr.

    With XIHE_VERBOSE set in the environment it goes to stderr instead.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    real = [os.dup(1), os.dup(2)]
    aside = os.dup(2) if os.environ.get("XIHE_VERBOSE") else os.open(os.devnull, os.O_WRONLY)
    os.dup2(aside, 1)
    os.dup2(aside, 2)
    # A name may hold what the terminal has no sign for: it is not worth the end of a run.
    streams = [os.fdopen(descriptor, "w", closefd=False, errors="backslashreplace") for descriptor in real]
    try:
        yield streams[0], streams[1]
    finally:
        # Registered after Blender was loaded, it runs before Blender ends, and 4.5 prints a line to stdout as it ends.
        atexit.unregister(close_stdout)
        atexit.register(close_stdout)
        # Blender's operators write what they report through Python's own stream.
        for stream in (*streams, sys.stdout, sys.stderr):
            stream.flush()
        for place, descriptor in enumerate(real, start=1):
            os.dup2(descriptor, place)
            os.close(descriptor)
        os.close(aside)


@contextlib.contextmanager
def only_our_output() -> Iterator[None]:
    """As `blender_output_aside`, for a script that prints: what it does in the block goes to the real streams."""
    with blender_output_aside() as (out, err), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


def close_stdout() -> None:
    """Send what still comes from this process' C++ nowhere."""
    with contextlib.suppress(OSError, ValueError):
        sys.stdout.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
