"""What do the presets cost on the user's machine? Measured when asked for, and remembered for all files.

In a file of the add-on's own place, not in Blender's preferences: those are saved when the user says so. Panels read
its one sentence at every redraw: the file is a few hundred bytes.
"""

from __future__ import annotations

from pathlib import Path

from xihe_blender.addon.preferences import chosen_folder, own_folder
from xihenet.io.json_files import read_json

FILE_NAME = "calibration.json"


def calibration_file() -> Path:
    """Where the costs are remembered: beside the runs, in the user's Runs Folder or the extension's own place."""
    return (chosen_folder() or own_folder()) / FILE_NAME


def calibration_line() -> str:
    """The costs in one sentence; empty before they were measured."""
    try:
        return str(read_json(calibration_file())["said"])
    except (OSError, KeyError, TypeError, ValueError):
        return ""
