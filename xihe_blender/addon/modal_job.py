"""How does an operator run for minutes without taking Blender away? One job, driven in two ways.

In a window the operator comes back to its job a step per tick of a timer, and Esc ends it; in background, or called by
a script without a window's event, it drives the job to its end. A job that only follows another process leaves Undo and
rendering to the user.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any

import bpy

from xihe_blender.addon.failures import FAILURES, failed
from xihe_blender.addon.run_under_way import RunUnderWay

UNDO_KEYS = {"Z", "Y"}
NO_INPUT = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE", "NONE"}
TICK_S = 0.02
QUIET_S = 0.3
"""A step blocks the window for a frame's renders, so it waits until the user has not touched anything for so long."""

LONGEST_WAIT_S = 1.0
"""But no longer than this: some add-ons listen to the window all the time."""


class ModalJob:
    """Base of operators with a job; the class that is registered derives from it and from bpy.types.Operator."""

    cancelled = ""
    """What is said after Esc."""

    works_here = True
    """Whether the job works in the open file, and not another process for it."""

    is_modal = False
    """Whether a window comes back to the job, or the caller waits for its end."""

    report: Callable[[set[str], str], None]
    """Of bpy.types.Operator."""

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        """The job; one of FAILURES for what cannot be done."""
        raise NotImplementedError

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        """Say and keep what the job brought; what the operator returns. One of FAILURES for what cannot be kept."""
        raise NotImplementedError

    def stop(self) -> None:
        """What else is to be done after Esc, before the job is closed."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start the job and come back to it a step at a time."""
        if bpy.app.background:
            return self.execute(context)
        self.is_modal = True
        try:
            self.run = RunUnderWay(context, self.start_job(context), works_here=self.works_here)
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
            self.stop()
            self.run.end()
            self.report({"INFO"}, self.cancelled)
            return {"CANCELLED"}
        if event.type == "TIMER":
            return {"RUNNING_MODAL"} if self._is_users_turn(context) else self._step(context)
        if event.type not in NO_INPUT:
            self.input_at = time.perf_counter()
        if self.works_here and (event.type == "F12" or (event.type in UNDO_KEYS and (event.ctrl or event.oskey))):
            # Undo would take away the scenes that the job works in; a render would get in its way.
            return {"RUNNING_MODAL"}
        return {"PASS_THROUGH"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """The whole job, and only then back."""
        try:
            self.run = RunUnderWay(context, self.start_job(context))
            while not self.run.step():
                time.sleep(0.0 if self.works_here else TICK_S)
            return self.finish(context, self.run.result)
        except FAILURES as error:
            return failed(self, context, error)

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender itself ends the operator: another file is loaded, or the window is closed."""
        self.run.end()

    def _is_users_turn(self, context: bpy.types.Context) -> bool:
        """Whether the user is busy, as while the view is turned: then a job that works here waits a little."""
        if not self.works_here:
            return False
        now = time.perf_counter()
        if now - self.stepped_at > LONGEST_WAIT_S:
            return False
        return now - self.input_at < QUIET_S or len(context.window.modal_operators) > 1

    def _step(self, context: bpy.types.Context) -> set[str]:
        try:
            is_done = self.run.step()
            self.stepped_at = time.perf_counter()
            return self.finish(context, self.run.result) if is_done else {"RUNNING_MODAL"}
        except FAILURES as error:
            return failed(self, context, error)
