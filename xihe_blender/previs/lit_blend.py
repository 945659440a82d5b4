"""The lit .blend: a copy of the user's file with a second scene, `Xihe Lit`, for the artist to go on with.

It holds only the virtual objects, each in a view layer under its own keyed world, film transparent, ready to be put
over the captured frames.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy

from xihe_blender.apply import key_suns
from xihe_blender.apply.datablocks import LIT_SCENE, OF_RUN, RUN_BESIDE, applied_worlds, remove_lit_collections
from xihe_blender.apply.lit_scene import bring_lamps, leave_compositor, remove_lit_scene, set_up_lit_scene, show_only_in
from xihe_blender.apply.shadow_catchers import (
    catch_shadows,
    catch_shadows_of,
    catcher_name,
    make_shadow_catcher,
    remove_shadow_catchers,
    shadow_catchers,
    triangles_of,
)
from xihe_blender.capture.render import can_denoise
from xihe_blender.scene.blend_file import ROOM, save_copy
from xihe_blender.scene.phone_capture import scan_of
from xihe_blender.scene.state import copied_scene, remove_copied_scene
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera_path.surfaces import Surface

OUTPUT_PREFIX = "xihe_lit_"
"""Begins the names of the files that the lit scene renders, so that those of the room stay."""

LIFTED_M = 0.003
"""Of a catcher: copies of the room's own surfaces hold out what is behind them, and it must not be."""


def make_lit_scene(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], surfaces: Mapping[str, Sequence[Surface]]
) -> bpy.types.Scene:
    """A copy of `scene` with only `objects`, each in a view layer under the world that a run left for it.

    `surfaces` are those that catch shadows, by object; the scan of a recording does in their place. KeyError for an
    object without a world.
    """
    found = applied_worlds(scene)
    worlds = {item.name: found[item.name] for item in objects}
    lit = copied_scene(scene)
    lit.name = LIT_SCENE
    # A copied scene has no user, and what has none is not saved.
    lit.use_extra_user = True
    for layer in list(lit.view_layers)[1:]:
        lit.view_layers.remove(layer)
    set_up_lit_scene(lit, objects, {world.name: (name, world) for name, world in worlds.items()})
    suns = key_suns.applied_suns(scene)
    for name in suns.keys() & worlds.keys():
        show_only_in(lit, suns[name], [worlds[name].name])
    scan = scan_of(scene) if suns else None
    triangles = None if scan is None else triangles_of(scan)
    for name in [name for name in worlds if triangles is not None or surfaces.get(name)]:
        catcher = make_shadow_catcher(catcher_name(name))
        if triangles is not None:
            catch_shadows_of(catcher, triangles)
        else:
            catch_shadows(catcher, surfaces[name], metres_per_unit(scene), LIFTED_M)
        show_only_in(lit, catcher, [worlds[name].name])
    bring_lamps(lit)
    leave_compositor(lit)
    lit.world = next(iter(worlds.values()))
    name = re.split(r"[/\\]", lit.render.filepath)[-1]
    lit.render.filepath = f"{lit.render.filepath.removesuffix(name)}{OUTPUT_PREFIX}{name}"
    lit.render.engine, lit.render.use_multiview = "CYCLES", False  # A phone takes one picture, not one for each eye.
    # Denoised as the report's pictures are. A build without the denoiser would refuse to render with it.
    lit.cycles.use_denoising = can_denoise(lit) and lit.cycles.use_denoising
    return lit


def save_lit_blend(
    scene: bpy.types.Scene, objects: Sequence[bpy.types.Object], surfaces: Mapping[str, Sequence[Surface]], path: Path
) -> None:
    """Save a copy of the open file as `path`, in the run's folder, with the scene `Xihe Lit` in it.

    Whole or not at all; OSError if not.
    """
    remove_lit_scene()
    lit = make_lit_scene(scene, objects, surfaces)
    # The panel shows the run that the file is of: the copied scene may still know an earlier one, or none.
    lit[ROOM], lit[RUN_BESIDE], lit[OF_RUN] = scene, "//", path.parent.name
    try:
        save_copy(lit, path, compress=True)
    finally:
        remove_shadow_catchers(shadow_catchers(lit))
        remove_copied_scene(lit)
        remove_lit_collections()
