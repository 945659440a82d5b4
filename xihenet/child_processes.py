"""Child processes that work beside this one, each on one core: what do they need?"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


def cores() -> list[int]:
    """Numbers of the cores that this process may use; empty where the system cannot say."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


def n_cores() -> int:
    """Cores that this process may use."""
    return len(cores()) or os.cpu_count() or 1


def child_environment() -> dict[str, str]:
    """This process' environment, so that a child finds the packages that this one has, and works in one thread."""
    # A whole Blender brings its own NumPy, which another interpreter would not find.
    paths = [str(Path(__file__).resolve().parents[1]), str(Path(np.__file__).resolve().parents[1])]
    known = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([*paths, *([known] if known else [])]), **ONE_THREAD}
