"""One core for a process that renders, and no more, with the packages that this process has.

Two processes with one thread each beat one with two. But Blender starts threads beside Cycles' one that spin for work:
0.7 s of a second core for each second of rendering. So each process is kept on a core of its own, where the system can:
the first one whose file nobody has locked. The lock ends with the process that holds it, however that ends.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from xihenet.child_processes import child_environment, cores

ENDS_WITHIN_S = 60.0
"""Of a process that was told to end: enough for the room that it is making."""


@contextlib.contextmanager
def process_on_one_core(command: Sequence[str], **streams: Any) -> Iterator[tuple[subprocess.Popen[Any], IO[bytes]]]:
    """A process, and what it writes to stderr; it has ended when the block has, whatever happens.

    `streams` are further arguments of `Popen`.
    """
    with tempfile.TemporaryFile() as errors, _free_core() as core:
        process = subprocess.Popen(command, stderr=errors, env=child_environment(), **streams)
        try:
            if core is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.sched_setaffinity(process.pid, {core})
            yield process, errors
        finally:
            _end(process)


def _end(process: subprocess.Popen[Any]) -> None:
    """Told to end, it may finish what it does; Blender sometimes never comes to its end by itself."""
    process.terminate()
    try:
        process.wait(ENDS_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def last_line(errors: IO[bytes]) -> str:
    """Of what a process wrote to stderr; empty for none."""
    errors.seek(0)
    return next(reversed(errors.read().decode(errors="replace").strip().splitlines()), "")


@contextlib.contextmanager
def _free_core() -> Iterator[int | None]:
    """A core that nobody else holds this way; None where all are held, or the system cannot say."""
    with contextlib.ExitStack() as stack:
        yield next((core for core in cores() if _is_locked_now(stack, core)), None)


def _is_locked_now(stack: contextlib.ExitStack, core: int) -> bool:
    """Lock the file of `core` until `stack` ends; False where somebody else has."""
    import fcntl

    path = Path(tempfile.gettempdir()) / f"xihe_core_{core}.lock"
    try:
        file = stack.enter_context(path.open("a"))
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
