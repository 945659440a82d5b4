"""The run from the panel, how it is stopped and taken up again, and how those go of which nothing is shown any more."""

from __future__ import annotations

import importlib
import time
from pathlib import Path

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.background_run import BackgroundRun, saved_for_run
from xihe_blender.addon.failures import Action
from xihe_blender.addon.modal_job import ModalJob, edge_server_asked, in_thread
from xihe_blender.addon.preferences import runs_folder
from xihe_blender.addon.runs_folder import new_run_folder, remove_if_empty, shown_runs
from xihe_blender.errors import UserError
from xihe_blender.io.old_runs import format_old_runs, old_runs, remove_old_runs
from xihe_blender.jobs import Job, Progress
from xihenet.formats import format_count


class Following(ModalJob):
    """Base of the two operators whose job is a run: begun now, or taken up."""

    # Not REGISTER: repeating the last operator would run all of it again, without a window to cancel it in.
    bl_options = {"UNDO"}
    cancelled = "The run was stopped"
    folder: Path
    background: BackgroundRun | None = None
    """None for a run in this process."""

    def follow(self, run: BackgroundRun) -> Job[None]:
        """The job of `run`, which is remembered: it is offered whenever the file does not show it."""
        self.background, self.folder = run, run.folder
        self.cancelled = f"{Following.cancelled}: Resume goes on with it"
        state = bpy.context.window_manager.xihe
        # Until now it has worked in the open file, if only to look at the camera path.
        self.works_here = state.works_here = False
        bpy.context.window_manager.progress_end()
        state.newest_run = str(run.folder)
        return run.follow()

    def stop(self) -> None:
        if self.background is not None:
            self.background.stop()
            if self.background.is_under_way:
                self.cancelled = "The run goes on in another Blender: stop it there"

    def finish(self, context: bpy.types.Context, result: None) -> set[str]:
        run = self.background
        chosen = (self.scene if run is None else run.find_scene()).xihe
        chosen.run_folder, chosen.run_made_of = str(self.folder), ""
        if run is not None and run.is_edited:
            began, today = time.localtime(run.request.started), time.localtime()
            chosen.run_made_of = time.strftime("%H:%M" if began[:3] == today[:3] else "%H:%M on %Y-%m-%d", began)
        if run is None:
            # A run in this process cannot be taken up, and an earlier one is the newest no more.
            context.window_manager.xihe.newest_run = chosen.begun_run = ""
        if chosen.id_data != context.scene:
            context.window_manager.xihe.ended_in = chosen.id_data.name
        self.report({"INFO"}, f"The run is finished: {self.folder}")
        from xihe_blender.addon.results_in_blender import left_out

        if missing := left_out(chosen.id_data, self.folder):
            self.report({"WARNING"}, missing)
        return {"FINISHED"}


class XIHE_OT_run(polls.Conditional, Following, bpy.types.Operator):
    bl_idname = "xihe.run"
    bl_label = "Run"
    bl_description = (
        "Move the phone along the camera path, estimate the light, apply it and compare it with ground truth. "
        "A second Blender does it in the background, on a copy of this file"
    )
    conditions = (
        polls.is_idle,
        polls.is_room,
        polls.has_cycles,
        polls.is_in_object_mode,
        polls.has_virtual_objects,
        polls.has_camera,
    )

    def start_job(self, context: bpy.types.Context) -> Job[None]:
        # A script waits for the run anyway.
        return self._job(context.scene, in_background=self.is_modal and bool(bpy.app.binary_path))

    def _job(self, scene: bpy.types.Scene, *, in_background: bool) -> Job[None]:
        """A scene that cannot be run is refused before anything is written."""
        if in_background:
            yield from results_imported()
        from xihe_blender.addon.run_settings import choices_of_run, previs_settings, run_and_show
        from xihe_blender.apply.lit_scene import keep_added
        from xihe_blender.previs.plan import plan_previs
        from xihe_blender.previs.survey import may_see_a_position

        keep_added()
        settings = previs_settings(scene)
        plan = plan_previs(scene, settings)
        if not (yield from may_see_a_position(scene, plan)):
            raise UserError(
                "No virtual object is in view of the camera in any frame: "
                "turn the camera to one, or move one into its view"
            )
        yield from edge_server_asked(settings)
        if in_background:
            yield Progress(0, 1, "saving a copy of the file")
        self.folder = new_run_folder(scene)
        if in_background:
            run = saved_for_run(scene, self.folder, choices_of_run(scene))
            try:
                run.start()
            except OSError as error:
                self.report({"WARNING"}, f"No second Blender ({error.strerror}): this window waits while frames render")
            else:
                scene.xihe.begun_run = str(self.folder)
                yield from self.follow(run)
                return
        yield from run_and_show(scene, self.folder, settings)


