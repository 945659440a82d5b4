"""Files that a render reads besides the open .blend.

Who takes up earlier work asks whether one of them has changed since. They are patterns of `glob`, so that their content
can be looked at again without Blender, and a frame that joins a sequence is seen as well.

Left out are pictures of our own, what is only looked at (behind a camera, in an editor, by the compositor), and caches
of simulations that are not baked: Blender writes those itself as frames go by. Rejected: `bpy.utils.blend_paths()`,
which names sounds and edited footage too, and of a sequence its first frame.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.apply.datablocks import PREFIX
from xihe_blender.io.folder_manifest import absolute_pattern
from xihe_blender.scene.blend_file import NodePath, cache_folder, paths_of_modifiers, paths_of_nodes, point_caches

LOOKED_AT_IN = (
    bpy.types.Camera, bpy.types.Scene, bpy.types.CompositorNodeTree, bpy.types.Screen, bpy.types.WorkSpace,
    bpy.types.WindowManager,
)  # fmt: skip
"""Users of a picture or a film that no render shows: runs use neither the compositor nor the sequencer of a scene."""

POINTS = "*.bphys"
"""Of `point_caches`, in a folder that may hold anything else, such as the runs themselves."""


def files_read() -> list[str]:
    """Absolute patterns, sorted: of single files, all tiles of a picture, all frames of a sequence, all in a folder."""
    return sorted(absolute_pattern(pattern, blend_folder()) for pattern in files_named())


def files_named() -> list[str]:
    """The same, but relative to the folder of the open .blend where the scene names them so: it may be moved."""
    return sorted({*_blocks(), *_nodes(), *_caches()})


def blend_folder() -> Path:
    return Path(bpy.data.filepath).parent


def file_of(block: Any) -> str | None:
    """What an image, film, volume, font, library or cache of moving meshes is read from: a pattern as of `files_named`.

    None for one that is within the .blend.
    """
    is_packed = getattr(block, "packed_file", None) is not None or len(getattr(block, "packed_files", ()))
    if is_packed or block.filepath in ("", "<builtin>") or getattr(block, "source", "") in ("GENERATED", "VIEWER"):
        return None
    is_sequence = getattr(block, "is_sequence", False) or getattr(block, "source", "") == "SEQUENCE"
    return pattern_of(block.filepath, block.library, is_sequence=is_sequence)


def _blocks() -> Iterator[str]:
    """Libraries, pictures and films, volumes, fonts, and files of meshes that move (Alembic, USD)."""
    shown = (*_shown(bpy.data.images), *_shown(bpy.data.movieclips))
    # From Blender 5.0 on what is linked may be packed: of some libraries all is in the .blend itself.
    libraries = [
        library
        for library in bpy.data.libraries
        if not all(getattr(block, "is_linked_packed", False) for block in library.users_id)
    ]
    others = (*libraries, *bpy.data.volumes, *bpy.data.cache_files, *bpy.data.fonts)
    yield from filter(None, map(file_of, (*shown, *others)))
    for cache in bpy.data.cache_files:
        yield from (pattern_of(layer.filepath, cache.library) for layer in cache.layers)


def _shown(blocks: Any) -> Iterator[Any]:
    """Those of the pictures or clips that a render may show."""
    users = bpy.data.user_map(subset=list(blocks))
    for block, of_block in users.items():
        if not block.name.startswith(PREFIX) and any(not isinstance(user, LOOKED_AT_IN) for user in of_block):
            yield block


def _nodes() -> Iterator[str]:
    """IES files, scripts in OSL, and what geometry nodes import."""
    for owner in (*bpy.data.materials, *bpy.data.lights, *bpy.data.worlds, *bpy.data.node_groups):
        tree = owner if isinstance(owner, bpy.types.NodeTree) else owner.node_tree
        nodes = tree.nodes if tree is not None else ()
        paths = [getattr(node, "filepath", "") for node in nodes if getattr(node, "mode", "EXTERNAL") == "EXTERNAL"]
        yield from (pattern_of(path, owner.library) for path in paths if path)
    for tree in bpy.data.node_groups:
        yield from (_pattern_of_node_path(tree, one) for one in paths_of_nodes(tree))
    for item in bpy.data.objects:
        yield from (_pattern_of_node_path(item, one) for one in paths_of_modifiers(item))


def _pattern_of_node_path(owner: bpy.types.ID, one: NodePath) -> str:
    """Of all files whose path begins so, where nodes join the rest."""
    pattern = pattern_of(one.path, owner.library)
    return pattern if one.is_whole else str(Path(pattern, "*")) if one.path.endswith(("/", "\\")) else f"{pattern}*"


def _caches() -> Iterator[str]:
    """What modifiers and baked simulations keep in files."""
    for item in bpy.data.objects:
        for modifier in item.modifiers:
            fluid, file = (getattr(modifier, name, None) for name in ("domain_settings", "filepath"))
            bakes = [bake for bake in getattr(modifier, "bakes", ()) if bake.use_custom_path]
            folders = [getattr(modifier, "bake_directory", None), *(bake.directory for bake in bakes)]
            if fluid is not None and fluid.cache_type != "REPLAY":
                folders.append(fluid.cache_directory)
            if modifier.type == "OCEAN":
                folders.append(file if modifier.is_cached else None)
            elif file:
                yield pattern_of(file, item.library)
            yield from (str(Path(pattern_of(folder, item.library), "**", "*")) for folder in folders if folder)
    for owner, cache in point_caches():
        library = owner.library if cache.use_library_path else None
        file = bpy.path.basename(bpy.data.filepath if library is None else library.filepath)
        beside = f"//{cache_folder(Path(file)).name}" if cache.use_disk_cache and cache.is_baked else ""
        folder = cache.filepath if cache.use_external else beside
        if folder:
            yield str(Path(pattern_of(folder, library), POINTS))


def pattern_of(path: str, library: bpy.types.Library | None, *, is_sequence: bool = False) -> str:
    """The pattern, as of `files_named`, of what Blender reads at `path` for a data-block of `library`."""
    named = _from_blend(path, library)
    name = glob.escape(named.name).replace("<UDIM>", 4 * "[0-9]").replace("<UVTILE>", "u*_v*")
    if is_sequence:
        # The last number before the suffix, as Blender counts.
        stem, dot, suffix = name.rpartition(".")
        name = re.sub(r"\d+(?=\D*$)", "[0-9]*", stem or suffix, count=1) + (f"{dot}{suffix}" if stem else "")
    return str(Path(glob.escape(str(named.parent)), name))


def _from_blend(path: str, library: bpy.types.Library | None) -> Path:
    """`path`, which starts from its library if it is relative, from the folder of the open .blend."""
    if not path.startswith("//"):
        return Path(path)
    below = path[2:].replace("\\", "/")  # As of `absolute`.
    return (Path() if library is None else _from_blend(library.filepath, None).parent) / below
