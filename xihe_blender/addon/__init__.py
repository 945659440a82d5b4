"""The add-on's registration: these modules, in this order, and gone again in reverse.

The extension's `__init__.py` calls `register(__package__)`. Nothing that is imported for it imports NumPy, OpenEXR or
torch: operators import what needs these when they run, so that Blender starts as fast with the add-on as without.
"""

from __future__ import annotations

import atexit
import importlib
from types import ModuleType
from typing import Any

import bpy

MODULES = (
    "properties",
    "preferences",
    "leftovers",
    "object_operators",
    "capture_operators",
    "planning_operators",
    "look_operators",
    "run_operators",
    "result_operators",
    "light_operators",
    "live_light",
    "panels",
    "placement_map",
    "error_budget",
    "overlay",
    "comparison_view",
    "command",
)
IN_A_WINDOW = ("live_light", "overlay", "comparison_view")
"""Modules whose handlers wait for what a user does."""


def register(package: str) -> None:
    """Register everything; `package` is the name by which Blender knows the add-on, for its preferences."""
    modules = _modules()
    importlib.import_module(f"{__name__}.preferences").XihePreferences.bl_idname = package
    for index, module in enumerate(modules):
        try:
            module.register()
        except Exception:
            _unregister(modules[:index])
            raise
        for handlers, called in _handlers(module):
            handlers.append(called)
    if getattr(bpy.app, "module", False):
        # The wheel of Blender 4.5 never ends where something is still registered.
        atexit.register(unregister)


def unregister() -> None:
    """Take everything away that `register` made; what is under way ends in this window."""
    atexit.unregister(unregister)
    run_under_way = importlib.import_module(f"{__name__}.modal_job").RunUnderWay.current
    if run_under_way is not None:
        run_under_way.end()
    _unregister(_modules())


def _modules() -> list[ModuleType]:
    return [importlib.import_module(f"{__name__}.{name}") for name in MODULES]


def _handlers(module: ModuleType) -> list[tuple[list[Any], Any]]:
    """The HANDLERS of a module, by name of the list of `bpy.app.handlers` that each belongs into."""
    is_wanted = not bpy.app.background or module.__name__.rpartition(".")[2] not in IN_A_WINDOW
    wanted = getattr(module, "HANDLERS", {}) if is_wanted else {}
    return [(getattr(bpy.app.handlers, name), called) for name, called in wanted.items()]


def _unregister(modules: list[ModuleType]) -> None:
    for module in reversed(modules):
        for handlers, called in _handlers(module):
            handlers.remove(called)
        module.unregister()
