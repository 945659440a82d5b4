"""The extension's zip in the eyes of Blender itself: its own validator, which comes with the bpy wheel."""

import subprocess
import sys
from pathlib import Path

import bpy
import pytest

from xihe_blender.packaging.extension import build_extension
from xihe_blender.packaging.project_wheel import packed

VALIDATOR = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core/bl_pkg/cli/blender_ext.py"


def validate(path):
    """Exit code and all that the validator says."""
    done = subprocess.run([sys.executable, VALIDATOR, "validate", path], capture_output=True, text=True, timeout=100)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def extension(tmp_path_factory):
    return build_extension(tmp_path_factory.mktemp("extension"))


def test_blender_finds_nothing_wrong_with_the_extension(extension):
    code, said = validate(extension)
    assert code == 0 and "Success" in said, said


def test_blender_would_say_if_something_were_wrong(tmp_path):
    (tmp_path / "wrong.zip").write_bytes(packed({"__init__.py": b"", "blender_manifest.toml": b'id = "xihe"\n'}))
    code, said = validate(tmp_path / "wrong.zip")
    assert code != 0 and "missing" in said.lower(), said
