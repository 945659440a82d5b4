"""Materials of finishes: one function per kind of finish, over the project's own surfaces."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from xihe_blender.lab.props import surfaces
from xihe_blender.lab.rooms.room_data import Finish

MAKERS: dict[str, Callable[[str, Finish], bpy.types.Material]] = {
    "plain": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness),
    "metal": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness, metallic=1.0),
    "leather": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness),
    "paint": lambda name, f: surfaces.paint(name, f.colour, roughness=f.roughness),
    "wood": lambda name, f: surfaces.wood(name, f.colour, f.second, roughness=f.roughness),
    "fabric": lambda name, f: surfaces.fabric(name, f.colour, weave_per_m=max(f.scale, 40.0)),
    "carpet": lambda name, f: surfaces.carpet(name, f.colour, f.second, surfaces.shade(f.second, 1.6)),
    "foliage": lambda name, f: surfaces.foliage(name, f.colour, f.second),
    "painting": lambda name, f: surfaces.painting(
        name, [(0.3, f.colour), (0.5, f.second), (0.7, surfaces.shade(f.colour, 1.8))]
    ),
    "patches": lambda name, f: surfaces.patches(name, f.colour, f.second, size_m=f.scale, roughness=f.roughness),
    "glass": lambda name, f: surfaces.plain(name, f.colour, roughness=f.roughness, transmission_weight=1.0),
    "planks": lambda name, f: surfaces.planks(name, f.colour, f.second, width_m=f.scale),
    "tiles": lambda name, f: _tiled(name, f, upright=False),
    "wall tiles": lambda name, f: _tiled(name, f, upright=True),
    "brick": lambda name, f: surfaces.masonry(
        name, (f.colour, f.second, (0.5, 0.48, 0.45)), (0.24, 0.075), upright=True
    ),
}


def material_of(name: str, finish: Finish) -> bpy.types.Material:
    """A new material. KeyError for a kind of finish that nobody makes."""
    return MAKERS[finish.kind](name, finish)


def _tiled(name: str, finish: Finish, *, upright: bool) -> bpy.types.Material:
    tones = (finish.colour, finish.second, surfaces.shade(finish.colour, 0.5))
    side = finish.scale
    return surfaces.masonry(
        name, tones, (side, side), joint_m=0.006, upright=upright, offset=0.0, roughness=finish.roughness
    )
