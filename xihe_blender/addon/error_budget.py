"""The error budget in the panel: one button that measures it, and below it a bar for each part of the active object."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from xihe_blender.addon.background_run import COMMAND
from xihe_blender.addon.modal_job import edge_server_asked
from xihe_blender.addon.panels import StagePanel, sentence
from xihe_blender.addon.planning_operators import Measuring, known_times
from xihe_blender.addon.runs_folder import found_folder, last_budget, new_run_folder
from xihe_blender.jobs import Job

if TYPE_CHECKING:
    from xihe_blender.io.budget_results import BudgetPart, BudgetResults, ObjectBudget

NAME_SHARE = 0.5


class XIHE_OT_measure_budget(Measuring, bpy.types.Operator):
    bl_idname = "xihe.measure_budget"
    bl_label = "What Would Help?"
    bl_description = (
        "Capture the camera path, and make each part of the chain perfect in turn, to find out what the error of each "
        "virtual object comes from. This window waits while frames render"
    )

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        return _budget_in_new_folder(context.scene)

    def finish(self, context: bpy.types.Context, result: tuple[Path, BudgetResults]) -> set[str]:
        folder, budget = result
        self.scene.xihe.budget_folder = str(folder)
        for item in budget.objects:
            self.report({"INFO"}, item.advice)
        return {"FINISHED"}


def _budget_in_new_folder(scene: bpy.types.Scene) -> Job[tuple[Path, BudgetResults]]:
    """A job: the folder of a budget by the panel's settings, and the budget. What is stopped leaves no folder."""
    from xihe_blender.addon.run_settings import previs_settings
    from xihe_blender.previs.error_budget import error_budget

    settings = previs_settings(scene)
    yield from edge_server_asked(settings)
    folder = new_run_folder(scene)
    try:
        budget = yield from error_budget(scene, folder, settings, command=COMMAND)
    finally:
        if not (folder / "budget.json").exists():
            shutil.rmtree(folder, ignore_errors=True)
    return folder, budget


class XIHE_PT_error_budget(StagePanel, bpy.types.Panel):
    bl_label = "What Would Help?"
    bl_parent_id = "XIHE_PT_results"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, folder = self.layout, context.scene.xihe.budget_folder
        budget = last_budget(folder)
        takes = known_times(context)[1] or "longer than a run: press How Long? to know"
        if budget is None:
            sentence(context, layout, "Find out what the error of each object comes from, and what would help most:")
            layout.operator("xihe.measure_budget", text="Measure", icon="SORTTIME")
            sentence(context, layout, f"It takes {takes}")
            return
        item = shown_object(budget, "" if context.object is None else context.object.name)
        sentence(context, layout, item.advice)
        column = layout.column(align=True)
        for name, share, said in budget_rows(item):
            split = column.split(factor=NAME_SHARE)
            split.label(text=name, translate=False)
            split.progress(factor=share, type="BAR", text=said)
        row = layout.row(align=True)
        row.operator("xihe.measure_budget", text="Measure Again", icon="FILE_REFRESH")
        row.operator("wm.path_open", text="", icon="FILE_TEXT").filepath = str(found_folder(folder) / "report.html")
        sentence(context, layout, f"It takes {takes}")


def shown_object(budget: BudgetResults, active: str) -> ObjectBudget:
    """That of the active object, or of the first."""
    return next((item for item in budget.objects if item.name == active), budget.objects[0])


def budget_rows(item: ObjectBudget) -> list[tuple[str, float, str]]:
    """Part, share of the error that a perfect one would take off, 0 to 1, and that in words; the largest first.

    A part that may help or harm has no bar; an object that was never in view, or that no light reaches, has no row.
    """
    from xihe_blender.io.budget_results import PARTS

    parts = item.largest_first if item.brightness else ()
    return [(PARTS[part.name].label, *_bar(part, item.error or 0.0)) for part in parts]


def _bar(part: BudgetPart, error: float) -> tuple[float, str]:
    share = part.gain / error if error else 0.0
    if not part.is_certain:
        return 0.0, "not certain"
    return min(1.0, max(0.0, share)), f"{share:.0%} off" if share >= 0 else f"{-share:.0%} more"


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_measure_budget, XIHE_PT_error_budget))
