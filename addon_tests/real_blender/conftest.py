"""These tests need a whole Blender: without the command for one they are not collected, and the run says so.

    make test-extension BLENDER=/path/to/blender

One extension is built for all of them. Each Blender gets a folder of its own for what it keeps of a user.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = "XIHE_BLENDER"
HAS_BLENDER = COMMAND in os.environ
ROOT = Path(__file__).resolve().parents[2]

collect_ignore_glob = [] if HAS_BLENDER else ["test_*.py"]


def pytest_terminal_summary(terminalreporter):
    if not HAS_BLENDER:
        terminalreporter.write_line(
            f"{COMMAND} is not set: the extension's tests of addon_tests/real_blender were left out", yellow=True
        )


@pytest.fixture(scope="session")
def extension(tmp_path_factory):
    """The zip, as the command builds it from this checkout."""
    out = tmp_path_factory.mktemp("extension")
    subprocess.run([sys.executable, "-m", "xihe_blender", "package", "--out", out], cwd=ROOT, check=True, timeout=280)
    return next(out.glob("*.zip"))


@pytest.fixture(scope="module")
def blender(extension, tmp_path_factory):
    """A Blender whose user has installed and enabled the extension."""
    from addon_tests.real_blender.whole_blender import WholeBlender

    blender = WholeBlender(tmp_path_factory.mktemp("user"))
    blender.install(extension)
    return blender
