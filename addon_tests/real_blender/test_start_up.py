"""What the enabled add-on costs Blender's start, and what it leaves once it is disabled."""

import sys

import pytest

from addon_tests.real_blender.whole_blender import MODULE, WholeBlender

HEAVY = {"numpy", "torch", "OpenEXR", "scipy", "xihenet.estimators"}
HEAVY |= {"xihe_blender.previs.previs", "xihe_blender.cli.main"}
OURS = ("xihenet", "xihe_blender", "bl_ext")


@pytest.fixture(scope="module")
def started(blender, tmp_path_factory):
    """The names of the modules after a start with the add-on, and after one without."""
    folder = tmp_path_factory.mktemp("started")
    other = WholeBlender(tmp_path_factory.mktemp("other_user"))
    with_it, without_it = (of.facts("loaded_modules.py", folder / "facts.json", MODULE) for of in (blender, other))
    assert with_it["is_enabled"] and not without_it["is_enabled"]
    return set(with_it["modules"]), set(without_it["modules"])


def test_the_start_imports_nothing_heavy_for_the_add_on(started):
    with_it, without_it = started
    assert "xihe_blender.addon" in with_it
    assert not (with_it - without_it) & HEAVY


def test_the_start_imports_no_package_of_others_for_the_add_on(started):
    with_it, without_it = started
    packages = {name.partition(".")[0] for name in with_it - without_it}
    assert packages - set(OURS) <= set(sys.stdlib_module_names)


def test_enabling_ten_times_leaves_nothing_behind(blender, tmp_path):
    facts = blender.facts("toggled.py", tmp_path / "facts.json", MODULE)
    before, enabled = facts["before"], facts["enabled"]
    assert facts["after"] == before
    assert all(times == enabled[0] for times in enabled)
    assert len(enabled[0]["commands"]) == 1 and before["commands"] == []


def test_the_command_is_known_while_the_add_on_is_enabled_and_not_without(blender, tmp_path):
    assert blender.xihe("--version").returncode == 0
    done = WholeBlender(tmp_path).xihe("--version")
    assert done.returncode != 0 and "xihe" in done.stdout + done.stderr
