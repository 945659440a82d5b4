"""What does the scene call for? The answer goes to the panel's list."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed


class XIHE_OT_plan_effects(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.plan_effects"
    bl_label = "Look at Scene"
    bl_description = "List the lighting and phone effects that the scene needs, and why; nothing is rendered"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles)

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


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_plan_effects,))
