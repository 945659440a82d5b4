"""Processes beside this one that have Blender and this project at hand.

With the bpy wheel, as `python -m module`. A whole Blender's Python has no bpy of its own: there it is another Blender
in background, which runs this file, with the paths of this one. Its own way out is not taken (`leave_blender`).
"""

from __future__ import annotations

import contextlib
import json
import os
import runpy
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import bpy

EXIT_CRASHED = 70


def module_command(module: str, blender: str | None = None) -> list[str]:
    """The start of a command line that runs `module`; its arguments follow. Exit code and streams are the module's.

    `blender` is the program of a whole Blender, by default this one if it is one. It says a line or two of its own on
    stdout before, and its settings are the factory's.
    """
    blender = bpy.app.binary_path if blender is None else blender
    if not blender:
        return [sys.executable, "-m", module]
    start = [blender, "--background", "--factory-startup", "--python", str(Path(__file__).resolve())]
    return [*start, "--", json.dumps(sys.path), module]


@contextlib.contextmanager
def only_with_a_reader(pipe: int) -> Iterator[None]:
    """End this Blender within a second or two of the end of whoever reads `pipe`, if that comes during the block.

    Whether a pipe still has a reader shows only when it is written to, so an empty line is written every second.
    """
    from xihe_blender.io.blender_output import leave_blender  # What runs this file as a program has not found them yet.
    from xihenet.broken_pipes import broken_pipes_raise

    is_over = threading.Event()

    def write() -> None:
        while not is_over.wait(1):
            try:
                with broken_pipes_raise():
                    os.write(pipe, b"\n")
            except OSError:
                leave_blender(EXIT_CRASHED)

    beside = threading.Thread(target=write, daemon=True)
    beside.start()
    try:
        yield
    finally:
        is_over.set()
        beside.join()  # Blender does not end while a thread lives.


def _run_module(paths: str, module: str, *arguments: str) -> NoReturn:
    """What a Blender that `module_command` started does."""
    sys.path[:], sys.argv[:] = json.loads(paths), [module, *arguments]
    from xihe_blender.io.blender_output import exit_code_of, leave_blender

    leave_blender(exit_code_of(lambda: runpy.run_module(module, run_name="__main__")))


if __name__ == "__main__":
    _run_module(*sys.argv[sys.argv.index("--") + 1 :])
