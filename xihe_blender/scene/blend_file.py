"""Opening the user's .blend in background, with one clear line where that cannot be done; and copies of it elsewhere.

A copy has to read the same files. Blender turns most relative paths of what it saves into another folder, but not all,
and looks for simulations that were baked to disk in a folder beside the .blend that is called after it.
"""

from __future__ import annotations

import contextlib
import errno
import glob
import operator
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import bpy

from xihe_blender.errors import UserError
from xihe_blender.io.outputs import link_or_copy
from xihenet.io.whole_files import written_whole

_MAGIC = (b"BLENDER", b"\x28\xb5\x2f\xfd", b"\x1f\x8b")
"""A .blend as it is, compressed with Zstandard (since 3.0), compressed with gzip (before)."""

ROOM = "xihe_room"
"""Custom property of the scene `Xihe Lit`: the scene that it shows the objects of."""


def open_blend(path: Path) -> bpy.types.Scene:
    """The active scene of the .blend at `path`; its room, where it was saved in `Xihe Lit`.

    Scripts in the file are not run. UserError if it cannot be opened.
    """
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
    bpy.context.window.scene = room_of(bpy.context.scene)
    return bpy.context.scene


def room_of(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The scene that has the run: `scene`, or the one that it shows the objects of."""
    return scene.get(ROOM) or scene


def absolute(path: str) -> str:
    """`path` from the folder of the open file, if it is relative to that: on Windows such a path has backslashes, which
    Blender reads on every system, and Python does not."""
    return str(bpy.path.abspath(path.replace("\\", "/") if path.startswith("//") else path))


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


def point_caches() -> Iterator[tuple[bpy.types.ID, Any]]:
    """Of cloth, hair, particles, soft bodies, dynamic paint and rigid bodies, with the object or scene that has it."""
    worlds = [(scene, scene.rigidbody_world) for scene in bpy.data.scenes]
    yield from ((scene, world.point_cache) for scene, world in worlds if world is not None)
    for item in bpy.data.objects:
        canvases = [getattr(modifier, "canvas_settings", None) for modifier in item.modifiers]
        surfaces = [surface for canvas in canvases if canvas is not None for surface in canvas.canvas_surfaces]
        for owner in (*item.particle_systems, *item.modifiers, *surfaces):
            if hasattr(owner, "point_cache"):
                yield item, owner.point_cache


class NodePath(NamedTuple):
    """A string of geometry nodes that is a path, or the beginning of one that nodes join; how it is set."""

    path: str
    is_whole: bool
    put: Callable[[str], None]


def paths_of_nodes(tree: bpy.types.NodeTree) -> Iterator[NodePath]:
    """Those that stand in a tree of geometry nodes; none of other trees."""
    for node in tree.nodes if tree.bl_idname == "GeometryNodeTree" else ():
        if node.bl_idname == "FunctionNodeInputString":
            yield from _path(node.string, False, partial(setattr, node, "string"))
        for socket in node.inputs:
            if socket.bl_idname.startswith("NodeSocketString") and not socket.is_linked:
                is_whole = socket.bl_idname.endswith("FilePath")
                yield from _path(socket.default_value, is_whole, partial(setattr, socket, "default_value"))


def paths_of_modifiers(item: bpy.types.Object) -> Iterator[NodePath]:
    """Those that the geometry nodes of an object are given in its modifiers."""
    for modifier in item.modifiers:
        tree = modifier.node_group if modifier.type == "NODES" else None
        for socket in tree.interface.items_tree if tree is not None else ():
            if socket.item_type == "SOCKET":
                value, put = modifier_input(modifier, socket.identifier)
                if isinstance(value, str):
                    yield from _path(value, socket.subtype == "FILE_PATH", put)


def modifier_input(modifier: bpy.types.NodesModifier, identifier: str) -> tuple[Any, Callable[[Any], None]]:
    """What a modifier gives to an input of its geometry nodes, None if it has no value, and how to give another."""
    inputs = getattr(getattr(modifier, "properties", None), "inputs", None)
    if inputs is not None:  # Blender 5.2
        given = getattr(inputs, identifier, None)
        return getattr(given, "value", None), partial(setattr, given, "value")
    return modifier.get(identifier), partial(operator.setitem, modifier, identifier)


def _path(text: str, is_whole: bool, put: Callable[[str], None]) -> Iterator[NodePath]:
    is_absolute = Path(text).is_absolute() and len(Path(text).parts) > 1  # "/" alone is what nodes join words with.
    if text.startswith("//") or is_absolute:
        yield NodePath(text, is_whole, put)


def _own_caches() -> Iterator[tuple[bpy.types.ID, Any]]:
    """Those of a library's objects lie beside the library."""
    return ((owner, cache) for owner, cache in point_caches() if owner.library is None)


def _baked_beside() -> Iterator[Path]:
    """What was baked to disk; no other caches, since Blender would write into files that the copy shares."""
    for owner, cache in _own_caches() if bpy.data.filepath else ():
        if cache.use_disk_cache and cache.is_baked and not cache.use_external:
            name = cache.name or owner.name.encode().hex().upper()
            yield from cache_folder(Path(bpy.data.filepath)).glob(f"{glob.escape(name)}_*.bphys")


@contextlib.contextmanager
def _absolute_paths() -> Iterator[None]:
    """Make those relative paths absolute that Blender would leave as they are; put back at the end."""
    kept: list[tuple[Any, str]] = [(cache, "filepath") for _, cache in _own_caches() if cache.use_external]
    items = [item for item in bpy.data.objects if item.library is None]
    for modifier in [modifier for item in items for modifier in item.modifiers if modifier.type == "NODES"]:
        kept += [*((bake, "directory") for bake in modifier.bakes), (modifier, "bake_directory")]
    found: list[tuple[str, Callable[[str], None]]]
    found = [(getattr(owner, name), partial(setattr, owner, name)) for owner, name in kept]
    trees = [tree for tree in bpy.data.node_groups if tree.library is None]
    of_nodes = (*map(paths_of_nodes, trees), *map(paths_of_modifiers, items))
    found += [(one.path, one.put) for paths in of_nodes for one in paths]
    turned = [(path, put) for path, put in found if bpy.data.filepath and path.startswith("//")]
    try:
        for path, put in turned:
            put(absolute(path))
        yield
    finally:
        for path, put in turned:
            put(path)
