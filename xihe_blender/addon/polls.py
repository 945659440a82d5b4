"""Polls: why can an operator not run now? One function per reason gives the sentence that Blender shows, or None.

Each operator lists what it needs, and the grey button says the first that is missing. Conditions run at every redraw,
so they look at names and flags alone.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import bpy

from xihe_blender.addon.background_run import BackgroundRun
from xihe_blender.addon.preferences import runs_folder
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.addon.runs_folder import RUN_IS_GONE, last_run, shown_runs
from xihe_blender.apply.datablocks import has_anything, trigger_markers
from xihe_blender.io.old_runs import old_runs, runs_in
from xihe_blender.scene.blend_file import ROOM
from xihe_blender.scene.phone_capture import IS_CAPTURED, remembered_capture
from xihe_blender.scene.virtual_objects import (
    ancestors,
    has_renderable_geometry,
    is_bare_curve,
    models_of_many_parts,
    rendered_collections,
    virtual_objects,
    with_parts,
)

Condition = Callable[[bpy.types.Context], str | None]


class Conditional:
    """Base of operators: greyed, with the reason, unless all their conditions hold."""

    conditions: tuple[Condition, ...] = ()
    poll_message_set: Callable[[str], None]
    """Of bpy.types.Operator."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        for condition in cls.conditions:
            message = condition(context)
            if message is not None:
                cls.poll_message_set(message)
                return False
        return True


def is_idle(context: bpy.types.Context) -> str | None:
    return "A run is under way: wait for it, or cancel it" if context.window_manager.xihe.is_running else None


def leaves_the_file(context: bpy.types.Context) -> str | None:
    """`is_idle`, or all that is under way is a run in a second Blender: results of the one before are still there."""
    return is_idle(context) if context.window_manager.xihe.works_here else None


def is_running(context: bpy.types.Context) -> str | None:
    return None if context.window_manager.xihe.is_running else "No run is under way"


def is_in_object_mode(context: bpy.types.Context) -> str | None:
    return None if context.mode == "OBJECT" else "Go to Object Mode first"


def is_own_scene(context: bpy.types.Context) -> str | None:
    """A scene that is linked from another file cannot be changed."""
    said = "The scene is linked from another file: open that file, or make the scene local"
    return None if context.scene.library is None else said


def is_room(context: bpy.types.Context) -> str | None:
    """`is_own_scene`, and it is not the one that shows a run's light."""
    return "This scene shows a run: go back to the room first" if shows_run(context) else is_own_scene(context)


def is_lit_scene(context: bpy.types.Context) -> str | None:
    return None if shows_run(context) else "This is the room: press Show Lit to see the objects lit"


def shows_run(context: bpy.types.Context) -> bool:
    """Whether the scene is `Xihe Lit`, which Show Lit made."""
    return ROOM in context.scene


def has_cycles(context: bpy.types.Context) -> str | None:
    is_enabled = "cycles" in context.preferences.addons
    return None if is_enabled else "Enable the add-on Cycles Render Engine in Blender's preferences"


def has_camera(context: bpy.types.Context) -> str | None:
    return None if _cameras(context.scene) else "Add a camera and animate it as the phone's path"


def has_virtual_objects(context: bpy.types.Context) -> str | None:
    return None if virtual_objects(context.scene) else "Make an object virtual first: select it, and add it above"


def doubts(scene: bpy.types.Scene) -> list[str]:
    """Why a run would tell little, in sentences: it is not refused. What the first look at the scene shows."""
    found = _doubts_of_objects(scene)
    if not any(map(may_move, _cameras(scene))):
        found.append("The camera does not move: the phone will see one side of the room alone")
    if not _has_room(scene):
        found.append("Only virtual objects are here: the phone will see no room whose light falls on them")
    if not _has_denoiser():
        found.append("This build of Blender has no denoiser: frames are noisy, or take more samples")
    return found


def _doubts_of_objects(scene: bpy.types.Scene) -> list[str]:
    virtual, rendered = virtual_objects(scene), rendered_collections(scene)
    unseen = [item.name for item in virtual if not _is_rendered(item, rendered)]
    bare = [item.name for item in virtual if is_bare_curve(item)]
    inserted = set(virtual)
    hanging = [item for item in scene.view_layers[0].objects if item.parent is not None and _hangs_on(item, inserted)]
    left = [item.name for item in hanging if _is_rendered(item, rendered)]
    around = [item.name for item in virtual if any(_encloses(item, camera) for camera in _cameras(scene))]
    found = []
    if unseen:
        are, them = ("is", "it") if len(unseen) == 1 else ("are", "them")
        found.append(f"{_named(unseen)} {are} disabled in renders: no picture will show {them}")
    if bare:
        has, it = ("has", "it") if len(bare) == 1 else ("have", "them")
        found.append(f"{_named(bare)} {has} no surface, only a curve: give {it} a bevel, an extrusion or a fill")
    if left:
        is_part, it = ("is", "it") if len(left) == 1 else ("are", "them")
        found.append(f"{_named(left)} {is_part} parented to a virtual object, but part of the room: add {it} too")
    if around:
        encloses, it = ("encloses", "is it") if len(around) == 1 else ("enclose", "are they")
        said = "Only what the phone inserts is to be virtual"
        found.append(f"{_named(around)} {encloses} the camera: {it} the room? {said}")
    return [*found, *(said for _, _, said in models_of_many_parts(virtual))]


