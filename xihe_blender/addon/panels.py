"""The panels: the tab "Xihe" in the sidebar of the 3D view, the chain from top to bottom, a panel a stage.

    Virtual Objects, Camera Path, Effects, Estimator, Run, Apply, Results

A panel with nothing to show says in one line what to do next, and a grey button says why when the mouse rests on it
(the operators' polls). Panels are drawn many times a second: they look at properties and names only, compute nothing
and import nothing heavy.

The sidebar is 220 pixels wide unless someone drags it: labels are short, and sentences are wrapped.
"""

from __future__ import annotations

import math
import re
import textwrap
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from xihe_blender.addon.background_run import BackgroundRun
from xihe_blender.addon.choices import DEFAULT_PHONE
from xihe_blender.addon.failures import in_the_panels_words
from xihe_blender.addon.look_operators import advice_for, other_cameras
from xihe_blender.addon.planning_operators import calibration_line, known_times
from xihe_blender.addon.polls import doubts, has_camera, has_virtual_objects, shows_run
from xihe_blender.addon.runs_folder import RUN_IS_GONE, found_folder, last_run, other_unit
from xihe_blender.apply.datablocks import moved_positions
from xihe_blender.scene.blend_file import room_of
from xihe_blender.scene.phone_capture import IS_CAPTURED, remembered_capture
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.formats import format_duration

if TYPE_CHECKING:
    from xihe_blender.io.run_results import RunResults

TAB = "Xihe"
N_NAMED = 6
N_EFFECTS = 8
N_WARNINGS = 3
LABEL_SHARE = 0.47
NARROW_SHARE = 0.6
METHOD_SHARE = 0.34
PIXELS_PER_CHARACTER = 6.6
FEWEST_CHARACTERS = 16
WIDE_CHARACTERS = 29
RUN_SCALE = 1.5
UNIT = re.compile(r"(?<=\d) (?=(?:%|s|ms|min|h|m)(?!\w))")
"""What stands between a number and its unit."""

ESTIMATES = (
    "How often the light was estimated, all virtual objects counted. Fewer cost less; a changing light needs more"
)
LIGHT_ERROR = (
    "Mean distance of the estimates from the rendered light probe, in spherical-harmonic coefficients. 0 is perfect. "
    "An estimator is worth its time where this is well below the error of the phone's ambient light"
)
EXPECTED_ERROR = (
    "The light error that the estimator itself expects, without having seen the true light. Where the light error is "
    "far above it, the room is unlike those that the estimator was trained on"
)
METHODS = (
    "Light: mean distance from the rendered light probe, in spherical-harmonic coefficients. Picture: root mean square "
    "error of the lit objects, in linear colour, against the ground truth. 0 is perfect; the best picture stands first"
    ". ms: milliseconds that one estimate took, the way to an edge server and back included"
)
AMBIENT_ERROR = (
    "The same distance for even light as bright as the captured picture, which every phone's light sensor gives"
)
COVERAGE = (
    "Share of the directions around the virtual objects that the phone has seen. The light from all others is guessed, "
    "so below a half let the phone look around more"
)
CHAIN = (
    "Mean time from unproject to estimate, without rendering. At 30 frames a second a phone has 33 ms for all it does"
)
RENDERING = (
    "Time that it took to choose the number of samples, and to render captures, light probes, ground truth and objects"
)
NO_DEPTH = (
    "Pixels without a depth, such as those of windows and sky, counted once for each position. Their colour counts as "
    "light from far away, where nothing nearer is known"
)
UNKNOWN_LIGHT = "How often the light could not be estimated, so that the light before it stayed in use"


class StagePanel:
    """Where all panels of the tab live; the scene that shows a run's light has Apply alone."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = TAB

    layout: bpy.types.UILayout

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return cls is XIHE_PT_apply or not shows_run(context)

    def properties_layout(self) -> bpy.types.UILayout:
        """The panel's own, with names on the left of what can be set, and no dots for keys."""
        self.layout.use_property_split, self.layout.use_property_decorate = True, False
        return self.layout


