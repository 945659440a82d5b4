"""What Blender has of the add-on while it is enabled, what it has left after that, and what start-up costs."""

import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from addon_runs import PACKAGE, enable_preferences, registered_addon
from tiny_scenes import empty_scene

from xihe_blender import addon
from xihe_blender.addon import choices, leftovers
from xihe_blender.addon.preferences import preferences
from xihe_blender.capture.render import WORKING
from xihe_blender.previs.settings import PRESETS
from xihenet import estimators
from xihenet.phone import LINKS, profile_names

ROOT = Path(__file__).resolve().parents[2]
OPERATORS = {
    "add_virtual_objects", "remove_virtual_objects", "add_sphere_rig", "plan_effects", "measure_run", "run",
    "cancel_run", "apply_light", "remove_light", "go_to_trigger", "show_comparison", "open_report", "remove_old_runs",
    "calibrate",
}  # fmt: skip


def registered_things():
    """Everything of Blender's that an add-on can add to."""
    classes = {name for name in dir(bpy.types) if "xihe" in name.lower()}
    handlers = {
        f"{name} {handler!r}"
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
        for handler in getattr(bpy.app.handlers, name)
    }
    properties = {
        f"{kind.__name__}.{prop.identifier}"
        for kind in (bpy.types.Scene, bpy.types.WindowManager, bpy.types.Object)
        for prop in kind.bl_rna.properties
        if "xihe" in prop.identifier.lower()
    }
    return classes | handlers | properties | set(dir(bpy.ops.xihe))


def our_classes():
    return [getattr(bpy.types, name) for name in dir(bpy.types) if "xihe" in name.lower()]


def test_ten_times_on_and_off_leave_nothing():
    before = registered_things()
    for _ in range(10):
        with registered_addon():
            assert set(dir(bpy.ops.xihe)) >= OPERATORS
            assert len(registered_things()) > len(before) + len(OPERATORS)
        assert registered_things() == before
        assert not hasattr(bpy.types.Scene, "xihe") and not hasattr(bpy.types.WindowManager, "xihe")


def test_registering_twice_is_refused_and_leaves_the_first():
    before = registered_things()
    addon.register(PACKAGE)
    try:
        with pytest.raises(ValueError, match="already registered"):
            addon.register(PACKAGE)
    finally:
        addon.unregister()
    assert registered_things() == before


def test_every_property_and_operator_says_what_it_is():
    with registered_addon():
        silent = [
            f"{kind.__name__}.{prop.identifier}"
            for kind in our_classes()
            for prop in kind.bl_rna.properties
            if prop.identifier not in kind.bl_rna.base.properties and not prop.description
            if prop.identifier != "rna_type"
        ]
        assert silent == []
        unnamed = [
            f"{kind.__name__}.{prop.identifier}.{item.identifier}"
            for kind in our_classes()
            for prop in kind.bl_rna.properties
            if prop.type == "ENUM" and prop.identifier not in kind.bl_rna.base.properties
            for item in prop.enum_items
            if not item.description
        ]
        assert unnamed == []
        for name in OPERATORS:
            said = getattr(bpy.ops.xihe, name).get_rna_type().description
            assert len(said) > 20 and not said.endswith("."), name


def test_the_lists_are_those_of_the_science():
    with registered_addon():
        scene = empty_scene()
        assert scene.xihe.estimator == choices.DEFAULT_ESTIMATOR == estimators.DEFAULT
        assert scene.xihe.phone == choices.DEFAULT_PHONE
        assert [name for name, *_ in choices.PRESETS] == list(PRESETS)
        for items, names in (
            (choices.estimator_items, estimators.names()),
            (choices.phone_items, [*profile_names(), choices.FROM_FILE]),
            (choices.network_items, [choices.NO_NETWORK, *LINKS]),
        ):
            given = items(None, None)
            assert [name for name, *_ in given] == names
            assert len({number for *_, number in given}) == len(given)
            assert all(description for _, _, description, *_ in given)
        for name in estimators.names():
            scene.xihe.estimator = name
            assert scene.xihe.estimator == name
        for name in profile_names():
            scene.xihe.phone = name
            assert scene.xihe.phone == name


def test_the_phone_of_the_preferences_is_that_of_scenes_without_one():
    with registered_addon():
        scene = empty_scene()
        user = enable_preferences()
        first, second = [name for name in profile_names() if name != choices.DEFAULT_PHONE][:2]
        user.phone = first
        assert scene.xihe.phone == first
        scene.xihe.phone = second
        assert scene.xihe.phone == second and user.phone == first


def test_there_are_no_preferences_without_an_enabled_add_on():
    with registered_addon():
        assert preferences(bpy.context) is None
        assert enable_preferences() == preferences(bpy.context)


def test_a_working_scene_is_known_by_one_name():
    assert leftovers.WORKING == WORKING


def test_a_file_that_was_saved_in_the_middle_of_a_run_opens_without_its_scenes(tmp_path):
    with registered_addon():
        scene = empty_scene()
        scene.copy()[WORKING] = True
        bpy.data.scenes[-1].use_extra_user = True
        bpy.context.window_manager.xihe.is_running = True
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mid.blend"))
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mid.blend"), load_ui=False)
        assert [scene.name for scene in bpy.data.scenes] == ["Scene"]
        assert not bpy.context.window_manager.xihe.is_running


@pytest.mark.wheel_only(
    "starts a Python that has bpy as a module; real_blender/test_start_up.py asks it of a whole Blender"
)
def test_registering_imports_no_work_and_nothing_heavy():
    code = (
        "import sys, bpy; before = set(sys.modules); from xihe_blender import addon; addon.register('xihe_test');"
        "new = set(sys.modules) - before; addon.unregister();"
        "print(sorted(n for n in new if n.split('.')[0] in ('numpy', 'OpenEXR', 'torch')"
        " or (n.startswith('xihenet.') and n != 'xihenet.formats')"
        " or (n.startswith('xihe_blender.') and not n.startswith(('xihe_blender.addon', 'xihe_blender.errors')))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip().splitlines()[-1] == "[]"


@pytest.mark.wheel_only("it is the wheel that does not end where something is registered")
@pytest.mark.parametrize("is_unregistered", [True, False])
def test_a_script_that_registers_the_add_on_ends(is_unregistered):
    code = f"import bpy; from xihe_blender import addon; addon.register('a'); {is_unregistered} and addon.unregister()"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60).returncode == 0
