"""Opening the user's .blend in background, with one clear line where that cannot be done."""

from __future__ import annotations

from pathlib import Path

import bpy

from xihe_blender.errors import UserError

_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")
"""A .blend as it is, compressed with Zstandard (since 3.0), compressed with gzip (before)."""


def open_blend(path: Path) -> bpy.types.Scene:
    """The active scene of the .blend at `path`. Scripts in the file are not run. UserError if it cannot be opened."""
    if not path.exists():
        raise UserError(f"{path}: no such file")
    if path.is_dir():
        raise UserError(f"{path} is a folder: give a .blend file")
    with path.open("rb") as file:
        start = file.read(7)
    if not start.startswith(_MAGIC):
        raise UserError(f"{path} is not a .blend file")
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise UserError(f"{path} cannot be opened by Blender {bpy.app.version_string}: {error}") from error
    return bpy.context.scene