class XIHE_PT_virtual_objects(StagePanel, bpy.types.Panel):
    bl_label = "Virtual Objects"
    bl_order = 0

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        objects = virtual_objects(context.scene)
        if not objects:
            sentence(context, layout, "Select the objects that the phone should insert, then add them:")
        column = layout.column(align=True)
        for item in objects[:N_NAMED]:
            icon = "OUTLINER_OB_MESH" if item.type == "MESH" else "OBJECT_DATA"
            column.label(text=item.name, icon=icon, translate=False)
        if len(objects) > N_NAMED:
            column.label(text=f"and {len(objects) - N_NAMED} more", icon="BLANK1")
        column = layout.column(align=True)
        row = column.row(align=True)
        row.operator("xihe.add_virtual_objects", text="Add Selected", icon="ADD")
        row.operator("xihe.remove_virtual_objects", text="", icon="REMOVE")
        row = column.row(align=True)
        row.operator("xihe.add_sphere_rig", text="Three-Sphere Rig", icon="SPHERE")
        if objects:
            row.prop(context.scene.xihe, "show_positions", text="", icon="HIDE_OFF")


class XIHE_PT_camera_path(StagePanel, bpy.types.Panel):
    bl_label = "Camera Path"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene, settings = self.properties_layout(), context.scene, context.scene.xihe
        if scene.camera is None:
            sentence(context, layout, "Add a camera to act as the phone")
        layout.prop(scene, "camera")
        is_recorded = remembered_capture(scene) is not None
        if is_recorded:
            sentence(context, layout, IS_CAPTURED, icon="INFO")
        column = layout.column()
        if not is_recorded:
            whole = column.row()
            # The name of a phone needs all of the width.
            whole.use_property_split = False
            whole.prop(settings, "phone", text="")
            if settings.phone == "FILE":
                column.prop(settings, "phone_file", text="File")
        column.prop(settings, "network")
        column.prop(settings, "carries_light")


class XIHE_PT_picture(StagePanel, bpy.types.Panel):
    bl_label = "Frames and Picture"
    bl_parent_id = "XIHE_PT_camera_path"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.properties_layout(), context.scene.xihe
        layout.prop(settings, "use_own_frames")
        if settings.use_own_frames:
            column = layout.column(align=True)
            column.prop(settings, "frame_start")
            column.prop(settings, "frame_end")
            column.prop(settings, "frame_step")
        layout.prop(settings, "captures_path")
        if remembered_capture(context.scene) is not None:  # Size and exposure are the recording's.
            return
        layout.prop(settings, "use_own_size")
        column = layout.column(align=True)
        column.active = settings.use_own_size
        column.prop(settings, "size", index=0, text="Width")
        column.prop(settings, "size", index=1, text="Height")
        layout.prop(settings, "use_own_exposure")
        row = layout.row()
        row.active = settings.use_own_exposure
        row.prop(settings, "exposure")
        row = layout.row()
        row.active = not settings.use_own_exposure
        row.prop(settings, "metering")


class XIHE_UL_effects(bpy.types.UIList):
    """An effect a row: whether it is simulated, its name, and what the user wants."""

    # Blender counts the parameters.
    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, _i: Any, _owner: Any, _p: Any, index: int
    ) -> None:
        row = layout.row(align=True)
        row.active = item.state == "on"
        row.label(
            text=in_title(item.name), icon="CHECKBOX_HLT" if item.state == "on" else "CHECKBOX_DEHLT", translate=False
        )
        # A narrow sidebar has no room for a name and a choice that is nobody's.
        is_chosen = item.override != "AUTO" or index == data.active_effect
        if item.is_switchable and (is_chosen or not is_narrow(context)):
            choice = layout.row()
            choice.ui_units_x = 3.2
            choice.prop(item, "override", text="", emboss=item.override != "AUTO")


