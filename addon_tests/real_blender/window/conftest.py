"""These tests need a Blender with a window: without the command for one they are not collected, and the run says so."""

import os
import sys
from pathlib import Path

# The driver lies beside the tests, and is no package.
sys.path.insert(0, str(Path(__file__).resolve().parent))

COMMAND = "XIHE_BLENDER_WINDOW"
HAS_WINDOW = COMMAND in os.environ

collect_ignore_glob = [] if HAS_WINDOW else ["test_*.py"]


def pytest_terminal_summary(terminalreporter):
    if not HAS_WINDOW:
        terminalreporter.write_line(f"{COMMAND} is not set: addon_tests/real_blender/window was left out", yellow=True)
