"""The add-on's preferences, with three runs on disk of which one is shown: the others are removed, after asking.

Needs the installed add-on: Blender shows preferences of no other.
"""

import sys

import addon_utils
import bpy

NAMES = [f"room_2026010{day}-101500" for day in (1, 2, 3)]


def make_runs(folder):
    for name in NAMES:
        work = folder / name / "work"
        work.mkdir(parents=True)
        (work / "settings.json").write_bytes(b" " * 3_400_000)
        (work.parent / "results.json").write_text("{}")


def scenario(w):
    module = next(name for name in sys.modules if name.startswith("bl_ext.") and name.endswith(".xihe"))
    addon_utils.enable(module, default_set=True)
    runs = w.out / "runs"
    make_runs(runs)
    bpy.context.preferences.addons[module].preferences.cache_folder = str(runs)
    bpy.context.scene.xihe.run_folder = str(runs / NAMES[0])
    with bpy.context.temp_override(window=w.window):
        bpy.ops.preferences.addon_show(module=module)
    yield 2
    window = bpy.context.window_manager.windows[-1]
    w.move(window.x + window.width / 2, window.y + window.height / 2)
    yield from w.picture("preferences")
    with bpy.context.temp_override(window=window):
        bpy.ops.xihe.remove_old_runs("INVOKE_DEFAULT")
    yield 1
    yield from w.picture("asked")
    w.facts["kept_while_asking"] = sorted(path.name for path in runs.iterdir())
    w.press("Return")
    yield from w.wait_until(lambda: len(list(runs.iterdir())) < len(NAMES), "old runs are removed", at_most_s=30)
    yield 1
    w.facts["kept"] = sorted(path.name for path in runs.iterdir())
    yield from w.picture("removed")
