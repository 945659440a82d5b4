"""A modal job: an operator runs for minutes without taking Blender away. One job, driven in two ways.

In a window the operator comes back to its job a step per tick of a timer, and Esc ends it; in background, or called by
a script without a window's event, it drives the job to its end. A job that only follows another process leaves Undo and
rendering to the user.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import bpy

from xihe_blender.addon.failures import FAILURES, failed
from xihe_blender.addon.leftovers import remove_working_scenes
from xihe_blender.errors import UserError
from xihe_blender.jobs import Job, Progress, TimeLeft
from xihe_blender.scene.state import look_through_own_cameras
from xihenet.formats import format_duration

if TYPE_CHECKING:
    from xihe_blender.previs.settings import PrevisSettings

UNDO_KEYS = {"Z", "Y"}
NO_INPUT = {"MOUSEMOVE", "INBETWEEN_MOUSEMOVE", "WINDOW_DEACTIVATE", "NONE"}
TICK_S = 0.02
QUIET_S = 0.3
"""A step blocks the window for a frame's renders, so it waits until the user has not touched anything for so long."""

LONGEST_WAIT_S = 1.0
"""But no longer than this: some add-ons listen to the window all the time."""


class RunUnderWay:
    """Drives a job of `xihe_blender.jobs` a step at a time and keeps window_manager.xihe up to date, until both end.

    `end` may be called by whoever sees the end first: the operator, Blender when it loads another file, or the add-on
    when it is disabled, for which Blender drops operators without a word; the second call does nothing.

    Parameters
    ----------
    context : of the window in which the run was started
    job : the run
    works_here : whether the job works in the open file, where an Undo would take away what it works on
    """

    current: ClassVar[RunUnderWay | None] = None
    """The one that has not ended."""

    def __init__(self, context: bpy.types.Context, job: Job[Any], *, works_here: bool = True) -> None:
        self.is_over = False
        RunUnderWay.current = self
        self.window_manager, self.workspace = context.window_manager, context.workspace
        self.job = job
        self.result: Any = None
        self.timer: bpy.types.Timer | None = None
        self.time_left = TimeLeft()
        self.shown: Progress | None = None
        state = self.window_manager.xihe
        state.is_running, state.is_cancel_wanted, state.works_here = True, False, works_here
        state.progress, state.seconds_left, state.doing = 0.0, 0.0, "starting"
        state.error = state.ended_in = ""
        self.window_manager.progress_begin(0, 100)

    def step(self) -> bool:
        """Go on to the next point at which the job can stop; True if it was its end. Raises what the job raises."""
        try:
            progress = next(self.job)
        except StopIteration as finished:
            self.result = finished.value
            self.end()
            return True
        except BaseException:
            self.end()
            raise
        look_through_own_cameras()
        self.show(progress)
        return False

    def show(self, progress: Progress) -> None:
        """Say in the window how far the job is; `progress` may be the last one again."""
        if progress == self.shown:
            return
        self.shown = progress
        share = progress.done / progress.total
        left_s = self.time_left.after(progress, time.perf_counter())
        state = self.window_manager.xihe
        state.progress, state.doing, state.seconds_left = share, progress.doing, left_s or 0.0
        if state.works_here:  # It makes digits of the mouse pointer, for as long as the window may wait.
            self.window_manager.progress_update(round(100 * share))
        left = "" if left_s is None else f", {format_duration(left_s)} left"
        self._say(f"Xihe: {share:.0%}, {progress.doing}{left}     Esc: cancel")
        redraw(self.window_manager)

    def end(self) -> None:
        """Close the job, which puts the scene back, and take away what the window showed of it."""
        if self.is_over:
            return
        self.is_over, RunUnderWay.current = True, None
        try:
            # Whoever deleted what the job works on left it nothing to put back.
            with contextlib.suppress(ReferenceError):
                self.job.close()
        finally:
            self._leave_window()

    def _leave_window(self) -> None:
        if self.timer is not None:
            self.window_manager.event_timer_remove(self.timer)
        self.window_manager.progress_end()
        self._say(None)
        state = self.window_manager.xihe
        state.is_running = state.is_cancel_wanted = False
        state.progress, state.seconds_left, state.doing = 0.0, 0.0, ""
        remove_working_scenes()
        redraw(self.window_manager)

    def _say(self, line: str | None) -> None:
        # In background there is no workspace, and the one of a file that is left is gone.
        with contextlib.suppress(AttributeError, ReferenceError):
            self.workspace.status_text_set(line)


def redraw(window_manager: bpy.types.WindowManager, *, has_view_changed: bool = False) -> None:
    """Have the panel drawn anew, in every window; the 3D view beside it only where what is drawn over it changed."""
    kinds = {"UI", "WINDOW"} if has_view_changed else {"UI"}
    for window in window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if area.type == "VIEW_3D" and region.type in kinds:
                    region.tag_redraw()


def in_thread(work: Callable[[], object], doing: str) -> Job[None]:
    """`work`, which leaves Blender alone, in a thread beside the window; raises the UserError of `work`."""
    failures: list[UserError] = []

    def run() -> None:
        try:
            work()
        except UserError as error:
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    yield Progress(0, 1, doing)  # Also where the work ends at once
    while thread.is_alive():
        yield Progress(0, 1, doing)
    if failures:
        raise failures[0]


def edge_server_asked(settings: PrevisSettings) -> Job[None]:
    """Ask the edge server of `settings`, if they have one, beside the window; UserError if it does not answer."""
    if settings.backend is not None:
        from xihe_blender.previs.settings import close_backends, load_estimators

        alone = replace(settings, others=())
        yield from in_thread(lambda: close_backends(load_estimators(alone)), "asking the edge server")


class ModalJob:
    """Base of operators with a job; the class that is registered derives from it and from bpy.types.Operator."""

    cancelled = ""
    """What is said after Esc."""

    works_here = True
    """Whether the job works in the open file, and not another process for it."""

    is_modal = False
    """Whether a window comes back to the job, or the caller waits for its end."""

    scene: bpy.types.Scene
    """The scene that the job began with; its window may show another one by the time it ends."""

    report: Callable[[set[str], str], None]
    """Of bpy.types.Operator."""

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
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
        self.is_modal, self.scene = True, context.scene
        try:
            self.run = RunUnderWay(context, self.start_job(context), works_here=self.works_here)
            # What is wrong with the scene shows at once; and a job that has begun cleans up when it is closed.
            if self.run.step():
                return self.finish(context, self.run.result)
        except FAILURES as error:
            return failed(self, context, error)
        self.input_at = self.stepped_at = time.perf_counter()
        self.run.timer = context.window_manager.event_timer_add(TICK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        # Esc during playback stops that, and only then a job.
        if event.type == "ESC" and event.value == "PRESS" and not context.screen.is_animation_playing:
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
        self.scene = context.scene
        try:
            self.run = RunUnderWay(context, self.start_job(context))
            try:
                while not self.run.step():
                    time.sleep(0.0 if self.works_here else TICK_S)
            finally:  # Ctrl-C may come while it waits.
                self.run.end()
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
