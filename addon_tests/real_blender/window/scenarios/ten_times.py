"""The add-on enabled and disabled ten times: what is left behind?"""

import bpy


def registered():
    """Everything of ours that Blender knows."""
    handlers = [name for name in dir(bpy.app.handlers) if isinstance(getattr(bpy.app.handlers, name), list)]
    return {
        "types": sorted(name for name in dir(bpy.types) if "xihe" in name.lower()),
        "operators": sorted(dir(bpy.ops.xihe)),
        "properties": [hasattr(bpy.types.Scene, "xihe"), hasattr(bpy.types.WindowManager, "xihe")],
        "handlers": {name: len(getattr(bpy.app.handlers, name)) for name in handlers},
    }


def scenario(w):
    from xihe_blender import addon

    w.facts["enabled"] = registered()
    yield from w.open_tab()
    for _ in range(10):
        addon.unregister()
        yield 0.2
        w.facts["disabled"] = registered()
        addon.register("xihe")
        w.area.tag_redraw()
        yield 0.3
    w.facts["enabled_again"] = registered()
    yield from w.open_tab()
    yield from w.picture("enabled_again")
    addon.unregister()
    w.area.tag_redraw()
    yield 1
    yield from w.picture("disabled")
