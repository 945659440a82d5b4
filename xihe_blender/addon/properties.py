"""The panel's properties: of a scene, in its file, and of the job under way, in the window manager."""

from __future__ import annotations

from pathlib import Path

import bpy

from xihe_blender.addon import choices
from xihe_blender.addon.preferences import preferences
from xihe_blender.addon.runs_folder import found_folder, last_part
from xihe_blender.apply.datablocks import COMPARISON_NAME, image_named, placement_map
from xihe_blender.errors import UserError
from xihe_blender.scene.blend_file import room_of

LAST_FRAME = 1048574
RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set[str]()
"""Of a path that may begin with `//`, the folder of the .blend; before 4.5 every path may."""

OUR_WORDS = "Xihe"
"""Context of words that Blender translates for something else: Lattice is an object there, and Key a keyframe."""


def _map_shown(settings: XiheSceneSettings, _context: bpy.types.Context) -> None:
    """Its mesh too, whose edges Blender draws."""
    if (item := placement_map()) is not None:
        item.hide_viewport = not settings.show_map


def _override_changed(row: XiheEffectRow, context: bpy.types.Context) -> None:
    """Write the user's choice into the scene, where a run finds it; one that cannot be kept goes back to Auto."""
    from xihe_blender.light_transport.overrides import remember_overrides

    try:
        remember_overrides(row.id_data, {row.name: row.override.lower()})
    except UserError as error:
        context.window_manager.xihe.error = str(error)
        if row.override != "AUTO":  # Setting it calls this again.
            row.override = "AUTO"


def _wipe_changed(settings: XiheSceneSettings, context: bpy.types.Context) -> None:
    """Compose the comparison anew, if there is one in the file. Nothing if the run is gone."""
    from xihe_blender.addon.results_in_blender import show_comparison

    scene, folder = settings.id_data, last_run_folder(settings.id_data)
    if image_named(COMPARISON_NAME) is None or not (folder / "results.json").is_file():
        return
    try:
        shown = context.scene if room_of(context.scene) == scene else scene
        show_comparison(folder, shown.frame_current, settings.wipe)
    except UserError as error:
        context.window_manager.xihe.error = str(error)


def last_run_folder(scene: bpy.types.Scene) -> Path:
    """Folder of the run whose results are shown, as an absolute path."""
    return found_folder(scene.xihe.run_folder)


def _unshown_run(state: XiheJobState) -> str:
    """The newest run, unless a scene shows it. Asked anew each time, since Undo and Redo change what scenes show.

    By the name of its folder: a file and its runs may have been moved together.
    """
    shown = {last_part(scene.xihe.run_folder) for scene in bpy.data.scenes}
    return "" if last_part(state.newest_run) in shown else str(state.newest_run)


def _own_frames_wanted(settings: XiheSceneSettings, _context: bpy.types.Context) -> None:
    """Begin with the scene's own range."""
    scene = settings.id_data
    if settings.use_own_frames and not settings.is_property_set("frame_end"):
        settings.frame_start, settings.frame_end = scene.frame_start, scene.frame_end
        settings.frame_step = scene.frame_step


def _phone(settings: XiheSceneSettings) -> int:
    """The phone chosen for this scene, else the one in the preferences."""
    known = {name: number for name, *_, number in choices.phone_items(None, None)}
    user = preferences(bpy.context)
    name = settings.phone_name or (user.phone if user is not None else choices.DEFAULT_PHONE)
    return known.get(name, known[choices.DEFAULT_PHONE])


def _choose_phone(settings: XiheSceneSettings, number: int) -> None:
    settings.phone_name = next(name for name, *_, own in choices.phone_items(None, None) if own == number)
    _session_changed(settings)


def _session_changed(settings: XiheSceneSettings, _context: bpy.types.Context | None = None) -> None:
    """The effects listed are of another phone now; what the user wants of them stays with the scene."""
    settings.effects.clear()


def _state(row: XiheEffectRow) -> str:
    return str(row.required if row.override == "AUTO" else row.override.lower())


class XiheEffectRow(bpy.types.PropertyGroup):
    """An effect of light transport; `name` is the effect's."""

    required: bpy.props.StringProperty(name="Required", description="Whether the scene needs the effect: on or off")
    reason: bpy.props.StringProperty(name="Reason", description="Why the scene needs the effect or does not")
    is_switchable: bpy.props.BoolProperty(
        name="Switchable", description="Whether a run can switch the effect for the whole scene", default=True
    )
    override: bpy.props.EnumProperty(
        name="Override",
        description="Simulate or leave out the effect, whatever the scene needs; saved in the file",
        items=choices.OVERRIDES,
        update=_override_changed,
    )
    state: bpy.props.StringProperty(name="State", description="What a run does: on or off", get=_state)


