"""What do the presets cost on the user's machine? Measured when asked for, and remembered for all files.

In a file of the add-on's own place, not in Blender's preferences: those are saved when the user says so. Panels read
its one sentence by the file's date, as they read the last run.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.addon import polls
from xihe_blender.addon.modal_job import ModalJob
from xihe_blender.addon.preferences import XihePreferences, preferences

FILE_NAME = "calibration.json"


class XIHE_OT_calibrate(polls.Conditional, ModalJob, bpy.types.Operator):
    bl_idname = "xihe.calibrate"
    bl_label = "Calibrate"
    bl_description = "Render a few small pictures of this scene to find out what each preset costs on this machine"
    bl_options = {"REGISTER"}
    cancelled = "Nothing was measured"
    conditions = (polls.is_idle, polls.has_cycles, polls.has_virtual_objects, polls.has_camera)

    def start_job(self, context: bpy.types.Context) -> Generator[Any, None, Any]:
        from xihe_blender.addon.run_settings import previs_settings
        from xihe_blender.evaluation.frontier.calibrate import calibrate

        return calibrate(context.scene, previs_settings(context.scene))

    def finish(self, context: bpy.types.Context, result: Any) -> set[str]:
        from xihe_blender.addon.failures import FAILURES, failed
        from xihe_blender.evaluation.frontier.calibrate import said_of_calibration, save_calibration

        try:
            save_calibration(calibration_file(context), result)
        except FAILURES as error:
            return failed(self, context, error)
        self.report({"INFO"}, said_of_calibration(result))
        return {"FINISHED"}


def calibration_file(context: bpy.types.Context) -> Path:
    """Where the costs are remembered: beside the runs, in the user's Runs Folder or the extension's own place."""
    user = preferences(context)
    if user is not None and user.cache_folder:
        return Path(bpy.path.abspath(user.cache_folder)) / FILE_NAME
    try:
        folder = Path(bpy.utils.extension_path_user(XihePreferences.bl_idname))
    except ValueError:
        # Not installed as an extension, as where a script registered the add-on.
        folder = Path(bpy.utils.user_resource("DATAFILES", path="xihe"))
    return folder / FILE_NAME


def calibration_in_words(context: bpy.types.Context) -> str:
    """The costs in one sentence; empty before they were measured."""
    path = calibration_file(context)
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError:
        return ""


@functools.lru_cache(maxsize=1)
def _read(path: Path, _changed: int) -> str:
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["said"])
    except (KeyError, TypeError, ValueError):
        return ""


register, unregister = bpy.utils.register_classes_factory((XIHE_OT_calibrate,))
