"""The run from the panel, and how it is cancelled with the mouse."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.modal_job import ModalJob


class XIHE_OT_run(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.run"
    bl_label = "Run"
    bl_description = (
        "Move the phone along the camera path, estimate the light, apply it and compare it with ground truth"
    )
    # Not REGISTER: repeating the last operator would run all of it again, without a window to cancel it in.
    bl_options = {"UNDO"}
    cancelled = "The run was cancelled, and all that it made was deleted"
    conditions = (
        polls.is_idle,
        polls.is_room,
        polls.has_cycles,
        polls.is_in_object_mode,
        polls.has_virtual_objects,
        polls.has_camera,
    )

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, None]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.addon.runs_folder import new_run_folder
        from xihe_blender.addon.shown_run import run_and_show

        settings = previs_settings(context.scene)
        self.scene, self.folder = context.scene, new_run_folder(context.scene)
        return run_and_show(context.scene, self.folder, settings, wipe=context.scene.xihe.wipe)

    def finish(self, context: bpy.types.Context, result: None) -> set[str]:
        self.scene.xihe.run_folder = str(self.folder)
        self.report({"INFO"}, f"The run is finished: {self.folder}")
        return {"FINISHED"}


class XIHE_OT_cancel_run(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.cancel_run"
    bl_label = "Cancel"
    bl_description = "Stop the run after its current step and delete what it made; same as Esc"
    conditions = (polls.is_running,)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.xihe.is_cancel_wanted = True
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_run, XIHE_OT_cancel_run))
