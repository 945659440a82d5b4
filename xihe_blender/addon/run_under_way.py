"""A run while it lasts: its job, what the window shows of it, and the one place where both end.

`end` may be called by whoever sees the end first: the operator, Blender when it loads another file, or Python when
Blender drops the operator because the add-on is disabled; the second call does nothing.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator
from typing import Any

import bpy

from xihe_blender.addon.leftovers import remove_working_scenes
from xihenet.formats import format_duration


class RunUnderWay:
    """Drives a job of `xihe_blender.jobs` a step at a time and keeps window_manager.xihe up to date.

    Parameters
    ----------
    context : of the window in which the run was started
    job : the run
    works_here : whether the job works in the open file, where an Undo would take away what it works on
    """

    def __init__(self, context: bpy.types.Context, job: Generator[Any, None, Any], *, works_here: bool = True) -> None:
        from xihe_blender.jobs import TimeLeft

        self.is_over = False
        self.window_manager, self.workspace = context.window_manager, context.workspace
        self.job = job
        self.result: Any = None
        self.timer: bpy.types.Timer | None = None
        self.time_left = TimeLeft()
        self.shown: Any = None
        state = self.window_manager.xihe
        state.is_running, state.is_cancel_wanted, state.works_here = True, False, works_here
        state.progress, state.seconds_left, state.doing, state.error = 0.0, 0.0, "starting", ""
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
        self.show(progress)
        return False

    def show(self, progress: Any) -> None:
        """Say in the window how far the job is; `progress` is a Progress, and may be the last one again."""
        if progress == self.shown:
            return
        self.shown = progress
        share = progress.done / progress.total
        left_s = self.time_left.after(progress, time.perf_counter())
        state = self.window_manager.xihe
        state.progress, state.doing, state.seconds_left = share, progress.doing, left_s or 0.0
        self.window_manager.progress_update(round(100 * share))
        left = "" if left_s is None else f", {format_duration(left_s)} left"
        self._say(f"Xihe: {share:.0%}, {progress.doing}{left}     Esc: cancel")
        redraw(self.window_manager)

    def end(self) -> None:
        """Close the job, which puts the scene back, and take away what the window showed of it."""
        if self.is_over:
            return
        self.is_over = True
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

    def __del__(self) -> None:
        self.end()


def redraw(window_manager: bpy.types.WindowManager) -> None:
    """Have the panel drawn anew, in every window, and not the view beside it."""
    for window in window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if area.type == "VIEW_3D" and region.type == "UI":
                    region.tag_redraw()
