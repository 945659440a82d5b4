"""What Blender has of the add-on while it is enabled, what is left after that, what start-up costs, and the zip."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import bpy
import pytest
from addon_runs import PACKAGE, enable_preferences, registered_addon
from registered_things import OURS, registered, registered_classes
from tiny_scenes import empty_scene, saved

from xihe_blender import addon
from xihe_blender.addon import choices
from xihe_blender.addon.preferences import path_chosen, preferences
from xihe_blender.packaging.extension import build_extension, packed
from xihe_blender.previs.presets import DEFAULT, PRESETS
from xihe_blender.scene.state import WORKING
from xihenet import estimators
from xihenet.estimators import Target
from xihenet.light import LightChoice
from xihenet.phone import LINKS, profile_names
from xihenet.phone.metering import METERINGS
from xihenet.trigger import RULES

ROOT = Path(__file__).resolve().parents[2]
MOST_BYTES = 12_000_000
VALIDATOR = Path(bpy.utils.system_resource("SCRIPTS")) / "addons_core/bl_pkg/cli/blender_ext.py"
"""Blender's own, which comes with the bpy wheel."""


def our_properties():
    """(name, property) of all that our classes do not have of their bases."""
    bases = ("PropertyGroup", "AddonPreferences")
    kinds = [kind.bl_rna for base in bases for kind in registered_classes(base) if kind.__module__.startswith(OURS)]
    # The class of an operator has none of its own properties.
    for kind in [*kinds, *(getattr(bpy.ops.xihe, name).get_rna_type() for name in dir(bpy.ops.xihe))]:
        for prop in kind.properties:
            if prop.identifier not in kind.base.properties and prop.identifier != "rna_type":
                yield f"{kind.identifier}.{prop.identifier}", prop


def test_words_that_mean_something_else_in_blender_are_not_translated_as_that():
    with registered_addon():
        settings = bpy.context.scene.xihe.bl_rna.properties
        contexts = {settings[name].translation_context for name in ("estimator", "others", "metering")}
    # Nobody has translations for it.
    assert contexts == {"Xihe"}


@pytest.mark.slow
def test_on_and_off_twice_leaves_nothing_and_on_twice_is_refused():
    before = registered()
    for _ in range(2):
        with registered_addon():
            while_it_is = registered()
            with pytest.raises(ValueError, match="already registered"):
                addon.register(PACKAGE)
        assert not before["operators"] and while_it_is["handlers"] != before["handlers"]
        assert (
            len(while_it_is["classes"])
            > len(before["classes"]) + len(while_it_is["operators"])
            > len(before["classes"])
        )
        assert registered() == before
        assert not hasattr(bpy.types.Scene, "xihe") and not hasattr(bpy.types.WindowManager, "xihe")


def test_every_property_and_operator_says_what_it_is():
    with registered_addon():
        ours = dict(our_properties())
        assert {"XiheSceneSettings.seed", "XihePreferences.phone", "XIHE_OT_import_capture.up"} < set(ours)
        assert [name for name, prop in ours.items() if not prop.description] == []
        for name, prop in ours.items():
            if prop.type == "ENUM":
                assert all(item.description for item in prop.enum_items), name
        for name in dir(bpy.ops.xihe):
            said = getattr(bpy.ops.xihe, name).get_rna_type().description
            assert len(said) > 20 and not said.endswith("."), name


def test_the_lists_are_those_of_the_science():
    with registered_addon():
        scene = empty_scene()
        assert scene.xihe.estimator == choices.DEFAULT_ESTIMATOR == estimators.DEFAULT
        assert scene.xihe.phone == choices.DEFAULT_PHONE
        assert scene.xihe.preset == choices.DEFAULT_PRESET == DEFAULT
        for items, names in (
            (choices.LIGHT_PARTS, get_args(LightChoice)),
            (choices.TARGETS, get_args(Target)),
            (choices.METERINGS, [choices.PHONES_METERING, *METERINGS]),
        ):
            assert sorted(name for name, *_ in items) == sorted(names)
        for items, names in (
            (choices.estimator_items, estimators.names()),
            (choices.preset_items, list(PRESETS)),
            (choices.trigger_items, [*RULES, choices.USUAL_TRIGGER]),
            (choices.phone_items, [*profile_names(), choices.FROM_FILE]),
            (choices.network_items, [choices.NO_NETWORK, *LINKS]),
        ):
            given = items(None, None)
            assert [name for name, *_ in given] == names
            assert len({number for *_, number in given}) == len(given)
            assert all(description for _, _, description, *_ in given)
        for items, stored in ((choices.preset_items, ("accurate", 2)), (choices.trigger_items, ("USUAL", 4))):
            assert stored in [(name, number) for name, *_, number in items(None, None)], "as in files saved before"
        for name in estimators.names():
            scene.xihe.estimator = name
            assert scene.xihe.estimator == name
        several = [name for name in estimators.names() if name not in ("ambient", "truth")]
        scene.xihe.others = set(several)
        assert scene.xihe.others == set(several) and scene.xihe.bl_rna.properties["others"].is_enum_flag
        for name in profile_names():
            scene.xihe.phone = name
            assert scene.xihe.phone == name


