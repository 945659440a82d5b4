"""File > Import > Phone Recording: the recording of a phone becomes a part of the open scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.failures import Action
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.scene.phone_capture import ChosenCapture

UP = (
    ("USUAL", "As Usual", "The usual axis of the recording's format"),
    *((axis, axis.upper(), f"The recording's {axis.upper()} axis points up") for axis in ("z", "y", "x")),
    *((f"-{axis}", f"-{axis.upper()}", f"The recording's {axis.upper()} axis points down") for axis in ("z", "y", "x")),
)


class XIHE_OT_import_capture(Action, bpy.types.Operator):
    bl_idname = "xihe.import_capture"
    bl_label = "Import Phone Recording"
    bl_description = (
        "Import a recording with depth: a camera on the phone's path with the pictures behind it, and a scan of what "
        "they show, which catches shadows. Runs then estimate the light from the recording itself"
    )
    bl_options = {"UNDO"}
    conditions = (polls.is_idle, polls.is_room, polls.is_in_object_mode)

    filepath: bpy.props.StringProperty(
        name="Recording", description="Folder of the recording, a file in it, or its .r3d file", subtype="FILE_PATH"
    )
    up: bpy.props.EnumProperty(name="Up", description="Axis of the recording's world that points up", items=UP)
    scale: bpy.props.FloatProperty(
        name="Scale", description="Factor on all lengths of the recording", default=1.0, min=1e-6
    )
    floor_m: bpy.props.FloatProperty(
        name="Floor", description="Height of the floor in the scaled recording, in metres, which becomes 0"
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def act(self, context: bpy.types.Context) -> str:
        from xihe_blender.footage.import_capture import import_capture, recording_at

        if not self.filepath:
            raise UserError("No recording is chosen: choose its folder")
        manager = context.window_manager
        path = recording_at(Path(bpy.path.abspath(self.filepath)))
        chosen = ChosenCapture(path, None if self.up == "USUAL" else self.up, self.scale, self.floor_m)
        job = import_capture(context.scene, chosen)
        manager.progress_begin(0, 1)
        try:
            imported = run_blocking(job, lambda progress, _: manager.progress_update(progress.done / progress.total))
        finally:
            manager.progress_end()
        for item in context.selected_objects:
            item.select_set(False)
        context.view_layer.objects.active = imported.camera
        imported.camera.select_set(True)
        return " ".join(imported.said)


def _add_to_menu(menu: Any, _context: bpy.types.Context) -> None:
    menu.layout.operator(XIHE_OT_import_capture.bl_idname, text="Phone Recording")


_register_classes, _unregister_classes = bpy.utils.register_classes_factory((XIHE_OT_import_capture,))


def register() -> None:
    _register_classes()
    bpy.types.TOPBAR_MT_file_import.append(_add_to_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_file_import.remove(_add_to_menu)
    _unregister_classes()
