"""What does a run cost on the user's machine? Found out by small renders, and only when asked for."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.calibration import calibration_file
from xihe_blender.addon.modal_job import ModalJob


class Measuring(polls.Conditional, ModalJob):
    """Base of operators that render a few pictures of the scene as a run would, and keep what that took."""

    bl_options = {"REGISTER"}
    cancelled = "Nothing was measured"
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles, polls.has_virtual_objects, polls.has_camera)


class XIHE_OT_measure_run(Measuring, bpy.types.Operator):
    bl_idname = "xihe.measure_run"
    bl_label = "Estimate Time"
    bl_description = "Render a few small pictures to find out how long a run would take on this machine"

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.previs.run_time import run_time_job

        return run_time_job(context.scene, previs_settings(context.scene))

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.previs.run_time import format_run_time

        context.window_manager.xihe.run_estimate = format_run_time(result.total_s)
        return {"FINISHED"}


class XIHE_OT_calibrate(Measuring, bpy.types.Operator):
    bl_idname = "xihe.calibrate"
    bl_label = "Calibrate"
    bl_description = "Render a few small pictures of this scene to find out what each preset costs on this machine"

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.lab.frontier.calibrate import calibrate

        return calibrate(context.scene, previs_settings(context.scene))

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.lab.frontier.calibrate import format_calibration, save_calibration

        save_calibration(calibration_file(), result)
        self.report({"INFO"}, format_calibration(result))
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_measure_run, XIHE_OT_calibrate))
