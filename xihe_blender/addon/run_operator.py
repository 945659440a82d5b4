"""The run from the panel, how it is stopped with the mouse, and how it is taken up again."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.modal_job import ModalJob


class Following(ModalJob):
    """Base of the two operators whose job is a run: begun now, or taken up."""

    # Not REGISTER: repeating the last operator would run all of it again, without a window to cancel it in.
    bl_options = {"UNDO"}
    cancelled = "The run was stopped: Resume goes on with it"
    background: Any = None
    """The BackgroundRun; None for a run in this process. Blender looks up the types named here when it registers."""

    folder: Path

    def follow(self, context: bpy.types.Context, run: Any) -> Generator[Any, None, None]:
        """The job of the BackgroundRun `run`, which is remembered until its results are shown."""
        self.background, self.folder = run, run.folder
        context.window_manager.xihe.unshown_run = str(run.folder)
        job: Generator[Any, None, None] = run.follow()
        return job

    def stop(self) -> None:
        if self.background is not None:
            self.background.stop()

    def finish(self, context: bpy.types.Context, result: None) -> set[str]:
        run = self.background
        chosen = (context.scene if run is None else bpy.data.scenes[run.scene_name]).xihe
        chosen.run_folder, chosen.run_made_of = str(self.folder), ""
        if run is not None and run.is_edited:
            chosen.run_made_of = time.strftime("%H:%M", time.localtime(run.started))
        context.window_manager.xihe.unshown_run = ""
        self.report({"INFO"}, f"The run is finished: {self.folder}")
        return {"FINISHED"}


class XIHE_OT_run(polls.Conditional, Following, bpy.types.Operator):
    bl_idname = "xihe.run"
    bl_label = "Run"
    bl_description = (
        "Move the phone along the camera path, estimate the light, apply it and compare it with ground truth. "
        "A second Blender does it in the background, on a copy of this file"
    )
    conditions = (
        polls.is_idle,
        polls.is_room,
        polls.has_cycles,
        polls.is_in_object_mode,
        polls.has_virtual_objects,
        polls.has_camera,
    )

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, None]:
        # A script waits for the run anyway.
        self.works_here = not (self.is_modal and bpy.app.binary_path)
        return self._job(context.scene)

    def _job(self, scene: bpy.types.Scene) -> Generator[Any, None, None]:
        """A scene that cannot be run is refused before anything is written."""
        if not self.works_here:
            yield from imported("xihe_blender.addon.background_run")
        from xihe_blender.addon.background_run import saved_for_run
        from xihe_blender.addon.run_settings import choices_of_run, previs_settings
        from xihe_blender.addon.runs_folder import new_run_folder
        from xihe_blender.addon.shown_run import run_and_show
        from xihe_blender.jobs import Progress
        from xihe_blender.previs.plan import plan_previs

        settings = previs_settings(scene)
        plan_previs(scene, settings)
        self.folder = new_run_folder(scene)
        if not self.works_here:
            yield Progress(0, 1, "saving a copy of the file")
            run = saved_for_run(scene, self.folder, choices_of_run(scene))
            try:
                run.start()
            except OSError as error:
                self.report({"WARNING"}, f"No second Blender ({error.strerror}): this window waits while frames render")
                self.works_here = bpy.context.window_manager.xihe.works_here = True
            else:
                yield from self.follow(bpy.context, run)
                return
        yield from run_and_show(scene, self.folder, settings, wipe=scene.xihe.wipe)


class XIHE_OT_resume_run(polls.Conditional, Following, bpy.types.Operator):
    bl_idname = "xihe.resume_run"
    bl_label = "Resume"
    bl_description = "Go on with the last run of this file, which was left or stopped, and show its results"
    conditions = (polls.is_idle, polls.is_room, polls.has_unshown_run)

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, None]:
        self.works_here = False
        return self._job(Path(context.window_manager.xihe.unshown_run))

    def _job(self, folder: Path) -> Generator[Any, None, None]:
        yield from imported("xihe_blender.addon.background_run")
        from xihe_blender.addon.background_run import unshown_run

        run = unshown_run(folder)
        if not run.has_ended:
            run.start()
        yield from self.follow(bpy.context, run)


class XIHE_OT_discard_run(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.discard_run"
    bl_label = "Discard"
    bl_description = "Delete what the last run of this file, which was left or stopped, has made so far"
    conditions = (polls.is_idle, polls.has_unshown_run)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.background_run import discard

        discard(Path(context.window_manager.xihe.unshown_run))
        context.window_manager.xihe.unshown_run = ""
        return {"FINISHED"}


class XIHE_OT_cancel_run(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.cancel_run"
    bl_label = "Cancel"
    bl_description = "Stop what is under way; same as Esc. A stopped run can be resumed"
    conditions = (polls.is_running,)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.xihe.is_cancel_wanted = True
        return {"FINISHED"}


def imported(module: str) -> Generator[Any, None, None]:
    """Import `module`, and NumPy with it, in a thread: the window would stand still for a second."""
    from xihe_blender.jobs import Progress

    thread = threading.Thread(target=importlib.import_module, args=(module,))
    thread.start()
    while thread.is_alive():
        yield Progress(0, 1, "starting")


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_run, XIHE_OT_resume_run, XIHE_OT_discard_run, XIHE_OT_cancel_run)
)
