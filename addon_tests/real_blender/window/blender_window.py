"""Runs a scenario in a real Blender with a window, from outside, and gives back what it saw.

The command comes from the environment: XIHE_BLENDER_WINDOW starts Blender with a window on some (virtual) screen and
passes its arguments on, XIHE_BLENDER_SITE names folders with OpenEXR for that Blender's Python, as in PYTHONPATH, and
XIHE_BLENDER_ADD_ON, if set, is the installed extension to test in place of this checkout.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SCRIPT = Path(__file__).resolve().parent / "run_scenario.py"
COMPLAINT = re.compile(r"Traceback|Error|rna_uiItem|uiItem|not found|unsupported|leak", re.IGNORECASE)
HARMLESS = re.compile(
    r"^Info: |operator +\| (?!ERROR|WARNING)|XDG_RUNTIME_DIR|CUEW|ALSA|libEGL|EGL|audio|libdecor|color management|OCIO|"
    r"MESA|sync required",
    re.IGNORECASE,
)
LONGEST_FREEZE_S = 0.6
"""Beside one plain draw of the window, which takes 0.1 s with OpenGL in software: twice what a quiet machine shows."""


@dataclass(frozen=True)
class WindowRun:
    """How a scenario ended, what was printed, the facts it noted, and the folder with its pictures."""

    code: int
    console: str
    facts: dict[str, Any]
    out: Path

    @property
    def complaints(self) -> list[str]:
        """Lines of the console that speak of an error, from where the scenario begins: before it, Blender starts."""
        ours = self.console.partition("\nscenario ")[2] or self.console
        return [line for line in ours.splitlines() if COMPLAINT.search(line) and not HARMLESS.search(line)]


def run_in_window(
    scenario: str,
    out: Path,
    *,
    blend: Path | None = None,
    add_on: str | None = None,
    run: Path | None = None,
    size_px: tuple[int, int] = (1100, 1000),
    timeout_s: float = 600,
) -> WindowRun:
    """Run scenarios/<scenario>.py; `blend` is opened before, `add_on` and `run` are as run_scenario.py takes them.

    The window is as high as the screen, for its buttons, and no wider than needed: OpenGL in software draws all of it.
    """
    command = shlex.split(os.environ["XIHE_BLENDER_WINDOW"]) + ["--factory-startup"]
    command += ["--window-geometry", "0", "0", *map(str, size_px)]
    command += [] if blend is None else [str(blend)]
    command += ["--python-exit-code", "1", "--python", str(SCRIPT), "--"]
    command += ["--scenario", scenario, "--out", str(out)]
    command += ["--site", os.environ.get("XIHE_BLENDER_SITE", "")]
    command += ["--add-on", add_on or os.environ.get("XIHE_BLENDER_ADD_ON", "checkout")]
    command += [] if run is None else ["--run", str(run)]
    code, console = _run(command, timeout_s)
    facts = out / "facts.json"
    return WindowRun(code, console, json.loads(facts.read_text()) if facts.exists() else {}, out)


def played(scenario: str, out: Path, **options: Any) -> WindowRun:
    """What a scenario saw that came to its end without an error."""
    seen = run_in_window(scenario, out, **options)
    assert (seen.code, seen.complaints) == (0, []), seen.console
    return seen


def _run(command: list[str], timeout_s: float) -> tuple[int, str]:
    """Exit code and all that was printed. After `timeout_s` the command is asked to end, and its code says so."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    try:
        console, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        # Not killed: a command that starts Blender on a screen of its own has to take that down with it.
        process.terminate()
        console, _ = process.communicate()
        console += f"\nended after {timeout_s:.0f} s"
    return process.returncode, console