class XIHE_PT_effects(StagePanel, bpy.types.Panel):
    bl_label = "Effects"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.xihe
        effects = settings.effects
        if not effects:
            sentence(context, layout, "A run simulates the effects that the scene needs. List them:")
            layout.operator("xihe.plan_effects", icon="VIEWZOOM")
            return
        layout.template_list(
            "XIHE_UL_effects", "", settings, "effects", settings, "active_effect", rows=N_EFFECTS, maxrows=N_EFFECTS
        )
        if 0 <= settings.active_effect < len(effects):
            effect = effects[settings.active_effect]
            sentence(context, layout, f"{effect.name}: {effect.reason}", icon="INFO")
        layout.operator("xihe.plan_effects", text="Plan Again", icon="FILE_REFRESH")


class XIHE_PT_estimator(StagePanel, bpy.types.Panel):
    bl_label = "Estimator"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.properties_layout(), context.scene.xihe
        layout.prop(settings, "estimator")
        layout.prop(settings, "uses_edge_server")
        if settings.uses_edge_server:
            layout.prop(settings, "edge_server")
        layout.prop(settings, "preset")
        costs = calibration_line()
        text = "Calibrate Again" if costs else "Calibrate"
        if context.window_manager.xihe.is_running:
            # A button that turns grey under the mouse stays grey for Blender until the mouse leaves it.
            row = layout.row()
            row.active, row.alignment = False, "CENTER"
            row.label(text=text, icon="SORTTIME")
        else:
            layout.operator("xihe.calibrate", text=text, icon="SORTTIME")
        if costs:
            sentence(context, layout, costs)


class XIHE_PT_estimator_details(StagePanel, bpy.types.Panel):
    bl_label = "Details"
    bl_parent_id = "XIHE_PT_estimator"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.properties_layout(), context.scene.xihe
        layout.column(align=True).prop(settings, "others")
        layout.prop(settings, "target")
        layout.prop(settings, "light")
        layout.prop(settings, "trigger")
        layout.prop(settings, "seed")


class XIHE_PT_run(StagePanel, bpy.types.Panel):
    bl_label = "Run"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        layout, job = self.layout, context.window_manager.xihe
        if job.is_running:
            self._draw_progress(context, job)
            return
        row = layout.row(align=True)
        row.scale_y = RUN_SCALE
        # Blender takes the first thing here that is no button for the progress bar under the mouse, and draws a label
        # as a button then.
        row.separator(factor=0.0)
        row.operator("xihe.run", text="Run", icon="PLAY")
        if job.unshown_run:
            self._draw_unshown(context, BackgroundRun(Path(job.unshown_run)))
        row = layout.row(align=True)
        takes, _ = known_times(context)
        row.operator("xihe.measure_run", text="" if takes else "How Long?", icon="TIME")
        if takes:
            row.label(text=as_sentence(takes), translate=False)
        if said := ended_elsewhere(context):
            sentence(context, layout, said, icon="INFO")
        if job.error:
            sentence(context, layout, job.error, icon="ERROR")
        elif not (has_camera(context) or has_virtual_objects(context)):
            for doubt in doubts(context.scene):
                sentence(context, layout, doubt, icon="QUESTION")

    def _draw_unshown(self, context: bpy.types.Context, run: BackgroundRun) -> None:
        """A run that this window does not follow: begun before the file was closed, stopped, or shown no more."""
        if run.begun is None:
            return
        state, does = ("has ended", "Show Results") if run.has_ended else ("was stopped", "Resume")
        if run.is_under_way:
            state, does = "is under way", "Follow"
        sentence(context, self.layout, f"The run that was begun {format_begun(run.begun)} {state}", icon="INFO")
        row = self.layout.row(align=True)
        row.operator("xihe.resume_run", text=does, icon="FORWARD")
        row.operator("xihe.discard_run", text="", icon="TRASH")

    def _draw_progress(self, context: bpy.types.Context, job: Any) -> None:
        # As high as the two buttons it stands for: what is below does not move when a run begins and ends.
        layout = self.layout
        row = layout.row(align=True)
        row.scale_y = RUN_SCALE
        row.progress(factor=job.progress, type="BAR", text=format_progress(job.progress, job.seconds_left))
        row.operator("xihe.cancel_run", text="", icon="X")
        doing = "stopping after this step" if job.is_cancel_wanted else job.doing
        layout.label(text=as_sentence(doing), translate=False)


