"""The last run's light: put onto the timeline again, or taken away with everything else that a run left."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed
from xihe_blender.addon.properties import last_run_folder


class XIHE_OT_apply_light(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.apply_light"
    bl_label = "Apply"
    bl_description = "Put the light of the last run onto the timeline again, with its triggers, errors and pictures"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, polls.has_cycles, polls.has_last_run)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.results_in_blender import apply_results
        from xihe_blender.io.run_results import read_results

        folder = last_run_folder(context.scene)
        try:
            apply_results(context.scene, read_results(folder), folder, wipe=context.scene.xihe.wipe)
        except FAILURES as error:
            return failed(self, context, error)
        return {"FINISHED"}


class XIHE_OT_remove_light(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.remove_light"
    bl_label = "Remove"
    bl_description = "Delete everything that runs added to this file: worlds, markers, curves and pictures"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, polls.has_light)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.results_in_blender import remove_everything

        remove_everything(context.scene)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_apply_light, XIHE_OT_remove_light))
