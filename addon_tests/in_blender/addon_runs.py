"""The add-on registered for a test, with preferences, and a run from its panel on the tiny room."""

import contextlib
import shutil

import bpy
import pytest
from previs_runs import QuickPrevis, run, walk
from tiny_scenes import saved

from xihe_blender import addon

PACKAGE = "xihe_test"


@contextlib.contextmanager
def registered_addon():
    """The add-on, registered as Blender does it, and gone afterwards."""
    addon.register(PACKAGE)
    try:
        yield
    finally:
        _disable_preferences()
        addon.unregister()


def _disable_preferences():
    addons = bpy.context.preferences.addons
    for entry in [entry for entry in addons if entry.module == PACKAGE]:
        addons.remove(entry)


def enable_preferences():
    """The add-on's preferences, as they are at first, once it is enabled."""
    _disable_preferences()
    entry = bpy.context.preferences.addons.new()
    entry.module = PACKAGE
    return entry.preferences


@contextlib.contextmanager
def small_panel_runs():
    """What is started from the panel renders as little as `QuickPrevis`."""
    from xihe_blender.previs import settings

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings, "PrevisSettings", QuickPrevis)
        yield


def walk_for_the_panel(runs_folder, **settings):
    """`walk`, with the settings of a small run in the panel; runs go to `runs_folder`."""
    scene = walk()
    enable_preferences().cache_folder = str(runs_folder)
    chosen = scene.xihe
    chosen.preset, chosen.use_own_size, chosen.size = "draft", True, (32, 24)
    for name, value in settings.items():
        setattr(chosen, name, value)
    return scene


def lit_walk(out, settings=None, *, finished=None):
    """`out`, with a run of `walk` or a copy of one; its `after.blend` shows the light. For a registered add-on."""
    from xihe_blender.addon.results_in_blender import apply_results, show_results

    scene = walk()
    if finished is None:
        run(scene, out, settings)
        show_results(scene, out)
    else:
        shutil.copytree(finished.outputs.folder, out)
        apply_results(scene, out)
    scene.xihe.run_folder = str(out)
    saved(out / "after.blend")
    return out


def poll_message(operator):
    """What a grey button says; empty if it is not grey, without running the operator."""
    if operator.poll():
        return ""
    try:
        operator()
    except RuntimeError as error:
        return str(error).split("poll()", 1)[1].strip()
    raise AssertionError("poll said no, and the operator ran")
