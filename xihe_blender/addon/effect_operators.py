"""What does the scene call for, and how long would a run take?"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed
from xihe_blender.addon.modal_job import ModalJob


class XIHE_OT_plan_effects(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.plan_effects"
    bl_label = "Look at Scene"
    bl_description = "Find out which effects of light and phone the scene calls for, and why; nothing is rendered"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, polls.has_cycles)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.run_settings import planned_rows

        try:
            rows = planned_rows(context.scene)
        except FAILURES as error:
            return failed(self, context, error)
        effects = context.scene.xihe.effects
        effects.clear()
        for row in rows:
            added = effects.add()
            for name, value in row.items():
                setattr(added, name, value)
        return {"FINISHED"}


class XIHE_OT_measure_run(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.measure_run"
    bl_label = "Estimate Time"
    bl_description = "Render a few small pictures to find out how long a run would take on this machine"
    bl_options = {"REGISTER"}
    cancelled = "Nothing was measured"
    conditions = (polls.is_idle, polls.has_cycles, polls.has_virtual_objects, polls.has_camera)

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.run_time import run_time_job

        return run_time_job(context.scene, previs_settings(context.scene))

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.run_time import said_of_run_time

        context.window_manager.xihe.run_estimate = said_of_run_time(result.total_s)
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_plan_effects, XIHE_OT_measure_run))
