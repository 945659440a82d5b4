"""Runs of which nothing is shown any more, removed from disk."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed
from xihenet.formats import format_count


class XIHE_OT_remove_old_runs(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.remove_old_runs"
    bl_label = "Remove Old Runs"
    bl_description = (
        "Delete the folders of all runs from the panel but those that the open file shows. "
        "Light on the timeline and pictures stay in the files they were saved in"
    )
    conditions = (polls.is_idle, polls.has_old_runs)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first: what is deleted does not come back by Undo."""
        from xihe_blender.addon.preferences import runs_folder
        from xihe_blender.addon.runs_folder import shown_runs
        from xihe_blender.io.old_runs import format_old_runs, old_runs

        runs = format_old_runs(old_runs(runs_folder(), shown_runs()))
        answer: set[str] = context.window_manager.invoke_confirm(
            self, event, title=f"Delete {runs}?", message="This cannot be undone", confirm_text="Delete", icon="WARNING"
        )
        return answer

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.preferences import runs_folder
        from xihe_blender.addon.runs_folder import shown_runs
        from xihe_blender.io.old_runs import remove_old_runs

        try:
            removed = remove_old_runs(runs_folder(), shown_runs())
        except FAILURES as error:
            return failed(self, context, error)
        # Blender draws its preferences anew only when one of them changes.
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "PREFERENCES":
                    area.tag_redraw()
        self.report({"INFO"}, f"Removed {format_count(len(removed), 'old run')}")
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_remove_old_runs,))
