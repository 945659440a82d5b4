"""How does a process that renders get one core and no more, and the packages that this one has?

Two processes with one thread each beat one with two. But Blender starts threads beside Cycles' one that spin for work:
0.7 s of a second core for each second of rendering. So each process is kept on a core of its own, where the system can.

Two ways to choose the core. Whoever starts all processes of a machine deals cores out (`cores_of_their_own`). Workers
that know nothing of each other take the first core whose file nobody has locked (`free_core`); the lock ends with the
process that holds it, however that ends.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path


def child_environment() -> dict[str, str]:
    """This process' environment, so that a child finds the same packages as this one."""
    paths = [str(Path(__file__).resolve().parents[3]), os.environ.get("PYTHONPATH")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}


@contextlib.contextmanager
def on_core(core: int | None) -> Iterator[None]:
    """Let processes that this thread starts in the block stay on one core; None leaves it to the system."""
    if core is None:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {core})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def cores_of_their_own(n_workers: int) -> list[int | None]:
    """A core for each worker, or None for each where there are too few or the system cannot say."""
    cores = _cores()
    return list(cores[:n_workers]) if len(cores) >= n_workers else [None] * n_workers


@contextlib.contextmanager
def free_core() -> Iterator[int | None]:
    """A core that no other process holds this way; None where all are held, or the system cannot say."""
    with contextlib.ExitStack() as stack:
        yield next((core for core in _cores() if _is_locked_now(stack, core)), None)


def n_cores() -> int:
    """Cores that this process may use."""
    return len(_cores()) or os.cpu_count() or 1


def _cores() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def _is_locked_now(stack: contextlib.ExitStack, core: int) -> bool:
    """Lock the file of `core` until `stack` ends; False where another process has."""
    import fcntl

    path = Path(tempfile.gettempdir()) / f"xihe_core_{core}.lock"
    try:
        file = stack.enter_context(path.open("a"))
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
