"""OpenEXR files in forms that only the OpenEXR package reads, read by it in a process of its own."""

import sys

import numpy as np
import pytest

from addon_tests.pure.frame_makers import write_by_package
from xihenet.io.frame_files import read_exr_channels
from xihenet.io.openexr_package import is_installed, read_by_package

pytestmark = pytest.mark.wheel_only("the OpenEXR package, which writes these files, crashes beside Blender's own")
NAMES = ("ViewLayer.Combined.R", "a/b, ü.Z", "names")


@pytest.fixture
def channels():
    rng = np.random.default_rng(0)
    return {name: rng.random((48, 64)).astype(np.float32) for name in NAMES}


def test_it_agrees_with_our_own_reader(tmp_path, channels):
    path = write_by_package(tmp_path / "a.exr", channels, "ZIP")
    ours, theirs = read_exr_channels(path), read_by_package(path)
    assert ours.keys() == theirs.keys() == channels.keys()
    assert all(np.array_equal(ours[name], theirs[name]) for name in NAMES)


def test_a_file_that_is_none_is_refused_in_one_line(tmp_path):
    (tmp_path / "text.exr").write_text("a shopping list")
    with pytest.raises(ValueError, match=r"expected an OpenEXR file, and could not read it \([^\n]+\)$"):
        read_by_package(tmp_path / "text.exr")


def test_asking_whether_it_is_installed_does_not_import_it(monkeypatch):
    monkeypatch.delitem(sys.modules, "OpenEXR", raising=False)
    assert is_installed() and "OpenEXR" not in sys.modules