class XIHE_PT_apply(StagePanel, bpy.types.Panel):
    bl_label = "Apply"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        is_lit = shows_run(context)
        if is_lit and (said := ended_elsewhere(context)):
            sentence(context, layout, said, icon="INFO")
        row = layout.row()
        row.scale_y = RUN_SCALE
        row.operator(
            "xihe.show_room" if is_lit else "xihe.show_lit", icon="LOOP_BACK" if is_lit else "SHADING_RENDERED"
        )
        both = beside_or_below(context, layout)
        both.operator("xihe.apply_light")
        row = both.row(align=True)
        row.operator("xihe.remove_light")
        row.prop(room_of(context.scene).xihe, "follows_objects", text="", icon="CON_FOLLOWTRACK")


class XIHE_PT_results(StagePanel, bpy.types.Panel):
    bl_label = "Results"
    bl_order = 6

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.xihe
        run = last_run(settings.run_folder)
        if run is None:
            job = context.window_manager.xihe
            sentence(context, layout, missing_run(settings.run_folder, job.is_running and not job.works_here))
            return
        for said in filter(None, (made_of(context.scene, run), other_unit(context.scene, run))):
            sentence(context, layout, said, icon="INFO")
        for said in shown_warnings(run):
            sentence(context, layout, said, icon="ERROR")
        if run.recording is not None:
            sentence(context, layout, run.recording.said, icon="INFO")
        if said := simulated_phone(run):
            sentence(context, layout, said, icon="INFO")
        _draw_moved(context, layout)
        column = layout.column(align=True)
        for name, value, meaning in result_rows(run):
            row = column.row(align=True)
            if is_narrow(context):
                row.label(text=f"{iface_(name)}: {value}", translate=False)
            else:
                split = row.split(factor=LABEL_SHARE)
                split.label(text=name)
                split.label(text=value, translate=False)
            # A label has no tooltip.
            row.operator("xihe.explain", text="", icon="QUESTION", emboss=False).meaning = meaning
        if run.settings.others and run.recording is None:
            _draw_methods(layout, run, is_narrow(context))
        split = layout.split(factor=NARROW_SHARE if is_narrow(context) else LABEL_SHARE)
        split.label(text="Go to Trigger")
        row = split.row(align=True)
        # Buttons of nothing but an icon do not grow by themselves.
        row.scale_x = 2.5
        row.operator("xihe.go_to_trigger", text="", icon="PREV_KEYFRAME").direction = "PREVIOUS"
        row.operator("xihe.go_to_trigger", text="", icon="NEXT_KEYFRAME").direction = "NEXT"
        if run.recording is None:
            row = layout.row(align=True)
            row.operator("xihe.show_comparison", text="Compare")
            row.prop(settings, "wipe", slider=True)
        _draw_looks(context, layout)
        row = layout.row(align=True)
        row.operator("xihe.save_side_by_side", text="Save Video")
        row.operator("xihe.save_viewer", text="Save Viewer")
        both = beside_or_below(context, layout)
        both.operator_menu_enum("xihe.export_light", "target", text="Export Light")
        row = both.row(align=True)
        row.operator("xihe.open_report", text="Open Report")
        row.operator("wm.path_open", text="", icon="FILE_FOLDER").filepath = str(found_folder(settings.run_folder))


def ended_elsewhere(context: bpy.types.Context) -> str:
    """That a run has ended, where its results are in another scene than the one shown; else nothing."""
    name = context.window_manager.xihe.ended_in
    is_elsewhere = name in bpy.data.scenes and name != context.scene.name
    return f"The run of scene {name!r} is finished: go there to see it" if is_elsewhere else ""


def made_of(scene: bpy.types.Scene, run: RunResults) -> str:
    """What the results are of, where that is not `scene` as it is now: a copy of a scene shows the run of the first."""
    is_copy = run.scene.name != scene.name and run.scene.name in bpy.data.scenes
    when = f" as it was at {scene.xihe.run_made_of}" if scene.xihe.run_made_of else ""
    of = f"scene {run.scene.name!r}" if is_copy else "the scene"
    return f"These results are of {of}{when}" if is_copy or when else ""