class XiheSceneSettings(bpy.types.PropertyGroup):
    """What a run does with this scene, and which run was the last."""

    estimator: bpy.props.EnumProperty(
        name="Estimator",
        description="How the light is estimated from what the phone has seen",
        items=choices.estimator_items,
        translation_context=OUR_WORDS,
        default=choices.number_of(choices.DEFAULT_ESTIMATOR),
    )
    uses_edge_server: bpy.props.BoolProperty(
        name="Edge Server",
        description="Have this estimator answer on another machine or process: the one that runs xihe serve",
    )
    edge_server: bpy.props.StringProperty(
        name="Address", description="Where xihe serve listens", default="http://127.0.0.1:8550"
    )
    others: bpy.props.EnumProperty(
        name="Compare With",
        description="Other estimators, whose light and pictures are compared with it, from the same frames",
        items=choices.other_estimator_items,
        translation_context=OUR_WORDS,
        options={"ENUM_FLAG"},
    )
    preset: bpy.props.EnumProperty(
        name="Quality",
        description="How much time a run may spend on rendering",
        items=choices.preset_items,
        default=choices.number_of(choices.DEFAULT_PRESET),
    )
    target: bpy.props.EnumProperty(
        name="Target", description="Which light is estimated, and compared with the true one", items=choices.TARGETS
    )
    light: bpy.props.EnumProperty(
        name="Light", description="What the virtual objects are given of an estimate", items=choices.LIGHT_PARTS
    )
    use_own_frames: bpy.props.BoolProperty(
        name="Own Frames", description="Run on frames other than the scene's range and step", update=_own_frames_wanted
    )
    frame_start: bpy.props.IntProperty(
        name="Start", description="First frame of the camera path", default=1, min=-LAST_FRAME, max=LAST_FRAME
    )
    frame_end: bpy.props.IntProperty(
        name="End", description="Last frame of the camera path", default=250, min=-LAST_FRAME, max=LAST_FRAME
    )
    frame_step: bpy.props.IntProperty(
        name="Step", description="Capture one frame in this many", default=1, min=1, soft_max=24
    )
    captures_path: bpy.props.BoolProperty(
        name="Whole Path",
        description="Capture frames with no virtual object in view as well: the phone sees the room's lights there",
        default=True,
    )
    carries_light: bpy.props.BoolProperty(
        name="Carry Light",
        description="Until the next estimate, change the light in use as the light in view changes; else keep it",
        default=True,
    )
    phone_name: bpy.props.StringProperty(
        name="Phone Name", description="Phone chosen for this scene; empty for that of the preferences"
    )
    phone: bpy.props.EnumProperty(
        name="Phone",
        description="Which phone follows the camera path, with the errors of its sensors",
        items=choices.phone_items,
        get=_phone,
        set=_choose_phone,
    )
    phone_file: bpy.props.StringProperty(
        name="Phone File", description="TOML file that describes the phone", subtype="FILE_PATH", options=RELATIVE
    )
    network: bpy.props.EnumProperty(
        name="Network",
        description="Network between phone and server, which decides when estimates arrive",
        items=choices.network_items,
        default=choices.number_of(choices.NO_NETWORK),
        update=_session_changed,
    )
    use_own_size: bpy.props.BoolProperty(
        name="Own Size", description="Capture pictures of a size other than 256 by 192 pixels"
    )
    size: bpy.props.IntVectorProperty(
        name="Size",
        description="Width and height of captures and comparisons in pixels",
        size=2,
        default=(256, 192),
        min=4,
        max=8192,
        soft_max=1024,
    )
    use_own_exposure: bpy.props.BoolProperty(
        name="Own Exposure", description="Lock the phone's exposure at a factor instead of metering it"
    )
    exposure: bpy.props.FloatProperty(
        name="Exposure",
        description="Factor by which the scene's light is multiplied before the phone clips it at white",
        default=1.0,
        min=1e-6,
        soft_min=0.01,
        soft_max=100.0,
    )
    metering: bpy.props.EnumProperty(
        name="Metering",
        description="How the phone chooses its exposure",
        items=choices.METERINGS,
        translation_context=OUR_WORDS,
        default=choices.PHONES_METERING,
    )
    trigger: bpy.props.EnumProperty(
        name="Estimate When",
        description="When the light is estimated again. Fewer estimates cost less; the light in use is then older",
        items=choices.trigger_items,
        translation_context=OUR_WORDS,
        default=choices.number_of(choices.USUAL_TRIGGER),
    )
    seed: bpy.props.IntProperty(
        name="Seed", description="Seed of all random numbers; the same seed gives the same results", min=0
    )
    wipe: bpy.props.FloatProperty(
        name="Wipe",
        description="Where the dividing line is: estimate on its left, ground truth on its right",
        subtype="FACTOR",
        default=0.5,
        min=0.0,
        max=1.0,
        update=_wipe_changed,
    )
    run_folder: bpy.props.StringProperty(
        name="Last Run", description="Folder of the run whose results are shown", subtype="DIR_PATH"
    )
    begun_run: bpy.props.StringProperty(
        name="Begun Run",
        description="Folder of the run that was begun last: a file saved by another name meanwhile finds it by this",
        subtype="DIR_PATH",
    )
    budget_folder: bpy.props.StringProperty(
        name="Last Budget", description="Folder of the error budget that is shown", subtype="DIR_PATH"
    )
    run_made_of: bpy.props.StringProperty(
        name="Made Of", description="When the scene looked as the last run knows it; empty if it still does"
    )
    effects: bpy.props.CollectionProperty(
        name="Effects", description="The effects, and whether the scene needs them", type=XiheEffectRow
    )
    active_effect: bpy.props.IntProperty(name="Active Effect", description="The effect whose reason is shown")
    follows_objects: bpy.props.BoolProperty(
        name="Follow Objects",
        description="Light follows objects that are moved or added after a run, from the frames that the run kept",
        default=True,
    )
    maps_air: bpy.props.BoolProperty(
        name="In the Air", description="Map a grid in free air at a height, instead of upward surfaces"
    )
    map_height_m: bpy.props.FloatProperty(
        name="Height", description="Height of the grid, in metres above the world's origin", default=1.0, soft_min=0.0
    )
    map_place: bpy.props.IntProperty(
        name="Place", description="Place of the map that is marked; -1 for none", default=-1, min=-1
    )
    show_map: bpy.props.BoolProperty(
        name="Show Map", description="Draw the placement map over the 3D view", default=True, update=_map_shown
    )
    show_positions: bpy.props.BoolProperty(
        name="Show Positions",
        description="Show where the light of virtual objects is estimated, and how much was seen around there",
        default=True,
    )


