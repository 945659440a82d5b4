"""`blender --command xihe ...`: the `xihe` command inside Blender, with the same sub-commands and exit codes.

Nothing is decided here: `xihe_blender.cli.main` does the work, imported when a command is run, not when Blender starts.
"""

from __future__ import annotations

import signal
from typing import Any

import bpy

_handles: list[Any] = []
"""What Blender gave for the command, at most one: it is needed to take the command away."""


def run_command(arguments: list[str]) -> int:
    """Run `xihe` with `arguments`; its exit code becomes Blender's."""
    from xihe_blender.cli.main import main
    from xihe_blender.io.blender_output import close_stdout

    # Blender takes Ctrl-C for itself, as a wish to break off a render; here it means what it means in `xihe`.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return main(arguments)
    except SystemExit as end:
        # Of --help and --version.
        return end.code if isinstance(end.code, int) else 0
    finally:
        # Blender still prints what it has to report, and stdout belongs to the command.
        close_stdout()


def register() -> None:
    """Make `blender --command xihe` known."""
    _handles.append(bpy.utils.register_cli_command("xihe", run_command))


def unregister() -> None:
    """Take it away."""
    while _handles:
        bpy.utils.unregister_cli_command(_handles.pop())
