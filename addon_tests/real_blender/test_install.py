"""The zip in a whole Blender: installed, replaced, updated under way, removed, and run where little is allowed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from addon_tests.real_blender.whole_blender import ROOT, SCENE, SMALLEST, WholeBlender

SOURCES = ("xihenet", "xihe_blender")


def another_build(folder, old, new):
    """The zip of a copy of this checkout in which `old` stands for `new` in xihenet/__init__.py."""
    for name in SOURCES:
        shutil.copytree(ROOT / name, folder / name)
    for name in ("pyproject.toml", "LICENSE"):
        shutil.copy(ROOT / name, folder / name)
    init = folder / "xihenet" / "__init__.py"
    content = init.read_text(encoding="utf-8")
    assert old in content
    init.write_text(content.replace(old, new), encoding="utf-8")
    command = [sys.executable, "-m", "xihe_blender", "package", "--out", folder / "out"]
    subprocess.run(command, cwd=folder, check=True, timeout=280)
    return next((folder / "out").glob("*.zip"))


def unpacked(blender):
    """The names of what Blender has unpacked from wheels."""
    return {path.name for path in blender.site_packages.iterdir() if path.name != "__pycache__"}


def assert_a_run_ends_well(blender, folder):
    done = blender.xihe("previs", SCENE, "--out", folder / "out", *SMALLEST)
    assert done.returncode == 0, done.stderr
    assert (folder / "out" / "report.html").exists()


def test_packages_are_imported_from_the_wheel(blender):
    said = blender.background("--python-expr", "import xihe_blender, xihenet; print('at', xihenet.__file__)")
    assert f"at {blender.site_packages}" in said


def test_another_build_of_the_same_version_takes_the_place_of_the_first(extension, tmp_path):
    blender = WholeBlender(tmp_path / "user")
    blender.install(extension)
    before = unpacked(blender)
    blender.install(another_build(tmp_path / "copy", "Xihe's science", "Another build"))
    said = blender.background("--python-expr", "import xihenet; print(xihenet.__doc__)")
    assert "Another build:" in said
    assert len(unpacked(blender)) == len(before)


def test_an_update_needs_no_restart(extension, tmp_path):
    from xihenet import __version__

    blender = WholeBlender(tmp_path / "user")
    blender.install(extension)
    newer = another_build(tmp_path / "copy", __version__, "99.0.0")
    install = f"bpy.ops.extensions.package_install_files(filepath={str(newer)!r}, repo='user_default', overwrite=True)"
    code = f"import bpy, xihenet; {install}; import xihenet; print('now', xihenet.__version__)"
    assert "now 99.0.0" in blender.background("--python-expr", code)


def test_removing_the_extension_removes_what_was_unpacked(extension, tmp_path):
    blender = WholeBlender(tmp_path)
    blender.install(extension)
    assert {"xihenet", "xihe_blender"} <= unpacked(blender)
    blender.extension("remove", "xihe")
    # Blender takes away what no extension needs when it starts the next time.
    blender.background("--python-expr", "import bpy")
    assert not any("xihe" in str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*"))


@pytest.fixture
def read_only(blender):
    """The same, with a folder of extensions that cannot be written."""
    folders = [path for path in (blender.user / "extensions").rglob("*") if path.is_dir()]
    for folder in folders:
        folder.chmod(0o555)
    # What root may write in spite of that is taken away from it.
    powerless = ("setpriv", "--bounding-set=-dac_override,-dac_read_search") if os.geteuid() == 0 else ()
    yield WholeBlender(blender.user, powerless)
    for folder in folders:
        folder.chmod(0o755)


def test_a_run_needs_no_folder_of_extensions_that_can_be_written(read_only, tmp_path):
    probe = f"import pathlib; pathlib.Path({str(read_only.site_packages / 'probe')!r}).touch()"
    assert read_only.run("--background", "--python-exit-code", "1", "--python-expr", probe).returncode == 1
    assert_a_run_ends_well(read_only, tmp_path)


@pytest.mark.skipif(not Path("/proc/self/ns/net").exists(), reason="only Linux can take the network from one process")
def test_a_run_needs_no_network(blender, tmp_path):
    wrapper = ("unshare", "--net") if os.geteuid() == 0 else ("unshare", "--user", "--map-root-user", "--net")
    assert_a_run_ends_well(WholeBlender(blender.user, wrapper), tmp_path)
