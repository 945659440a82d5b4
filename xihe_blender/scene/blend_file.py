"""Opening the user's .blend in background, with one clear line where that cannot be done; and copies of it elsewhere.

A copy has to read the same files. Blender turns most relative paths of what it saves into another folder, but not all,
and looks for simulations that were baked to disk in a folder beside the .blend that is called after it.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import link_or_copy
from xihenet.io.whole_files import written_whole

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


def save_copy(scene: bpy.types.Scene, path: Path, *, compress: bool = False) -> None:
    """Save a copy of the open file, with `scene` in it, as `path`, so that it reads the same files.

    Whole or not at all; OSError if not.
    """
    baked = list(_baked_beside())
    with written_whole(path) as beside:
        with _absolute_paths():
            bpy.ops.wm.save_as_mainfile(filepath=str(beside), copy=True, compress=compress)
        _check_is_whole(beside, scene.name)
    folder = cache_folder(path)
    shutil.rmtree(folder, ignore_errors=True)
    for file in baked:
        folder.mkdir(exist_ok=True)
        link_or_copy(file, folder / file.name)


def _check_is_whole(path: Path, scene_name: str) -> None:
    """OSError if Blender cannot read back what it saved: it does not say so when the end of a file did not fit."""
    with contextlib.suppress(OSError), bpy.data.libraries.load(str(path)) as (saved, _):
        if scene_name in saved.scenes:
            return
    raise OSError(errno.ENOSPC, "Blender could save only a part of it", str(path))


def cache_folder(blend: Path) -> Path:
    """Where Blender keeps the simulations of a .blend that are on disk."""
    return blend.with_name(f"blendcache_{blend.stem}")


def point_caches(item: bpy.types.Object) -> list[Any]:
    """Of cloth, hair, particles and soft bodies."""
    caches = [system.point_cache for system in item.particle_systems]
    return [*caches, *(modifier.point_cache for modifier in item.modifiers if hasattr(modifier, "point_cache"))]


def _own_caches() -> Iterator[tuple[bpy.types.Object, Any]]:
    """Those of a library's objects lie beside the library."""
    for item in [item for item in bpy.data.objects if item.library is None]:
        yield from ((item, cache) for cache in point_caches(item))


def _baked_beside() -> Iterator[Path]:
    """What was baked to disk; no other caches, since Blender would write into files that the copy shares."""
    for item, cache in _own_caches() if bpy.data.filepath else ():
        if cache.use_disk_cache and cache.is_baked and not cache.use_external:
            name = cache.name or item.name.encode().hex().upper()
            yield from cache_folder(Path(bpy.data.filepath)).glob(f"{glob.escape(name)}_*.bphys")


@contextlib.contextmanager
def _absolute_paths() -> Iterator[None]:
    """Make those relative paths absolute that Blender would leave as they are; put back at the end."""
    found = [(cache, "filepath") for _, cache in _own_caches() if cache.use_external]
    for item in [item for item in bpy.data.objects if item.library is None]:
        for modifier in [modifier for modifier in item.modifiers if modifier.type == "NODES"]:
            found += [(owner, "directory") for owner in modifier.bakes] + [(modifier, "bake_directory")]
    for tree in [tree for tree in bpy.data.node_groups if tree.library is None]:
        sockets = [socket for node in tree.nodes for socket in node.inputs]
        found += [(socket, "default_value") for socket in sockets if socket.bl_idname.endswith("FilePath")]
    before = [(owner, name, getattr(owner, name)) for owner, name in found if bpy.data.filepath]
    turned = [(owner, name, path) for owner, name, path in before if path.startswith("//")]
    try:
        for owner, name, path in turned:
            setattr(owner, name, bpy.path.abspath(path))
        yield
    finally:
        for owner, name, path in turned:
            setattr(owner, name, path)
