"""How is another process started that has Blender and this project at hand?

With the bpy wheel, as `python -m module`. A whole Blender's Python has no bpy of its own: there it is another Blender
in background, which runs the module with the paths of this one.
"""

from __future__ import annotations

import sys

import bpy

IN_BLENDER = """import sys, runpy
sys.path[:] = {paths!r}
sys.argv[:] = [{module!r}, *sys.argv[sys.argv.index("--") + 1 :]]
runpy.run_module({module!r}, run_name="__main__")"""


def is_whole_blender() -> bool:
    """Whether this is the application, and not the bpy wheel, which has no program to start."""
    return bool(bpy.app.binary_path)


def module_command(module: str) -> list[str]:
    """The start of a command line that runs `module`; its arguments follow. Exit code and streams are the module's.

    A whole Blender says a line or two of its own on stdout before, and Blender's settings are the factory's.
    """
    if not is_whole_blender():
        return [sys.executable, "-m", module]
    code = IN_BLENDER.format(paths=sys.path, module=module)
    return [bpy.app.binary_path, "--background", "--factory-startup", "--python-expr", code, "--"]
