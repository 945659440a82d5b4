"""What came out of the last run: triggers on the timeline, pictures beside the truth, the report."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed


class XIHE_OT_go_to_trigger(bpy.types.Operator):
    bl_idname = "xihe.go_to_trigger"
    bl_label = "Go to Trigger"
    bl_description = "Go to the frame of the previous or next trigger, and show its light and comparison"
    bl_options = {"REGISTER", "UNDO"}

    direction: bpy.props.EnumProperty(
        name="Direction",
        description="Which trigger, seen from the current frame",
        items=(
            ("PREVIOUS", "Previous", "The last trigger before the current frame"),
            ("NEXT", "Next", "The first trigger after the current frame"),
        ),
        default="NEXT",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return polls.is_possible(cls, context, polls.is_idle, polls.is_own_scene, polls.has_triggers)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.results_in_blender import go_to_trigger

        try:
            found = go_to_trigger(context.scene, self.direction)
        except FAILURES as error:
            return failed(self, context, error)
        if found is None:
            where = "before" if self.direction == "PREVIOUS" else "after"
            self.report({"INFO"}, f"There is no trigger {where} frame {context.scene.frame_current}")
            return {"CANCELLED"}
        return {"FINISHED"}


class XIHE_OT_show_comparison(bpy.types.Operator):
    bl_idname = "xihe.show_comparison"
    bl_label = "Show Comparison"
    bl_description = "Show the estimate beside the ground truth in an Image Editor, at the compared frame nearest by"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return polls.is_possible(
            cls, context, polls.is_idle, polls.is_own_scene, polls.has_last_run, polls.has_comparison
        )

    def execute(self, context: bpy.types.Context) -> set[str]:
        return {"CANCELLED"}


class XIHE_OT_open_report(bpy.types.Operator):
    bl_idname = "xihe.open_report"
    bl_label = "Open Report"
    bl_description = "Open the last run's report in the web browser"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return polls.is_possible(cls, context, polls.has_last_run, polls.has_report)

    def execute(self, context: bpy.types.Context) -> set[str]:
        bpy.ops.wm.url_open(url=polls.last_run_folder(context.scene).joinpath("report.html").resolve().as_uri())
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_go_to_trigger, XIHE_OT_show_comparison, XIHE_OT_open_report)
)