class XIHE_OT_resume_run(polls.Conditional, Following, bpy.types.Operator):
    bl_idname = "xihe.resume_run"
    bl_label = "Resume"
    bl_description = "Go on with the last run of this file, which it does not show, and show its results"
    conditions = (polls.is_idle, polls.is_room, polls.has_unshown_run)

    def start_job(self, context: bpy.types.Context) -> Job[None]:
        return self._job(Path(context.window_manager.xihe.unshown_run))

    def _job(self, folder: Path) -> Job[None]:
        yield from results_imported()
        run = BackgroundRun(folder, is_edited=True)
        if not run.has_ended:
            run.start()
        yield from self.follow(run)


class XIHE_OT_discard_run(Action, bpy.types.Operator):
    bl_idname = "xihe.discard_run"
    bl_label = "Discard"
    bl_description = "Delete what the last run of this file, which it does not show, has made so far"
    conditions = (polls.is_idle, polls.has_unshown_run)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        from xihe_blender.addon.panels import format_begun

        begun = BackgroundRun(Path(context.window_manager.xihe.unshown_run)).begun
        return ask_to_delete(self, event, f"the run that was begun {format_begun(begun or time.time())}")

    def act(self, context: bpy.types.Context) -> None:
        state = context.window_manager.xihe
        BackgroundRun(Path(state.unshown_run)).discard()
        state.newest_run = ""


class XIHE_OT_cancel_run(Action, bpy.types.Operator):
    bl_idname = "xihe.cancel_run"
    bl_label = "Cancel"
    bl_description = "Stop what is under way; same as Esc. A stopped run can be resumed"
    conditions = (polls.is_running,)

    def act(self, context: bpy.types.Context) -> None:
        context.window_manager.xihe.is_cancel_wanted = True


class XIHE_OT_remove_old_runs(Action, bpy.types.Operator):
    bl_idname = "xihe.remove_old_runs"
    bl_label = "Remove Old Runs"
    bl_description = (
        "Delete the folders of all runs from the panel but those that the open file shows. "
        "Other files that show them keep their light, but lose reflections, the frames behind Xihe Lit, and the report"
    )
    conditions = (polls.is_idle, polls.has_old_runs)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return ask_to_delete(self, event, format_old_runs(old_runs(runs_folder(), shown_runs())))

    def act(self, context: bpy.types.Context) -> str | None:
        removed = remove_old_runs(runs_folder(), shown_runs())
        remove_if_empty(runs_folder())
        # Blender draws its preferences anew only when one of them changes.
        for window in context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "PREFERENCES":
                    area.tag_redraw()
        return f"Removed {format_count(len(removed), 'old run')}"


def ask_to_delete(operator: bpy.types.Operator, event: bpy.types.Event, what: str) -> set[str]:
    """Ask first: what is deleted does not come back by Undo. What the operator's `invoke` returns."""
    answer: set[str] = bpy.context.window_manager.invoke_confirm(
        operator, event, title=f"Delete {what}?", message="This cannot be undone", confirm_text="Delete", icon="WARNING"
    )
    return answer


def results_imported() -> Job[None]:
    """Import what shows results, and NumPy with it: the window would stand still for a second."""
    yield from in_thread(lambda: importlib.import_module("xihe_blender.addon.results_in_blender"), "starting")


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_run, XIHE_OT_resume_run, XIHE_OT_discard_run, XIHE_OT_cancel_run, XIHE_OT_remove_old_runs)
)
