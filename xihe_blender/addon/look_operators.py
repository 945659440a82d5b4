"""A better look: where should the phone look to know an object's light better? Asked of the last run, and shown.

The advice lives in the window manager: it is of a run, not of the file. `advice_for` is what panel and overlay show.
"""

from __future__ import annotations

import json
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.addon.modal_job import ModalJob, redraw
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.apply.datablocks import better_path_camera
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.jobs import Job
from xihe_blender.scene.virtual_objects import virtual_objects


def asked_objects(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The active virtual object; all of them where another object is active."""
    items = virtual_objects(context.scene)
    return [item for item in items if item == context.object] or items


def advice_for(context: bpy.types.Context) -> list[Any]:
    """The rows of advice from the run that is shown, for the objects in question; each has `name` and `sentence`."""
    names, folder = {item.name for item in asked_objects(context)}, context.scene.xihe.run_folder
    return [row for row in context.window_manager.xihe.looks if row.name in names and row.run_folder == folder]


def other_cameras(context: bpy.types.Context) -> bool:
    """Whether markers would take the place of the camera that does an advised look, once it is the scene's."""
    better = better_path_camera()
    return better is not None and any(one.camera not in (None, better) for one in context.scene.timeline_markers)


def has_look(context: bpy.types.Context) -> str | None:
    return None if any(row.look for row in advice_for(context)) else "Ask where to look first"


class XIHE_OT_look_where(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.look_where"
    bl_label = "Look Where?"
    bl_description = (
        "Find where, and at which frame, the phone should look for a second to know the light at the active virtual "
        "object better, from the frames of the last run; nothing is rendered"
    )
    bl_options = {"REGISTER"}
    cancelled = "Nothing was found out"
    conditions = (polls.is_idle, polls.is_room, polls.has_last_run, polls.has_virtual_objects)

    def start_job(self, context: bpy.types.Context) -> Job[Any]:
        from xihe_blender.previs.better_path import looks_of_run
        from xihe_blender.scene.estimation_positions import named_positions

        depsgraph = context.evaluated_depsgraph_get()
        objects = {item.name: list(named_positions(item, depsgraph).values()) for item in asked_objects(context)}
        self.folder = context.scene.xihe.run_folder
        return looks_of_run(last_run_folder(context.scene), objects)

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        rows = context.window_manager.xihe.looks
        for advice in result:
            if advice.name in rows:
                rows.remove(rows.find(advice.name))
            row = rows.add()
            row.name, row.run_folder, row.sentence = advice.name, self.folder, advice.sentence
            if advice.look is not None:
                row.look = json.dumps(as_json(advice.look))
        redraw(context.window_manager, has_view_changed=True)
        # Blender's status bar cuts what is longer.
        said = [f"{advice.name}: {advice.in_short}" for advice in result]
        self.report({"INFO"}, said[0] if len(said) == 1 else f"The panel says where to look for {len(said)} objects")
        return {"FINISHED"}


class XIHE_OT_add_better_camera(Action, bpy.types.Operator):
    bl_idname = "xihe.add_better_camera"
    bl_label = "Add Camera"
    bl_description = (
        "Add the animated camera Xihe Better Path, which follows the path and looks where advised. To run with it, "
        "choose it as the scene's camera, set the scene's end to its last frame, and delete the markers that switch to "
        "other cameras. Remove Light takes it away"
    )
    bl_options = {"REGISTER", "UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.captures_are_rendered, polls.has_camera, has_look)

    def act(self, context: bpy.types.Context) -> str:
        from xihe_blender.io.look_results import LookAway
        from xihe_blender.previs.better_camera import add_better_camera

        row = next(row for row in advice_for(context) if row.look)
        look = from_json(LookAway, json.loads(row.look))
        camera, last = add_better_camera(context.scene, look)
        return f"Camera {camera.name} looks away at frame {look.frame} for {row.name}; its last frame is {last}"


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    bpy.context.window_manager.xihe.looks.clear()


HANDLERS = {"load_post": _after_load}
register, unregister = bpy.utils.register_classes_factory((XIHE_OT_look_where, XIHE_OT_add_better_camera))
