"""What does a Dask worker do with a unit? It starts a process with Blender in it, passes on how far that is, and waits.

The worker itself never loads Blender: its memory stays what it is, and neither of the two can take the other with it.
Runs on whatever machine the worker is on; what goes over the network are names, settings and shares of work.
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

from xihe_blender.evaluation.batch.blender_process import EXIT_CANNOT_BE_DONE
from xihe_blender.one_core import child_environment, free_core, on_core
from xihenet import __version__

TOPIC = "xihe-evaluate"
"""Of the events that tell how far a unit is."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class BlenderDiedError(Exception):
    """The process ended without a word of what the user could mend: it was killed, or Blender crashed."""


def evaluate(asked: dict[str, Any]) -> str | None:
    """Evaluate a unit; None, or in one line why it cannot be done.

    Parameters
    ----------
    asked : {"unit", "scene", "seed", "folder", "settings"}, as `blender_process` takes it

    Raises
    ------
    BlenderDiedError for what may go better next time
    """
    command = [sys.executable, "-m", "xihe_blender.evaluation.batch.blender_process"]
    with tempfile.TemporaryFile() as errors, free_core() as core:
        with on_core(core):
            process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env={**child_environment(), **ONE_THREAD},
                text=True,
            )
        try:
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
    with contextlib.suppress(BrokenPipeError):
        process.stdin.write(json.dumps(asked))
        process.stdin.close()
    worker = get_worker()
    for line in process.stdout:
        worker.log_event(TOPIC, {"unit": asked["unit"], "share": float(line), "blender": process.pid})


def _last_line(errors: Any) -> str:
    errors.seek(0)
    lines = errors.read().decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


def describe_worker(folder: str, scenes: list[str]) -> dict[str, Any]:
    """What decides whether a worker can help: its version, and which of the paths it does not see."""
    seen = [path for path in (folder, *scenes) if not Path(path).exists()]
    return {"xihe": __version__, "missing": seen, "is_writable": os.access(folder, os.W_OK)}
