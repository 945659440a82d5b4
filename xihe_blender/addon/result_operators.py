"""Results of the last run: triggers on the timeline, pictures beside the truth, the report."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import bpy

from xihe_blender.addon import choices, polls
from xihe_blender.addon.failures import FAILURES, Action, failed, format_error
from xihe_blender.addon.modal_job import TICK_S, ModalJob
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.apply.datablocks import COMPARISON_NAME, image_named
from xihe_blender.errors import UserError
from xihe_blender.jobs import Job, Progress, run_blocking
from xihe_blender.scene.blend_file import room_of


class XIHE_OT_explain(Action, bpy.types.Operator):
    bl_idname = "xihe.explain"
    bl_label = "Explain"
    bl_options = {"INTERNAL"}

    meaning: bpy.props.StringProperty(
        name="Meaning", description="The words that explain what stands beside the button"
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: XIHE_OT_explain) -> str:
        return str(properties.meaning)

    def act(self, _context: bpy.types.Context) -> str:
        return str(self.meaning)


class XIHE_OT_go_to_trigger(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.go_to_trigger"
    bl_label = "Go to Trigger"
    bl_description = "Go to the frame of the previous or next trigger, and show its light and comparison"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.leaves_the_file, polls.is_room, polls.has_triggers)

    direction: bpy.props.EnumProperty(
        name="Direction",
        description="Which trigger, relative to the current frame",
        items=(
            ("PREVIOUS", "Previous", "The last trigger before the current frame"),
            ("NEXT", "Next", "The first trigger after the current frame"),
        ),
        default="NEXT",
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.addon.results_in_blender import go_to_trigger, show_images

        scene = context.scene
        found = go_to_trigger(scene, self.direction)
        if found is None:
            where = "before" if self.direction == "PREVIOUS" else "after"
            self.report({"INFO"}, f"There is no trigger {where} frame {scene.frame_current}")
            return {"CANCELLED"}
        try:
            if polls.has_last_run(context) is None:
                show_images(scene, last_run_folder(scene))
        except FAILURES as error:
            # The light on the timeline is there without the run's pictures.
            self.report({"WARNING"}, format_error(error))
        return {"FINISHED"}


class XIHE_OT_show_comparison(Action, bpy.types.Operator):
    bl_idname = "xihe.show_comparison"
    bl_label = "Show Comparison"
    bl_description = "Show estimate and ground truth side by side in an Image Editor, at the nearest compared frame"
    bl_options = {"REGISTER"}
    conditions = (polls.leaves_the_file, polls.is_room, polls.has_last_run, polls.has_comparison)

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.addon.results_in_blender import show_images, wipe_through_objects

        scene, folder = context.scene, last_run_folder(context.scene)
        show_images(scene, folder)
        # Through the middle of the objects, until someone has moved the line.
        if not scene.xihe.is_property_set("wipe"):
            scene.xihe.wipe = wipe_through_objects(folder, scene.frame_current)
        if not bpy.app.background:
            _show_in_editor(context, image_named(COMPARISON_NAME))


class Saving(polls.Conditional, ModalJob):
    """Base of operators that have a second Blender write a file of the run's folder: exporting glTF changes what is
    selected, and rendering a video blocks the window."""

    bl_options = {"REGISTER"}
    works_here = False
    cancelled = "Nothing was saved"
    command: tuple[str, ...]
    """What `xihe` is given before the run's folder."""

    file_name: str
    doing: str

    def start_job(self, context: bpy.types.Context) -> Job[None]:
        folder = last_run_folder(context.scene)
        self.path = folder / self.file_name
        return second_blender([*self.command, str(folder)], self.doing)

    def finish(self, context: bpy.types.Context, result: None) -> set[str]:
        context.window_manager.xihe.error = ""
        self.report({"INFO"}, f"Saved {self.path}")
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        # The panel has one bar: beside a run that it shows, the window waits.
        return self.execute(context) if context.window_manager.xihe.is_running else super().invoke(context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            run_blocking(self.start_job(context), lambda *_: time.sleep(TICK_S))
        except FAILURES as error:
            return failed(self, context, error)
        return self.finish(context, None)


class XIHE_OT_save_side_by_side(Saving, bpy.types.Operator):
    bl_idname = "xihe.save_side_by_side"
    bl_label = "Save Video"
    bl_description = (
        "Write a video, and a picture of each compared frame, into the run's folder: what the phone captured, ground "
        "truth, estimate, and a line that wipes from one to the other"
    )
    conditions = (polls.leaves_the_file, polls.has_last_run, polls.has_comparison)
    command, file_name, doing = ("video",), "side_by_side.mp4", "saving the video"


class XIHE_OT_save_viewer(Saving, bpy.types.Operator):
    bl_idname = "xihe.save_viewer"
    bl_label = "Save Viewer"
    bl_description = (
        "Write one HTML page into the run's folder, to be sent to others, and open it: the virtual objects live in the "
        "captured pictures, the timeline, and a line that wipes to the ground truth"
    )
    conditions = (polls.leaves_the_file, polls.has_last_run)
    command, file_name, doing = ("export", "--to", "viewer"), "viewer.html", "saving the viewer"

    def finish(self, context: bpy.types.Context, result: None) -> set[str]:
        if not bpy.app.background:
            bpy.ops.wm.url_open(url=self.path.resolve().as_uri())
        return super().finish(context, result)


class XIHE_OT_export_light(Action, bpy.types.Operator):
    bl_idname = "xihe.export_light"
    bl_label = "Export Light"
    bl_description = (
        "Write the light at this frame for an engine, into the folder exports of the run: coefficients or a picture, "
        "and the key light apart. What each engine gets is in the documentation, on the page Light for engines"
    )
    bl_options = {"REGISTER"}
    conditions = (polls.leaves_the_file, polls.has_last_run)

    target: bpy.props.EnumProperty(
        name="Engine", description="Engine or file format that the light is written for", items=choices.platform_items
    )

    def act(self, context: bpy.types.Context) -> str:
        from xihe_blender.apply.applied_lights import lights_after_run
        from xihe_blender.io.run_lights import LightsAsked, lights_asked, write_lights
        from xihe_blender.io.run_results import read_results

        if not self.target:  # A list that is made by a function has no default.
            names = ", ".join(name for name, *_ in choices.platform_items(None, context))
            raise UserError(f"no engine is chosen: give target one of {names}")
        scene, folder = context.scene, last_run_folder(context.scene)
        results = read_results(folder)
        # Beyond the path's ends, and between its frames, the light is that of the frame before.
        frames = [frame.frame for frame in results.frames]
        frame = max((one for one in frames if one <= scene.frame_current), default=min(frames))
        now, of_run = lights_after_run(room_of(scene), frame), lights_asked(results, folder, LightsAsked(frame))
        # Those that are left were added after the run.
        lights = [*(now.pop(light.object_name, light) for light in of_run), *now.values()]
        return f"Saved {write_lights(lights, self.target, folder / 'exports' / self.target)[-1].parent}"


def second_blender(arguments: Sequence[str], doing: str) -> Job[None]:
    """A job: `xihe` with `arguments`, in a Blender of its own, which ends when this is closed.

    UserError with what it says, where it cannot.
    """
    paths = [str(Path(sys.modules[name].__file__ or "").parents[1]) for name in ("xihe_blender", "xihenet")]
    code = (
        f"import sys; sys.path[:0] = {paths!r}\nfrom xihe_blender.cli.main import command\ncommand({list(arguments)!r})"
    )
    program = [bpy.app.binary_path, "--background", "--factory-startup", "--python-expr", code]
    # Whatever it leaves in a folder for temporary files goes with that.
    with tempfile.TemporaryDirectory(prefix="xihe_", ignore_cleanup_errors=True) as temporary:
        console = Path(temporary) / "console.txt"
        with console.open("wb") as stderr:
            process = subprocess.Popen(
                program if bpy.app.binary_path else [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=stderr,
                env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), temporary),
            )  # fmt: skip
        try:
            yield Progress(0, 1, doing)
            while process.poll() is None:
                yield Progress(0, 1, doing)
        finally:
            process.kill()
            process.wait()
        lines = console.read_text(encoding="utf-8", errors="replace").splitlines()
    if process.returncode != 0:
        said = [line.removeprefix("xihe: ") for line in lines if line.startswith("xihe: ")]
        raise UserError(said[-1] if said else f"nothing was saved (exit code {process.returncode})")