def _named(names: list[str]) -> str:
    return repr(names[0]) if len(names) == 1 else f"{names[0]!r} and {len(names) - 1} more"


def _is_rendered(item: bpy.types.Object, rendered: set[bpy.types.Collection]) -> bool:
    """Whether renders show it, by itself and by one of its collections, at some frame at least."""
    return (not item.hide_render or _is_animated(item)) and not rendered.isdisjoint(item.users_collection)


def _hangs_on(item: bpy.types.Object, virtual: set[bpy.types.Object]) -> bool:
    """Whether it is a part of the room that is parented to a virtual object, maybe by others."""
    is_in_room = item not in virtual and has_renderable_geometry(item)
    return is_in_room and not virtual.isdisjoint(ancestors(item))


def _encloses(item: bpy.types.Object, camera: bpy.types.Object) -> bool:
    """Whether the camera is inside the object's bounding box, which turns with the object."""
    if item.type == "EMPTY":
        return False
    place = item.matrix_world.inverted_safe() @ camera.matrix_world.translation
    corners = [tuple(corner) for corner in item.bound_box]
    return all(min(axis) < along < max(axis) for axis, along in zip(zip(*corners, strict=True), place, strict=True))


def _cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    cameras = {marker.camera for marker in scene.timeline_markers} | {scene.camera}
    return [camera for camera in cameras if camera is not None]


def may_move(item: bpy.types.Object) -> bool:
    """Whether keys, drivers, constraints or physics could move it, or what it hangs on."""
    if _is_animated(item):
        return True
    if item.constraints or item.rigid_body is not None:
        return True
    return item.parent is not None and may_move(item.parent)


def _is_animated(item: bpy.types.Object) -> bool:
    animation = item.animation_data
    return animation is not None and bool(animation.action or animation.drivers or animation.nla_tracks)


def _has_room(scene: bpy.types.Scene) -> bool:
    """Whether an object that is not virtual has a surface. In a room the first few tell."""
    virtual = set(virtual_objects(scene))
    return any(item not in virtual and has_renderable_geometry(item) for item in scene.objects)


def _has_denoiser() -> bool:
    try:
        import _cycles
    except ImportError:  # Without Cycles nothing runs, which `has_cycles` says.
        return True
    return bool(_cycles.with_openimagedenoise)


def has_selected_room_objects(context: bpy.types.Context) -> str | None:
    if not context.selected_objects:
        return "Select the objects that the phone should insert"
    able = [item for item in with_parts(context.scene, context.selected_objects) if has_renderable_geometry(item)]
    if not able:
        return "None of the selected objects has a surface to light: select meshes, curves or texts"
    return "The selected objects are virtual already" if set(able) <= set(virtual_objects(context.scene)) else None


def has_selected_virtual_objects(context: bpy.types.Context) -> str | None:
    selected = with_parts(context.scene, context.selected_objects)
    is_one_selected = set(selected) & set(virtual_objects(context.scene))
    return None if is_one_selected else "Select virtual objects first"


def captures_are_rendered(context: bpy.types.Context) -> str | None:
    return None if remembered_capture(context.scene) is None else IS_CAPTURED


def has_last_run(context: bpy.types.Context) -> str | None:
    if not context.scene.xihe.run_folder:
        return "There are no results yet: run first"
    has_it = last_run_folder(context.scene).joinpath("results.json").is_file()
    return None if has_it else RUN_IS_GONE


def has_unshown_run(context: bpy.types.Context) -> str | None:
    folder = context.window_manager.xihe.unshown_run
    is_left = folder and BackgroundRun(Path(folder)).begun is not None
    return None if is_left else "No run of this file is left to go on with"


def has_old_runs(context: bpy.types.Context) -> str | None:
    folder = runs_folder()
    if old_runs(folder, shown_runs()):
        return None
    return "This file shows every run: there is none to remove" if runs_in(folder) else f"There are no runs in {folder}"


def has_report(context: bpy.types.Context) -> str | None:
    has_it = last_run_folder(context.scene).joinpath("report.html").is_file()
    return None if has_it else "The last run's report is gone: run again"


def has_comparison(context: bpy.types.Context) -> str | None:
    folder = last_run_folder(context.scene)
    if folder.joinpath("composited.mp4").is_file():
        return IS_CAPTURED
    # Not by looking for its pictures: a long run has tens of thousands of files beside them.
    run = last_run(context.scene.xihe.run_folder)
    has_it = run is not None and any(frame.compared is not None for frame in run.frames)
    return None if has_it else "The last run compared no frame: no virtual object was in view"


def has_light(context: bpy.types.Context) -> str | None:
    """Whether there is anything that a run, or Apply, leaves in a file."""
    return None if has_anything(context.scene) else "No run has added anything to this file"


def has_triggers(context: bpy.types.Context) -> str | None:
    has_any = trigger_markers(context.scene)
    return None if has_any else "There are no triggers on the timeline: run first, or apply the last run"
