"""`blender --command xihe ...`: the `xihe` command inside Blender, with the same sub-commands and exit codes.

Nothing is decided here: `xihe_blender.cli.main` does the work, imported when a command is run, not when Blender starts.
"""

from __future__ import annotations

import signal
from typing import Any, NoReturn

import bpy

_handles: list[Any] = []
"""What Blender gave for the command, at most one: it is needed to take the command away."""


def run_command(arguments: list[str]) -> NoReturn:
    """Run `xihe` with `arguments`, and end this Blender with its exit code."""
    from xihe_blender.cli.main import command

    # Blender takes Ctrl-C for itself, as a wish to break off a render; here it means what it means in `xihe`.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    command(arguments)


def register() -> None:
    """Make `blender --command xihe` known."""
    _handles.append(bpy.utils.register_cli_command("xihe", run_command))


def unregister() -> None:
    """Take it away."""
    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