class XIHE_OT_open_report(Action, bpy.types.Operator):
    bl_idname = "xihe.open_report"
    bl_label = "Open Report"
    bl_description = "Open the last run's report in the web browser"
    conditions = (polls.has_last_run, polls.has_report)

    def act(self, context: bpy.types.Context) -> None:
        bpy.ops.wm.url_open(url=last_run_folder(context.scene).joinpath("report.html").resolve().as_uri())


def _show_in_editor(context: bpy.types.Context, image: bpy.types.Image | None) -> None:
    """Show `image` in the Image Editor that is open, of this window first; else in a window of its own."""
    windows = [context.window, *(window for window in context.window_manager.windows if window != context.window)]
    areas = [area for window in windows for area in window.screen.areas if area.type == "IMAGE_EDITOR"]
    areas = [area for area in areas if area.ui_type == "IMAGE_EDITOR"] or areas
    if not areas:
        bpy.ops.wm.window_new()
        areas = [max(context.window_manager.windows[-1].screen.areas, key=lambda area: area.width * area.height)]
        areas[0].ui_type = "IMAGE_EDITOR"
    areas[0].spaces.active.image = image
    window = next(w for w in context.window_manager.windows if areas[0] in list(w.screen.areas))
    region = next(region for region in areas[0].regions if region.type == "WINDOW")
    with context.temp_override(window=window, area=areas[0], region=region):
        bpy.ops.image.view_all(fit_view=True)


register, unregister = bpy.utils.register_classes_factory(
    (
        XIHE_OT_explain,
        XIHE_OT_go_to_trigger,
        XIHE_OT_show_comparison,
        XIHE_OT_save_side_by_side,
        XIHE_OT_save_viewer,
        XIHE_OT_export_light,
        XIHE_OT_open_report,
    )
)
