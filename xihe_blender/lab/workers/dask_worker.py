"""A Dask worker with a piece of work: it starts a process with Blender in it, and waits.

The worker itself never loads Blender, whose module does not load beside the thread that Dask works in: its memory stays
what it is, and neither of the two can take the other with it. Runs on whatever machine the worker is on; what goes over
the network are names, settings and shares of work.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from distributed import get_worker

from xihe_blender.lab.workers.one_core import child_environment, free_core, on_core
from xihenet import __version__

EXIT_CANNOT_BE_DONE = 2
"""Of a module that has said on stderr what the user can mend."""

TOPIC = "xihe"
"""Of the events that tell how far a piece of work is."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class BlenderDiedError(Exception):
    """The process ended without a word of what the user could mend: it was killed, or Blender crashed."""


def run_module(asked: dict[str, Any]) -> str | None:
    """Run a module of this project in a process with Blender; None, or in one line why it cannot be done.

    Parameters
    ----------
    asked : {"name", "module", "arguments", "told"}: the command line, and what it gets on stdin as JSON. A module that
        is told something tells its share of the work on stdout, a number from 0 to 1 a line; None is for one that is
        not and does not

    Raises
    ------
    BlenderDiedError for what may go better next time
    """
    command = [sys.executable, "-m", asked["module"], *asked["arguments"]]
    piped = subprocess.PIPE if asked["told"] is not None else subprocess.DEVNULL
    with tempfile.TemporaryFile() as errors, free_core() as core:
        with on_core(core):
            process = subprocess.Popen(
                command, stdin=piped, stdout=piped, stderr=errors, env={**child_environment(), **ONE_THREAD}, text=True
            )
        try:
            if asked["told"] is not None:
                _pass_on(process, asked)
            code = process.wait()
        finally:
            process.kill()
            process.wait()
        if code == 0:
            return None
        words = _last_line(errors)
    if code == EXIT_CANNOT_BE_DONE:
        return words
    raise BlenderDiedError(words if words and code > 0 else f"Blender ended with exit code {code}")


def _pass_on(process: subprocess.Popen[str], asked: dict[str, Any]) -> None:
    """Tell the process what to do, and everyone who listens how far it is."""
    assert process.stdin is not None and process.stdout is not None
    # One that died at once says why by its exit code.
    with process.stdout as shares, contextlib.suppress(BrokenPipeError):
        with process.stdin as stdin:
            stdin.write(json.dumps(asked["told"]))
        worker = get_worker()
        for line in shares:
            worker.log_event(TOPIC, {"name": asked["name"], "share": float(line), "blender": process.pid})


def _last_line(errors: Any) -> str:
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


def describe_worker(folder: str, scenes: list[str]) -> dict[str, Any]:
    """What decides whether a worker can help: its version, and which of the paths it does not see."""
    seen = [path for path in (folder, *scenes) if not Path(path).exists()]
    return {"xihe": __version__, "missing": seen, "is_writable": os.access(folder, os.W_OK)}


def has_dashboard(dask_scheduler: Any) -> bool:
    """Whether a scheduler has one: Bokeh's application among those of its web server.

    Its address is no sign: the web server is there in any case, and without bokeh it says how to get that.
    """
    return any("Bokeh" in type(one).__name__ for one in dask_scheduler.http_application.applications)