def test_paths_of_the_preferences_hold_for_every_file(tmp_path):
    empty_scene()
    (tmp_path / "one").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "one" / "room.blend"))
    # Not the preferences themselves: from Blender 4.5 on they warn of such a path.
    user = SimpleNamespace(cache_folder="//../runs", phone_file="")
    path_chosen(user, bpy.context)
    assert (user.cache_folder, user.phone_file) == (str(tmp_path / "runs"), "")


def test_the_phone_of_the_preferences_is_that_of_scenes_without_one():
    with registered_addon():
        scene = empty_scene()
        assert preferences(bpy.context) is None, "there are none without an enabled add-on"
        user = enable_preferences()
        assert user == preferences(bpy.context)
        first, second = [name for name in profile_names() if name != choices.DEFAULT_PHONE][:2]
        user.phone = first
        assert scene.xihe.phone == first
        scene.xihe.phone = second
        assert scene.xihe.phone == second and user.phone == first


def test_a_file_that_was_saved_in_the_middle_of_a_run_opens_without_its_scenes(tmp_path):
    with registered_addon():
        scene = empty_scene()
        scene.copy()[WORKING] = True
        bpy.data.scenes[-1].use_extra_user = True
        bpy.context.window_manager.xihe.is_running = True
        middle = saved(tmp_path / "mid.blend")
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=str(middle), load_ui=False)
        assert [scene.name for scene in bpy.data.scenes] == ["Scene"]
        assert not bpy.context.window_manager.xihe.is_running


@pytest.mark.wheel_only(
    "starts a Python that has bpy as a module; real_blender/test_start_up.py asks it of a whole Blender"
)
def test_registering_imports_no_work_and_nothing_heavy():
    rooms = tuple(f"xihe_blender.{room}" for room in ("capture", "cli", "lab", "light_transport", "previs", "report"))
    without_numpy = ("xihenet.formats", "xihenet.io", "xihenet.io.json_files", "xihenet.io.whole_files")
    code = (
        "import sys, bpy; before = set(sys.modules); from xihe_blender import addon; addon.register('xihe_test');"
        "new = set(sys.modules) - before; addon.unregister();"
        "print(sorted(n for n in new if n.split('.')[0] in ('numpy', 'OpenEXR', 'torch')"
        f" or (n.startswith('xihenet.') and n not in {without_numpy})"
        f" or n.startswith({rooms})))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT, timeout=60
    )
    assert done.stdout.strip().splitlines()[-1] == "[]"


@pytest.mark.wheel_only("it is the wheel that does not end where something is registered")
def test_a_script_that_leaves_the_add_on_registered_ends():
    code = "import bpy; from xihe_blender import addon; addon.register('a')"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, timeout=60).returncode == 0


def validate(path):
    """Exit code and all that the validator says."""
    done = subprocess.run([sys.executable, VALIDATOR, "validate", path], capture_output=True, text=True, timeout=100)
    return done.returncode, done.stdout + done.stderr


def test_the_extension_is_small_and_blender_finds_nothing_wrong_with_it(tmp_path):
    extension = build_extension(tmp_path)
    code, said = validate(extension)
    assert code == 0 and "Success" in said, said
    assert extension.stat().st_size < MOST_BYTES


def test_blender_would_say_if_something_were_wrong(tmp_path):
    (tmp_path / "wrong.zip").write_bytes(packed({"__init__.py": b"", "blender_manifest.toml": b'id = "xihe"\n'}))
    code, said = validate(tmp_path / "wrong.zip")
    assert code != 0 and "missing" in said.lower(), said
