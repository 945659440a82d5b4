"""The preferences, for all files of a user: which phone to begin with, and where runs are kept.

The device that Cycles renders on is Blender's own preference, and is shown here as it is.
"""

from __future__ import annotations

import os
from pathlib import Path

import bpy

from xihe_blender.addon.choices import DEFAULT_PHONE, FROM_FILE, number_of, phone_items
from xihe_blender.io.old_runs import format_old_runs, runs_in

RUNS = "xihe_runs"


def path_chosen(chosen: XihePreferences, _context: bpy.types.Context) -> None:
    """Keep what holds for all files: before Blender 4.5 its file browser gives paths relative to the open one."""
    for name in ("phone_file", "cache_folder"):
        path = getattr(chosen, name)
        if path.startswith("//"):
            setattr(chosen, name, str(Path(bpy.path.abspath(path)).resolve()))


class XihePreferences(bpy.types.AddonPreferences):
    bl_idname = "xihe"

    phone: bpy.props.EnumProperty(
        name="Phone",
        description="Phone for scenes that do not choose one",
        items=phone_items,
        default=number_of(DEFAULT_PHONE),
    )
    phone_file: bpy.props.StringProperty(
        name="Phone File", description="TOML file that describes the phone", subtype="FILE_PATH", update=path_chosen
    )
    cache_folder: bpy.props.StringProperty(
        name="Runs Folder",
        description=(
            "Where runs from the panel are stored, one folder each. Empty: in xihe_runs beside the .blend, or, before "
            "that is saved, in Blender's folder for a user's files"
        ),
        subtype="DIR_PATH",
        update=path_chosen,
    )

    def draw(self, context: bpy.types.Context) -> None:
        from xihe_blender.capture.cycles_device import device_in_preferences

        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "phone")
        if self.phone == FROM_FILE:
            layout.prop(self, "phone_file")
        layout.prop(self, "cache_folder")
        self._draw_runs(layout)
        layout.label(text=f"Cycles renders on: {device_in_preferences()}. Change it in System.")

    def _draw_runs(self, layout: bpy.types.UILayout) -> None:
        """The space that runs take, and how to have it back."""
        # As properties are laid out: the label on the right of the first part.
        split = layout.split(factor=0.4)
        name = split.row()
        name.alignment = "RIGHT"
        name.label(text="Kept")
        row = split.row()
        row.label(text=format_old_runs(runs_in(runs_folder())), translate=False)
        row.operator("xihe.remove_old_runs", icon="TRASH")
        if not self.cache_folder:
            split = layout.split(factor=0.4)
            split.label()
            split.label(text=f"In {runs_folder()}", translate=False)


def preferences(context: bpy.types.Context) -> XihePreferences | None:
    """The user's preferences; None where the add-on is not enabled, as in a script that registered it by itself."""
    addon = context.preferences.addons.get(XihePreferences.bl_idname)
    return None if addon is None else addon.preferences


def runs_folder() -> Path:
    """Where runs from the panel are kept: the user's choice, else beside the open file, which may not be saved yet.

    Not in the extension's own place for files: Blender deletes that with the extension.
    """
    beside = _beside_file()
    if beside is None or not os.access(beside.parent, os.W_OK):
        beside = Path(bpy.utils.user_resource("DATAFILES")) / RUNS
    return chosen_folder() or beside


def folders_with_runs() -> list[Path]:
    """Where runs of the open file may lie: `runs_folder`, and beside the file, which was moved or given with them."""
    beside = _beside_file()
    return list(dict.fromkeys([runs_folder(), *([] if beside is None else [beside])]))


def _beside_file() -> Path | None:
    return Path(bpy.data.filepath).parent / RUNS if bpy.data.filepath else None


def chosen_folder() -> Path | None:
    """The Runs Folder of the user's preferences; None where none was chosen."""
    user = preferences(bpy.context)
    return Path(bpy.path.abspath(user.cache_folder)) if user is not None and user.cache_folder else None


def own_folder() -> Path:
    """The extension's own place for files."""
    try:
        return Path(bpy.utils.extension_path_user(XihePreferences.bl_idname))
    except ValueError:
        # Not installed as an extension, as where a script registered the add-on.
        return Path(bpy.utils.user_resource("DATAFILES", path="xihe"))


register, unregister = bpy.utils.register_classes_factory((XihePreferences,))
