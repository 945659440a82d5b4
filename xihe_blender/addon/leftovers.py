"""Leftovers of a run under way, which must not come back: by Undo, or from a file saved meanwhile.

Working scenes are the file's own data while a run lasts. Where one was kept in a step of Undo or in a file, it goes as
soon as it is back. An Undo in the middle of a run ends the run, since it takes the run's scenes away.
"""

from __future__ import annotations

import contextlib
from typing import Any

import bpy

from xihe_blender.addon.background_run import newest_run
from xihe_blender.addon.runs_folder import last_part, last_run
from xihe_blender.apply.datablocks import OF_RUN, RUN_BESIDE, lit_scene, remove_lit_collections
from xihe_blender.errors import UserError
from xihe_blender.scene.blend_file import ROOM
from xihe_blender.scene.state import WORKING, evaluate_pending, layers_of, remove_copied_scene


def remove_working_scenes() -> None:
    """Remove every working scene of a run that is over, and what only that used."""
    for scene in [scene for scene in bpy.data.scenes if WORKING in scene]:
        remove_copied_scene(scene)
    remove_lit_collections()


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    job = bpy.context.window_manager.xihe
    if job.is_running and job.works_here:
        job.is_cancel_wanted = True
    else:
        remove_working_scenes()
    _evaluate_unseen()


def _evaluate_unseen() -> None:
    """Bring the scene `Xihe Lit` and its room up to date, whichever of them no window shows.

    Blender 4.3 looks once a minute through all scenes for what it need not keep drawn, and crashes on instances that
    Undo has left without evaluated objects. A scene that is shown is left to Blender, which evaluates it next: hair in
    both scenes belongs to the one that was evaluated last, and crashes Blender where the other one is shown. So does
    evaluating its other view layers after an Undo of Remove Light.
    """
    lit = lit_scene()
    shown = {None} | {window.scene for manager in bpy.data.window_managers for window in manager.windows}
    evaluate_pending(layers_of({lit, lit and lit.get(ROOM)} - shown))


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    # What was followed is left alone now; a file that was saved meanwhile says otherwise.
    job = bpy.context.window_manager.xihe
    job.is_running = job.is_cancel_wanted = False
    job.doing = job.error = job.ended_in = job.run_estimate = job.budget_estimate = ""
    job.progress = job.seconds_left = 0.0
    _look_for_run()
    remove_working_scenes()


def _look_for_run() -> None:
    """Have the panel offer the run that was left when the file was closed, or the add-on switched off.

    And one that has ended, if the file was closed without saving: see `properties._unshown_run`.
    """
    _show_run_beside()
    # Runs of a scene that is linked are another file's.
    begun = [scene.xihe.begun_run for scene in bpy.data.scenes if scene.library is None]
    bpy.context.window_manager.xihe.newest_run = str(newest_run(bpy.data.filepath, begun) or "")


def _show_run_beside() -> None:
    """Have the lit file of a run show that run, and its settings, when it is opened for the first time."""
    lit = lit_scene()
    if lit is None or RUN_BESIDE not in lit:
        return
    folder = bpy.path.abspath(lit.pop(RUN_BESIDE))  # The file may be saved elsewhere.
    lit[OF_RUN] = last_part(folder)
    for scene in filter(None, (lit, lit[ROOM])):
        scene.xihe.run_folder, scene.xihe.run_made_of, scene.xihe.begun_run = folder, "", ""
    room, run = lit[ROOM], last_run(folder)
    if room is not None and run is not None:
        from xihe_blender.addon.run_settings import choose_as_run

        with contextlib.suppress(UserError):
            choose_as_run(room, run)


HANDLERS = {"undo_post": _after_undo, "redo_post": _after_undo, "load_post": _after_load}


def register() -> None:
    # Once data can be reached; where a file is loaded before, `_after_load` does it.
    bpy.app.timers.register(_look_for_run, first_interval=0.0)


def unregister() -> None:
    if bpy.app.timers.is_registered(_look_for_run):
        bpy.app.timers.unregister(_look_for_run)
