"""The add-on registered for a test, with preferences, and a run from its panel on the tiny room."""

import contextlib

import bpy
from previs_runs import walk

from xihe_blender import addon

PACKAGE = "xihe_test"


@contextlib.contextmanager
def registered_addon(runs_folder=None):
    """The add-on as Blender has it when it is enabled; runs go to `runs_folder`. Gone afterwards."""
    addon.register(PACKAGE)
    entry = bpy.context.preferences.addons.new()
    entry.module = PACKAGE
    if runs_folder is not None:
        entry.preferences.cache_folder = str(runs_folder)
    try:
        yield
    finally:
        bpy.context.preferences.addons.remove(entry)
        addon.unregister()


def walk_for_the_panel(**settings):
    """`walk`, with the settings of a small run in the panel."""
    scene = walk()
    chosen = scene.xihe
    chosen.preset, chosen.use_own_size, chosen.size = "draft", True, (32, 24)
    for name, value in settings.items():
        setattr(chosen, name, value)
    return scene


def poll_message(operator):
    """What a grey button says; empty if it is not grey, without running the operator."""
    if operator.poll():
        return ""
    try:
        operator()
    except RuntimeError as error:
        return str(error).split("poll()", 1)[1].strip()
    raise AssertionError("poll said no, and the operator ran")
