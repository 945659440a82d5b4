"""The `xihe` command in a process of its own, which is `python -m xihe_blender` or another whole Blender.

Run as a module inside that Blender, it marks where the command begins: what Blender says before is not the command's.
"""

import subprocess
import sys
import warnings
from pathlib import Path

import bpy

from xihe_blender.cli.main import main
from xihe_blender.lab.workers.processes import module_command

ROOT = Path(__file__).resolve().parents[2]
BEGINS = "---- the command begins ----\n"


def typed(*arguments):
    """What is started; warnings are errors in the command as well."""
    words = [str(argument) for argument in arguments]
    if bpy.app.binary_path:  # A whole Blender, and not the bpy wheel, which has no program to start
        return [*module_command("xihe_process"), *words]
    return [sys.executable, "-W", "error", "-m", "xihe_blender", *words]


def output_of_command(text):
    """`text` of a process without what a whole Blender said before the command began."""
    return text.partition(BEGINS)[2] if bpy.app.binary_path else text


def xihe(*arguments, **options):
    """Run the command; its exit code and what it said."""
    done = subprocess.run(typed(*arguments), cwd=ROOT, capture_output=True, text=True, timeout=100, **options)
    return subprocess.CompletedProcess(
        done.args, done.returncode, output_of_command(done.stdout), output_of_command(done.stderr)
    )


if __name__ == "__main__":
    for stream in (sys.stdout, sys.stderr):
        print(BEGINS, end="", file=stream, flush=True)
    warnings.simplefilter("error")
    sys.exit(main())
