"""With which software, on which machine was a result made? As every JSON of the project says it."""

from __future__ import annotations

import os
import platform

import bpy
import numpy as np

from xihenet import __version__, estimators


def software(command: str) -> dict[str, str]:
    """Versions of all that shapes numbers, and the `command` that the user typed."""
    return {
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "numpy": np.__version__,
        **estimators.packages(),
        "command": command,
    }


def machine() -> dict[str, str | int | None]:
    """What it ran on; nothing that names the user."""
    return {"platform": platform.platform(), "processor": platform.machine(), "n_cores": os.cpu_count()}
