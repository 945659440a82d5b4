"""The run from the panel: one job, driven a step per timer tick in a window, and to its end in background."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls


class XIHE_OT_run(bpy.types.Operator):
    bl_idname = "xihe.run"
    bl_label = "Run"
    bl_description = "Walk the phone along the camera path, estimate the light, compare it with the truth, and apply it"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return polls.is_possible(
            cls,
            context,
            polls.is_idle,
            polls.is_own_scene,
            polls.has_cycles,
            polls.is_in_object_mode,
            polls.has_virtual_objects,
            polls.has_camera,
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        return {"CANCELLED"}


class XIHE_OT_cancel_run(bpy.types.Operator):
    bl_idname = "xihe.cancel_run"
    bl_label = "Cancel"
    bl_description = "End the run under way at its next step, and leave nothing of it; the same as Esc"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return polls.is_possible(cls, context, polls.is_running)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.xihe.is_cancel_wanted = True
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_run, XIHE_OT_cancel_run))