def simulated_phone(run: RunResults) -> str:
    """The phone and the network that were simulated, of which others may be chosen by now; else nothing."""
    from xihenet.phone import LINKS

    phone = [] if run.settings.phone == DEFAULT_PHONE else [f"Phone: {run.phone.name}"]
    link = LINKS.get(run.network_in_use or "")
    network = [] if link is None else [f"Network: {link.label}"]
    return ". ".join(phone + network)


def shown_warnings(run: RunResults) -> list[str]:
    """What the run asks to check or change, the first few of it."""
    said = [in_the_panels_words(warning) for warning in run.warnings]
    more = len(said) - N_WARNINGS
    return said if more <= 0 else [*said[:N_WARNINGS], f"And {more} more: see the report"]


def _draw_moved(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """What is known of the light at objects that were moved since the run, and that all below is of the run."""
    moved = moved_positions(context.scene)
    for name, (coverage, error) in moved.items():
        expected = "" if error is None else f", expected error {error:.3f}"
        words = f"{name!r} was moved or added since: coverage {coverage:.0%}{expected}"
        sentence(context, layout, words, icon="CON_FOLLOWTRACK")
    if moved:
        sentence(context, layout, "Errors and ground truth below are of the run: for new ones run again", icon="INFO")


def _draw_looks(context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
    """The button that asks where the phone should look, and what is advised for the active virtual object."""
    both = beside_or_below(context, layout)
    both.operator("xihe.look_where", icon="HIDE_OFF")
    advice = advice_for(context)
    if any(one.look for one in advice):
        both.operator("xihe.add_better_camera", icon="CAMERA_DATA")
    for one in advice:
        sentence(context, layout, f"{one.name!r}: {one.sentence}", icon="INFO")
    if other_cameras(context):
        said = "Markers switch to other cameras: delete those markers to run with Xihe Better Path"
        sentence(context, layout, said, icon="INFO")


def _draw_methods(layout: bpy.types.UILayout, run: RunResults, is_narrow: bool) -> None:
    """A table of the estimators of a run: the error of their light and of the pictures of the lit objects, and time.

    A narrow sidebar has room for the error of the pictures alone.
    """
    row = layout.box().row(align=True)
    split = row.split(factor=NARROW_SHARE if is_narrow else METHOD_SHARE, align=True)  # Even widths would cut names.
    names, figures = split.column(align=True), split.row(align=True)
    columns = [names, *(figures.column(align=True) for _ in range(1 if is_narrow else 3))]
    row.operator("xihe.explain", text="", icon="QUESTION", emboss=False).meaning = METHODS
    for cells in [("Estimator", "Light", "Picture", "ms"), *method_rows(run)]:
        for column, cell in zip(columns, (cells[0], cells[2]) if is_narrow else cells, strict=True):
            column.label(text=cell, translate=False)


def method_rows(run: RunResults) -> list[tuple[str, str, str, str]]:
    """(name, light error, picture error, time of an estimate) of each method of a run, the best picture first."""
    lights, times = run.light_errors, run.summary.estimate_ms
    rmse = {name: None if name not in run.comparison else run.comparison[name].rmse for name in lights}
    best_first = sorted(lights, key=lambda name: math.inf if (error := rmse[name]) is None else error)
    return [
        (name, _number(lights[name], ".3f"), _number(rmse[name], ".3f"), _number(times.get(name), ".1f"))
        for name in best_first
    ]


def in_title(name: str) -> str:
    """As Blender writes labels, without touching what is in capitals already: "Fast GI", "Edge Bleeding"."""
    return " ".join(as_sentence(word) for word in name.replace("_", " ").split(" "))


def as_sentence(words: str) -> str:
    """Its first letter in capitals; the others as they are."""
    return words[:1].upper() + words[1:]


def missing_run(folder: str, is_under_way: bool) -> str:
    if is_under_way:
        return "No results yet: the run is under way"
    return RUN_IS_GONE if folder else "No results yet: press Run"


def result_rows(run: RunResults) -> list[tuple[str, str, str]]:
    """(label, value, what it means) of the last run; the first two are short enough for half the sidebar."""
    summary, has_truth, expects = run.summary, run.recording is None, run.summary.expected_error is not None
    rows = [
        ("Estimates", f"{summary.n_estimates} in {summary.n_frames} frames", ESTIMATES),
        *[("Light Error", _number(summary.mean_shc_rmse, ".3f"), LIGHT_ERROR)] * has_truth,
        *[("Expected Error", _number(summary.expected_error, ".3f"), EXPECTED_ERROR)] * expects,
        *[("Ambient Error", _number(summary.ambient_shc_rmse, ".3f"), AMBIENT_ERROR)] * has_truth,
        ("Coverage", _number(summary.mean_coverage, ".0%"), COVERAGE),
        ("Chain", _number(summary.mean_step_ms, ".1f", " ms a frame"), CHAIN),
        ("Rendering", format_duration(summary.all_render_s), RENDERING),
    ]
    if run.settings.backend is not None:
        state = next((note for note in run.notes if run.settings.backend in note), "")
        rows.append(("Edge Server", run.settings.backend.partition("//")[2], state))
    if summary.n_invalid_points:
        rows.append(("No Depth", f"{summary.n_invalid_points:,} points", NO_DEPTH))
    if summary.n_unknown_lights:
        n = summary.invalid.lights.get("no_answer", 0)
        unanswered = f". Because the edge service did not answer: {n} of them" if n else ""
        rows.append(("Unknown Light", f"{summary.n_unknown_lights} times", f"{UNKNOWN_LIGHT}{unanswered}"))
    return rows


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "none" if value is None else f"{value:{form}}{unit}"


def format_begun(begun: float) -> str:
    """Such as "at 14:03"; with the date of another day than today's."""
    is_today = time.localtime(begun)[:3] == time.localtime()[:3]
    return time.strftime("at %H:%M" if is_today else "on %Y-%m-%d at %H:%M", time.localtime(begun))


def format_progress(progress: float, seconds_left: float) -> str:
    """Such as "45 %, 2 min left"; the time only once there is a pace."""
    share = f"{progress:.0%}"
    return f"{share}, {format_duration(seconds_left)} left" if seconds_left > 0 else share


def sentence(context: bpy.types.Context, layout: bpy.types.UILayout, text: str, *, icon: str = "NONE") -> None:
    """Labels that hold `text`, wrapped at the sidebar's width."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for index, line in enumerate(wrapped(as_sentence(text), line_length(context, has_icon=icon != "NONE"))):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE", translate=False)


def is_narrow(context: bpy.types.Context) -> bool:
    """Whether someone has made the sidebar so narrow that two buttons beside each other would be cut."""
    return line_length(context, has_icon=False) < WIDE_CHARACTERS


def beside_or_below(context: bpy.types.Context, layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """A layout of two buttons, one below the other where the sidebar is narrow."""
    return layout.column(align=True) if is_narrow(context) else layout.row(align=True)


def wrapped(text: str, length: int) -> list[str]:
    """Lines of at most `length` characters, numbers with their units; longer words are cut. Empty text has no line."""
    held = UNIT.sub("\N{NO-BREAK SPACE}", text)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in textwrap.wrap(held, length)]


def line_length(context: bpy.types.Context, *, has_icon: bool) -> int:
    """Characters that fit into a line of the sidebar as it is drawn, beside an icon if it has one."""
    scale = context.preferences.system.ui_scale
    pixels = context.region.width / scale - 40 - 20 * has_icon
    return max(FEWEST_CHARACTERS, int(pixels / PIXELS_PER_CHARACTER))


classes = (
    XIHE_PT_virtual_objects,
    XIHE_PT_camera_path,
    XIHE_PT_picture,
    XIHE_UL_effects,
    XIHE_PT_effects,
    XIHE_PT_estimator,
    XIHE_PT_estimator_details,
    XIHE_PT_run,
    XIHE_PT_apply,
    XIHE_PT_results,
)
register, unregister = bpy.utils.register_classes_factory(classes)
