"""What is registered in this Blender that an add-on may have brought. Imported with nothing but Blender around.

Blender has no list of timers and of what draws in the viewport: what the add-on has of these is not seen here.
"""

import gc
import sys
from pathlib import Path

import bpy

BASES = (
    "AddonPreferences", "AssetShelf", "FileHandler", "Gizmo", "GizmoGroup", "Header", "KeyingSetInfo", "Menu", "Node",
    "NodeSocket", "NodeTree", "Operator", "Panel", "PropertyGroup", "RenderEngine", "UIList",
)  # fmt: skip
OURS = ("xihe_blender", "xihenet", "bl_ext.user_default.xihe")


def registered():
    """All that an add-on can leave behind and Blender can list."""
    gc.collect()
    return {
        "classes": sorted(f"{c.__module__}.{c.__name__}" for base in BASES for c in registered_classes(base)),
        "properties": sorted(f"{name}.{key}" for name in dir(bpy.types) for key in properties(name)),
        "operators": dir(bpy.ops.xihe),
        "handlers": sorted(
            f"{name} {one.__module__}.{one.__qualname__}"
            for name in dir(bpy.app.handlers)
            if isinstance(getattr(bpy.app.handlers, name), list)
            for one in getattr(bpy.app.handlers, name)
        ),
        "drawn": sorted(
            f"{name} {draw.__module__}.{draw.__qualname__}"
            for name in dir(bpy.types)
            for draw in getattr(getattr(getattr(bpy.types, name), "draw", None), "_draw_funcs", ())
            if draw.__module__.startswith(OURS)
        ),
        "keys": sorted(
            f"{keymap.name} {item.idname}"
            for keymap in bpy.context.window_manager.keyconfigs.addon.keymaps
            for item in keymap.keymap_items
        ),
        "commands": commands(),
        "paths": [path for path in sys.path if "xihe" in Path(path).name],
    }


def registered_classes(base):
    waiting, found = list(filter(None, [getattr(bpy.types, base, None)])), []
    while waiting:
        below = waiting.pop().__subclasses__()
        waiting += below
        # Those of bpy.types are Blender's own, and come into being when someone looks at them.
        found += [one for one in below if getattr(one, "is_registered", False) and one.__module__ != "bpy.types"]
    return found


def properties(name):
    rna = getattr(getattr(bpy.types, name), "bl_rna", None)
    return () if rna is None else rna.properties.keys()


def commands():
    """One word for each handle of a command that the add-on keeps. Blender has no list of them."""
    module = sys.modules.get("xihe_blender.addon.command")
    return [] if module is None else ["xihe" for _ in module._handles]
