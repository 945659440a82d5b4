"""The last run's light: shown on the objects, put onto the timeline again, or taken away with all that a run left."""

from __future__ import annotations

from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.addon.live_light import light_the_new, read_ahead
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.scene.blend_file import ROOM

VIEW_BEFORE = "xihe_view"
"""Custom property of the lit scene: how the 3D view was shaded, from where it looked, and the lines it showed."""

LAYER_BEFORE = "xihe_view_layer"
"""Custom property of the lit scene: the view layer of the room that the window showed."""

LINES = ("show_floor", "show_axis_x", "show_axis_y", "show_relationship_lines")
"""Lines that would lie over the captured frame, which is itself an overlay."""


_views: dict[int, str] = {}
"""The same by area, while the file is open: Undo and Remove Light take the lit scene away. The number is Blender's."""

_showed: set[int] = set()
"""Areas that have shown the lit scene: Undo and Redo bring it back, but not how the view was shaded."""


class XIHE_OT_apply_light(Action, bpy.types.Operator):
    bl_idname = "xihe.apply_light"
    bl_label = "Apply Light"
    bl_description = "Put the light of the last run onto the timeline again, with its triggers, errors and pictures"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles, polls.has_last_run)

    def act(self, context: bpy.types.Context) -> str | None:
        from xihe_blender.addon.results_in_blender import apply_results, left_out

        scene, folder = context.scene, last_run_folder(context.scene)
        apply_results(scene, folder)
        return left_out(scene, folder)


class XIHE_OT_show_lit(Action, bpy.types.Operator):
    bl_idname = "xihe.show_lit"
    bl_label = "Show Lit"
    bl_description = (
        "Show the virtual objects under their estimated light over the captured frames, in a scene of its own that "
        "plays on the timeline and renders. The viewport shows the light of the active object; the view layer in the "
        "corner of the window chooses another. What stands in front of an object hides it"
    )
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles, polls.has_last_run)

    def act(self, context: bpy.types.Context) -> str | None:
        from xihe_blender.addon.results_in_blender import left_out, show_lit
        from xihe_blender.apply.lit_scene import keep_added

        keep_added()
        scene, folder, active = context.scene, last_run_folder(context.scene), context.view_layer.objects.active
        unlit = light_the_new(scene)
        lit = show_lit(scene, folder, active.name if active else "")
        context.window_manager.xihe.ended_in = ""
        if context.window is not None:
            _enter(context, lit)
            read_ahead(scene)
        return left_out(scene, folder) or unlit


class XIHE_OT_show_room(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.show_room"
    bl_label = "Back to Room"
    bl_description = "Go back to the room's scene"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.leaves_the_file, polls.is_lit_scene)

    def execute(self, context: bpy.types.Context) -> set[str]:
        from xihe_blender.apply.lit_scene import keep_added

        lit = context.scene
        room = lit[ROOM]
        if room is None:
            self.report({"ERROR"}, "The room's scene is gone from this file")
            return {"CANCELLED"}
        if added := keep_added():
            names = ", ".join(item.name for item in added)
            said = f"What you added in Xihe Lit is now in the room too, in the collection Xihe Virtual: {names}"
            self.report(
                {"INFO"}, f"{said}. Show Lit gives objects light of their own; lamps and cameras stay in Xihe Lit"
            )
        room.frame_set(lit.frame_current)
        if context.window is not None:
            context.window.scene = room
            context.window.view_layer = room.view_layers.get(lit.get(LAYER_BEFORE, ""), context.window.view_layer)
        if VIEW_BEFORE in lit and context.area.type == "VIEW_3D" and context.area.as_pointer() not in _views:
            _put_back(context.area, lit[VIEW_BEFORE])
        _put_views_back()
        return {"FINISHED"}


def _enter(context: bpy.types.Context, lit: bpy.types.Scene) -> None:
    """Show `lit` in the window, and rendered through its camera in the 3D view that asked."""
    lit[LAYER_BEFORE], active = context.window.view_layer.name, context.view_layer.objects.active
    context.window.scene = lit
    layer = next((one for one in lit.view_layers if one.world_override == lit.world), lit.view_layers[0])
    context.window.view_layer = layer
    if active is not None and active.mode == "OBJECT" and active in set(layer.objects):
        layer.objects.active = active
    if context.area is not None and context.area.type == "VIEW_3D":
        lit[VIEW_BEFORE] = _show_rendered(context.area)


