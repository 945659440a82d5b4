"""The run from the panel: one job, driven a step per timer tick in a window, and to its end in background."""

from __future__ import annotations

import time
from collections.abc import Generator
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import FAILURES, failed
from xihe_blender.addon.run_under_way import RunUnderWay

UNDO_KEYS = {"Z", "Y"}
NO_INPUT = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE", "NONE"}
TICK_S = 0.02
QUIET_S = 0.3
"""A step blocks the window for a frame's renders, so it waits until the user has not touched anything for so long."""

LONGEST_WAIT_S = 1.0
"""But no longer than this: some add-ons listen to the window all the time."""


class XIHE_OT_run(bpy.types.Operator):
    bl_idname = "xihe.run"
    bl_label = "Run"
    bl_description = "Walk the phone along the camera path, estimate the light, compare it with the truth, and apply it"
    # Not REGISTER: repeating the last operator would run all of it again, without a window to cancel it in.
    bl_options = {"UNDO"}

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

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the run and come back to it a step at a time."""
        if bpy.app.background:
            return self.execute(context)
        try:
            self.run = RunUnderWay(context, self._job(context))
            # What is wrong with the scene shows at once; and a job that has begun cleans up when it is closed.
            self.run.step()
        except FAILURES as error:
            return failed(self, context, error)
        self.input_at = self.stepped_at = time.perf_counter()
        self.run.timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":
            context.window_manager.xihe.is_cancel_wanted = True
        if context.window_manager.xihe.is_cancel_wanted:
            self.run.end()
            self.report({"INFO"}, "The run was cancelled; nothing of it is left")
            return {"CANCELLED"}
        if event.type == "TIMER":
            return {"RUNNING_MODAL"} if self._is_users_turn(context) else self._step(context)
        if event.type not in NO_INPUT:
            self.input_at = time.perf_counter()
        if event.type == "F12" or (event.type in UNDO_KEYS and (event.ctrl or event.oskey)):
            # Undo would take away the scenes that the run works in; a render would get in its way.
            return {"RUNNING_MODAL"}
        return {"PASS_THROUGH"}

    def _is_users_turn(self, context: bpy.types.Context) -> bool:
        """Whether the user is busy, as while the view is turned: then the run waits a little."""
        now = time.perf_counter()
        if now - self.stepped_at > LONGEST_WAIT_S:
            return False
        return now - self.input_at < QUIET_S or len(context.window.modal_operators) > 1

    def _step(self, context: bpy.types.Context) -> set[str]:
        try:
            is_done = self.run.step()
        except FAILURES as error:
            return failed(self, context, error)
        self.stepped_at = time.perf_counter()
        if not is_done:
            return {"RUNNING_MODAL"}
        return self._done(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """The whole run, and only then back: for background."""
        from xihe_blender.jobs import run_blocking

        try:
            self.run = RunUnderWay(context, self._job(context))
            try:
                run_blocking(self.run.job, self.run.show)
            finally:
                self.run.end()
        except FAILURES as error:
            return failed(self, context, error)
        return self._done(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender itself ends the operator: another file is loaded, or the window is closed."""
        self.run.end()

    def _job(self, context: bpy.types.Context) -> Generator[Any, None, dict[str, Any]]:
        from xihe_blender.addon.run_settings import new_run_folder, previs_settings
        from xihe_blender.shown_run import run_and_show

        settings = previs_settings(context.scene)
        self.scene, self.folder = context.scene, new_run_folder(context.scene)
        return run_and_show(context.scene, self.folder, settings, wipe=context.scene.xihe.wipe)

    def _done(self, context: bpy.types.Context) -> set[str]:
        self.scene.xihe.run_folder = str(self.folder)
        self.report({"INFO"}, f"The run is done: {self.folder}")
        return {"FINISHED"}


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
