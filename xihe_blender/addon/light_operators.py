"""The last run's light: shown on the objects, put onto the timeline again, or taken away with all that a run left."""

from __future__ import annotations

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.addon.live_light import read_ahead
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.apply.datablocks import ROOM

VIEW_BEFORE = "xihe_view"
"""Custom property of the lit scene: how the 3D view was shaded, from where it looked, and the lines it showed."""

FLOOR = ("show_floor", "show_axis_x", "show_axis_y")
"""Lines that would lie over the captured frame, which is itself an overlay."""


class XIHE_OT_apply_light(Action, bpy.types.Operator):
    bl_idname = "xihe.apply_light"
    bl_label = "Apply"
    bl_description = "Put the light of the last run onto the timeline again, with its triggers, errors and pictures"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.has_cycles, polls.has_last_run)

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.addon.results_in_blender import apply_results

        apply_results(context.scene, last_run_folder(context.scene))


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

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.addon.results_in_blender import show_lit

        scene, active = context.scene, context.view_layer.objects.active
        lit = show_lit(scene, last_run_folder(scene), active.name if active else "")
        if context.window is not None:
            _enter(context, lit)
            read_ahead(scene)


class XIHE_OT_show_room(polls.Conditional, bpy.types.Operator):
    bl_idname = "xihe.show_room"
    bl_label = "Back to Room"
    bl_description = "Go back to the scene that the run was made of"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_lit_scene)

    def execute(self, context: bpy.types.Context) -> set[str]:
        lit = context.scene
        room = lit[ROOM]
        if room is None:
            self.report({"ERROR"}, "The room's scene is gone from this file")
            return {"CANCELLED"}
        room.frame_set(lit.frame_current)
        if context.window is not None:
            context.window.scene = room
        if VIEW_BEFORE in lit and context.area.type == "VIEW_3D":
            space = context.area.spaces.active
            space.shading.type, space.region_3d.view_perspective, *shown = lit[VIEW_BEFORE].split()
            for line in FLOOR:
                setattr(space.overlay, line, line in shown)
        return {"FINISHED"}


def _enter(context: bpy.types.Context, lit: bpy.types.Scene) -> None:
    """Show `lit` in the window, and rendered through its camera in the 3D view that asked."""
    context.window.scene = lit
    context.window.view_layer = next(layer for layer in lit.view_layers if layer.world_override == lit.world)
    if context.area is not None and context.area.type == "VIEW_3D":
        space = context.area.spaces.active
        shown = [line for line in FLOOR if getattr(space.overlay, line)]
        lit[VIEW_BEFORE] = " ".join([space.shading.type, space.region_3d.view_perspective, *shown])
        space.shading.type, space.region_3d.view_perspective = "RENDERED", "CAMERA"
        for line in FLOOR:
            setattr(space.overlay, line, False)


class XIHE_OT_remove_light(Action, bpy.types.Operator):
    bl_idname = "xihe.remove_light"
    bl_label = "Remove"
    bl_description = "Delete everything that runs added to this file: worlds, markers, curves and pictures"
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_own_scene, polls.has_light)

    def act(self, context: bpy.types.Context) -> None:
        from xihe_blender.addon.results_in_blender import remove_everything

        remove_everything(context.scene)


register, unregister = bpy.utils.register_classes_factory(
    (XIHE_OT_apply_light, XIHE_OT_show_lit, XIHE_OT_show_room, XIHE_OT_remove_light)
)
