"""Planning from the panel: what does a run simulate, and what does it cost on the user's machine?"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.modal_job import ModalJob, edge_server_asked
from xihe_blender.addon.preferences import chosen_folder, own_folder
from xihe_blender.jobs import Job
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.io.json_files import read_json

OF_TIME = (
    "estimator",
    "others",
    "preset",
    "target",
    "light",
    "captures_path",
    "phone",
    "phone_file",
    "network",
    "use_own_size",
    "size",
    "use_own_exposure",
    "exposure",
    "metering",
    "use_own_frames",
    "frame_start",
    "frame_end",
    "frame_step",
)
"""Settings on which the time of a run depends."""


class XIHE_OT_plan_effects(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.plan_effects"
    bl_label = "Plan Effects"
    bl_description = "List the lighting and phone effects that the scene needs, and why; nothing is rendered"
    bl_options = {"REGISTER", "UNDO"}
    cancelled = "Nothing was planned"
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles)

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        from xihe_blender.addon.run_settings import required_effects

        return required_effects(context.scene)

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.light_transport.overrides import remembered_overrides

        rows, remembered = self.scene.xihe.effects, remembered_overrides(self.scene)
        rows.clear()
        for name, effect in result.items():
            row = rows.add()
            row.name, row.required, row.reason = name, effect.state, effect.reason
            row.is_switchable, row.override = effect.is_switchable, remembered.get(name, "auto").upper()
        return {"FINISHED"}


def timed(scene: bpy.types.Scene) -> str:
    """What the time of a run depends on, to be compared with what it was when the time was measured."""
    chosen = [getattr(scene.xihe, name) for name in OF_TIME]
    values = [
        sorted(value) if isinstance(value, set) else list(value) if hasattr(value, "__len__") else value
        for value in chosen
    ]
    names = [item.name for item in virtual_objects(scene)]
    switched = [(row.name, row.override) for row in scene.xihe.effects if row.override != "AUTO"]
    return repr([scene.name, scene.frame_start, scene.frame_end, scene.frame_step, names, values, switched])


def known_times(context: bpy.types.Context) -> tuple[str, str]:
    """How long a run and an error budget would take; empty if that was not measured as scene and settings are now."""
    state = context.window_manager.xihe
    is_known = state.timed and state.timed == timed(context.scene)
    return (state.run_estimate, state.budget_estimate) if is_known else ("", "")


class Measuring(polls.Conditional, ModalJob):
    """Base of operators that render a few pictures of the scene as a run would, and keep what that took."""

    bl_options = {"REGISTER"}
    cancelled = "Nothing was measured"
    conditions = (
        polls.is_idle,
        polls.is_room,
        polls.has_cycles,
        polls.captures_are_rendered,
        polls.has_virtual_objects,
        polls.has_camera,
    )


class XIHE_OT_measure_run(Measuring, bpy.types.Operator):
    bl_idname = "xihe.measure_run"
    bl_label = "How Long?"
    bl_description = (
        "Render a few small pictures to find out how long a run, and Measure below, would take on this machine"
    )

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.previs.run_time import run_time_job

        self.timed, settings = timed(context.scene), previs_settings(context.scene)

        def job() -> Job[Any]:
            yield from edge_server_asked(settings)
            return (yield from run_time_job(self.scene, settings))

        return job()

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.previs.run_time import format_run_time

        state = context.window_manager.xihe
        state.run_estimate, state.budget_estimate = (format_run_time(one.total_s) for one in result)
        state.timed = self.timed
        return {"FINISHED"}


def calibration_file() -> Path:
    """Where the costs of the presets are remembered, for all files: in the user's Runs Folder, or the extension's own.

    Not in Blender's preferences: those are saved when the user says so.
    """
    return (chosen_folder() or own_folder()) / "calibration.json"


def calibration_line() -> str:
    """The costs in one sentence; empty before they were measured. Read at every redraw: a few hundred bytes."""
    try:
        return str(read_json(calibration_file())["said"])
    except (OSError, KeyError, TypeError, ValueError):
        return ""


class XIHE_OT_calibrate(Measuring, bpy.types.Operator):
    bl_idname = "xihe.calibrate"
    bl_label = "Calibrate"
    bl_description = (
        "Render a few small pictures of this scene to find out what capturing a frame takes at each Quality on this "
        "machine. Compared pictures take most of a run: How Long? counts them too"
    )

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.previs.run_time import calibrate

        return calibrate(context.scene, previs_settings(context.scene))

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.previs.run_time import format_calibration, save_calibration

        save_calibration(calibration_file(), result)
        self.report({"INFO"}, format_calibration(result))
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_plan_effects, XIHE_OT_measure_run, XIHE_OT_calibrate)
)