def _show_rendered(area: bpy.types.Area) -> str:
    """Show the lit scene in `area`, through its camera; how the view was before."""
    space, view = area.spaces.active, area.spaces.active.region_3d
    shown = [line for line in LINES if getattr(space.overlay, line)]
    place = [*view.view_rotation, *view.view_location, view.view_distance]
    before = " ".join([space.shading.type, view.view_perspective, *map(str, place), *shown])
    space.shading.type, view.view_perspective = "RENDERED", "CAMERA"
    for line in LINES:
        setattr(space.overlay, line, False)
    _showed.add(area.as_pointer())
    return _views.setdefault(area.as_pointer(), before)


def _views_3d(*, of_lit: bool) -> list[bpy.types.Area]:
    """The 3D views of all windows, or of those that show the lit scene."""
    windows = [one for one in bpy.context.window_manager.windows if not of_lit or ROOM in one.scene]
    return [area for window in windows for area in window.screen.areas if area.type == "VIEW_3D"]


def _put_views_back() -> None:
    for area in _views_3d(of_lit=False):
        if area.as_pointer() in _views:
            _put_back(area, _views[area.as_pointer()])
    _views.clear()


def _put_back(area: bpy.types.Area, before: str) -> None:
    space, view = area.spaces.active, area.spaces.active.region_3d
    space.shading.type, view.view_perspective, *shown = before.split()
    place = [float(word) for word in shown if not word.startswith("show_")]
    # Through a camera, Blender forgets from where the view looked before; a file of an earlier version holds none.
    if place and view.view_perspective != "CAMERA":
        view.view_rotation, view.view_location, view.view_distance = place[:4], place[4:7], place[7]
    for line in LINES:
        setattr(space.overlay, line, line in shown)


def _has_left() -> bool:
    """Whether the lit scene was shown, and no window shows it any more."""
    return bool(_views) and not any(ROOM in window.scene for window in bpy.context.window_manager.windows)


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    if _has_left():
        _put_views_back()
    for area in () if _views else _views_3d(of_lit=True):
        if area.as_pointer() in _showed:
            _show_rendered(area)


@bpy.app.handlers.persistent
def _after_update(*_: Any) -> None:
    """With the lit scene deleted in Blender's own menu of scenes; not while Blender evaluates."""
    if _has_left() and not bpy.app.timers.is_registered(_after_undo):
        bpy.app.timers.register(_after_undo, first_interval=0.0)


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    _views.clear()
    _showed.clear()
    for window in bpy.context.window_manager.windows:
        if VIEW_BEFORE in window.scene:
            for area in window.screen.areas:
                _show_again(area, window.scene[VIEW_BEFORE])
    _listen()


def _show_again(area: bpy.types.Area, before: str) -> None:
    """Render a view that showed the lit scene when its file was saved: Blender opens it in Solid."""
    space = area.spaces.active
    if area.type != "VIEW_3D" or space.region_3d.view_perspective != "CAMERA":
        return
    if not any(getattr(space.overlay, line) for line in LINES):
        _views[area.as_pointer()] = before
        if space.shading.type == "SOLID":
            _show_rendered(area)


def _listen() -> None:
    """To another scene being chosen in Blender's own menu; loading a file ends it."""
    bpy.msgbus.clear_by_owner(_views)
    bpy.msgbus.subscribe_rna(key=(bpy.types.Window, "scene"), owner=_views, args=(), notify=_after_undo)


class XIHE_OT_remove_light(Action, bpy.types.Operator):
    bl_idname = "xihe.remove_light"
    bl_label = "Remove Light"
    bl_description = (
        "Delete everything that runs added to this file: the scene Xihe Lit, worlds, lamps, markers, pictures, the "
        "placement map and the camera Xihe Better Path. The runs' folders stay"
    )
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, polls.has_light)

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.addon.results_in_blender import remove_everything

        remove_everything()
        _put_views_back()


_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (XIHE_OT_apply_light, XIHE_OT_show_lit, XIHE_OT_show_room, XIHE_OT_remove_light)
)

HANDLERS = {
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "depsgraph_update_post": _after_update,
    "load_post": _after_load,
}


def register() -> None:
    _register_classes()
    _listen()


def unregister() -> None:
    bpy.msgbus.clear_by_owner(_views)
    _views.clear()
    _showed.clear()
    _unregister_classes()
