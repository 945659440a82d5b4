"""What came out of the last run: triggers on the timeline, pictures beside the truth, the report."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy

from xihe_blender.addon import choices, polls
from xihe_blender.addon.failures import FAILURES, Action, format_error
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.apply.datablocks import COMPARISON_NAME, LightOf, applied_worlds, image_named
from xihe_blender.errors import UserError


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


class XIHE_OT_save_side_by_side(Action, bpy.types.Operator):
    bl_idname = "xihe.save_side_by_side"
    bl_label = "Save Video"
    bl_description = (
        "Write a video, and a picture of each compared frame, into the run's folder: what the phone captured, ground "
        "truth, estimate, and a line that wipes from one to the other"
    )
    bl_options = {"REGISTER"}
    conditions = (polls.leaves_the_file, polls.has_last_run, polls.has_comparison)

    def act(self, context: bpy.types.Context) -> str:
        from xihe_blender.compare.side_by_side import save_side_by_side
        from xihe_blender.io.run_results import read_results

        folder = last_run_folder(context.scene)
        return f"Saved {save_side_by_side(read_results(folder), folder)}"


class XIHE_OT_save_viewer(Action, bpy.types.Operator):
    bl_idname = "xihe.save_viewer"
    bl_label = "Save Viewer"
    bl_description = (
        "Write one HTML page into the run's folder, to be sent to others, and open it: the virtual objects live in the "
        "captured pictures, the timeline, and a line that wipes to the ground truth"
    )
    bl_options = {"REGISTER"}
    conditions = (polls.leaves_the_file, polls.has_last_run)

    def act(self, context: bpy.types.Context) -> str:
        page = viewer_of_run(last_run_folder(context.scene))
        if not bpy.app.background:
            bpy.ops.wm.url_open(url=page.resolve().as_uri())
        return f"Saved {page}"


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
        from xihe_blender.apply.applied_lights import lights_of_scene
        from xihe_blender.io.run_lights import LightsAsked, lights_asked, write_lights
        from xihe_blender.io.run_results import read_results

        scene, folder = context.scene, last_run_folder(context.scene)
        results = read_results(folder)
        # Beyond the path's ends, and between its frames, the light is that of the frame before.
        frames = [frame.frame for frame in results.frames]
        frame = max((one for one in frames if one <= scene.frame_current), default=min(frames))
        moved = [name for name, world in applied_worlds(scene).items() if (of := LightOf.read(world)) and of.live]
        now = {light.object_name: light for light in lights_of_scene(scene, LightsAsked(frame, objects=tuple(moved)))}
        lights = [now.get(light.object_name, light) for light in lights_asked(results, folder, LightsAsked(frame))]
        return f"Saved {write_lights(lights, self.target, folder / 'exports' / self.target)[-1].parent}"


def viewer_of_run(folder: Path) -> Path:
    """The viewer's page, written by a second Blender: exporting glTF would change what is selected in this one.

    UserError with what it says, where it cannot.
    """
    paths = [str(Path(sys.modules[name].__file__ or "").parents[1]) for name in ("xihe_blender", "xihenet")]
    code = (
        f"import sys; sys.path[:0] = {paths!r}\n"
        "from xihe_blender.cli.main import main\n"
        f"sys.exit(main(['export', {str(folder)!r}, '--to', 'viewer']))"
    )
    program = [bpy.app.binary_path, "--background", "--factory-startup", "--python-expr", code]
    done = subprocess.run(
        program if bpy.app.binary_path else [sys.executable, "-c", code],
        stdin=subprocess.DEVNULL, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False,
    )  # fmt: skip
    if done.returncode != 0:
        said = [line.removeprefix("xihe: ") for line in done.stderr.splitlines() if line.startswith("xihe: ")]
        raise UserError(said[-1] if said else f"the viewer was not written (exit code {done.returncode})")
    return folder / "viewer.html"


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