class XiheLook(bpy.types.PropertyGroup):
    """Where the phone should look for the virtual object `name`, from the frames of one run."""

    run_folder: bpy.props.StringProperty(name="Run", description="Folder of the run, as the scene names it")
    sentence: bpy.props.StringProperty(name="Advice", description="Where to look, and what it is expected to bring")
    look: bpy.props.StringProperty(name="Look", description="All of it, as JSON; empty where no look would add much")


class XiheJobState(bpy.types.PropertyGroup):
    """The job under way; it lives in the window manager, so that Undo leaves it alone."""

    is_running: bpy.props.BoolProperty(name="Running", description="Whether a run is under way")
    is_cancel_wanted: bpy.props.BoolProperty(name="Cancel", description="Whether the run was told to stop")
    works_here: bpy.props.BoolProperty(
        name="In This File", description="Whether the job works in the open file, and not in a copy of it", default=True
    )
    newest_run: bpy.props.StringProperty(
        name="Newest Run", description="Folder of the newest run of the open file, whether or not it is shown"
    )
    unshown_run: bpy.props.StringProperty(
        name="Unshown Run",
        description="The same if no scene of the file shows it: it is under way, was stopped, or got lost",
        get=_unshown_run,
    )
    progress: bpy.props.FloatProperty(
        name="Progress", description="Share of the run that is done", subtype="FACTOR", min=0.0, max=1.0
    )
    doing: bpy.props.StringProperty(name="Doing", description="What the run is doing")
    seconds_left: bpy.props.FloatProperty(
        name="Time Left", description="Seconds left at the pace so far; 0 while unknown", min=0.0
    )
    error: bpy.props.StringProperty(name="Error", description="What went wrong last, in one line")
    ended_in: bpy.props.StringProperty(
        name="Ended In", description="Name of the scene whose run ended last, if the window showed another one then"
    )
    run_estimate: bpy.props.StringProperty(
        name="Run Time", description="How long a run would take on this machine, and how that was measured"
    )
    timed: bpy.props.StringProperty(name="Timed", description="Scene and settings for which the times were measured")
    budget_estimate: bpy.props.StringProperty(
        name="Budget Time", description="How long What Would Help? would take on this machine"
    )
    looks: bpy.props.CollectionProperty(
        name="Looks", description="Where the phone should look, by virtual object", type=XiheLook
    )


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (XiheEffectRow, XiheSceneSettings, XiheLook, XiheJobState)
)


def register() -> None:
    _register_classes()
    bpy.types.Scene.xihe = bpy.props.PointerProperty(
        name="Xihe", description="AR lighting previsualisation of this scene", type=XiheSceneSettings
    )
    bpy.types.WindowManager.xihe = bpy.props.PointerProperty(
        name="Xihe", description="The run under way", type=XiheJobState
    )


def unregister() -> None:
    del bpy.types.WindowManager.xihe
    del bpy.types.Scene.xihe
    _unregister_classes()
