"""Estimation positions: where in space is the light of a virtual object estimated?

One position stands for a small object (the paper's setting). An object bigger than SPACING_M gets several, the
centres of an even split of its world bounding box, so that a long shelf is not lit as one point. Where an object moves
they move with it: they are as many as in the first frame, and the box turns as the object does.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import GEOMETRY_TYPES
from xihenet.records import ArrayF64

SPACING_M = 1.0
"""An axis of the world bounding box longer than this is split evenly into cells no longer than this."""

# A box of exactly n spacings is split in n, although its world corners carry float32 rounding.
SPLIT_TOLERANCE = 1e-5

RENDERED_TYPES = GEOMETRY_TYPES - {"CURVE"}
"""Of instances: a curve's surface is a mesh beside it, and its own box is a unit too large on all sides."""

MAX_POSITIONS = 1000
"""Of one object. Each gets a light probe in every frame; a shop of 100 x 10 m has as many."""


def estimation_positions(object: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> ArrayF64:
    """(K, 3) world, metres, K >= 1: where the light of a virtual object is estimated.

    At the frame of `depsgraph`, by default the context's: the centre of its box or the centres of its cells, x slowest
    and z fastest; modifiers and instances count. An object without geometry has its origin. UserError if it has no
    finite box, or more than MAX_POSITIONS.
    """
    return _positions_in_box(object, box_corners_m(object, depsgraph or bpy.context.evaluated_depsgraph_get()))


def _positions_in_box(object: bpy.types.Object, corners_m: ArrayF64) -> ArrayF64:
    low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
    if not np.isfinite([low_m, high_m]).all():
        raise UserError(
            f"virtual object {object.name!r} has no finite position: check its scale, its vertices and its constraints"
        )
    n_positions = cells_per_axis(low_m, high_m, SPACING_M).prod()
    if n_positions > MAX_POSITIONS:
        size = " x ".join(f"{side:.3g}" for side in high_m - low_m)
        raise UserError(
            f"virtual object {object.name!r} is {size} m and would be estimated at {n_positions:.4g} positions: "
            "make it smaller, split it, or set the unit scale (Scene > Units) to the metres in a Blender unit"
        )
    return box_cell_centres(low_m, high_m, SPACING_M)


def named_positions(
    object: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None, *, corners_m: ArrayF64 | None = None
) -> dict[str, ArrayF64]:
    """`estimation_positions`, (3,) each, by name: that of the object, and a number where it has several.

    `corners_m` of its box, from whoever asks for many objects: see `all_box_corners_m`.
    """
    positions = estimation_positions(object, depsgraph) if corners_m is None else _positions_in_box(object, corners_m)
    if len(positions) == 1:
        return {object.name: positions[0]}
    return {f"{object.name} {k}": position for k, position in enumerate(positions, start=1)}


def cells_per_axis(low_m: ArrayF64, high_m: ArrayF64, spacing_m: float) -> ArrayF64:
    """(3,) whole numbers from 1 on; float64, since those of a box as large as float32 fit no integer."""
    cells: ArrayF64 = np.maximum(1.0, np.ceil((high_m - low_m) / spacing_m - SPLIT_TOLERANCE))
    return cells


def box_cell_centres(low_m: ArrayF64, high_m: ArrayF64, spacing_m: float) -> ArrayF64:
    """Centres (K, 3) of the even split of an axis-aligned box into cells of at most `spacing_m` along each axis."""
    n_cells = cells_per_axis(low_m, high_m, spacing_m).astype(int)
    axes = [low + (high - low) * (np.arange(n) + 0.5) / n for low, high, n in zip(low_m, high_m, n_cells, strict=True)]
    centres: ArrayF64 = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return centres


def box_corners_m(object: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> ArrayF64:
    """Box corners (8 n, 3), world, metres, of all that `object` puts into the render; its origin if nothing."""
    return all_box_corners_m([object], depsgraph)[object]


def all_box_corners_m(
    objects: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> dict[bpy.types.Object, ArrayF64]:
    """`box_corners_m` of each object; all that is rendered is gone through once, 12 ms for 20,000 instances."""
    boxes = _rendered_boxes(objects, depsgraph)
    return {item: _corners_m(item, of_item, depsgraph) for item, of_item in boxes.items()}


def _rendered_boxes(
    objects: Iterable[bpy.types.Object], depsgraph: bpy.types.Depsgraph
) -> dict[bpy.types.Object, list[ArrayF64]]:
    """World corners (8, 3), in Blender units, of each thing that an object puts into the render."""
    boxes: dict[bpy.types.Object, list[ArrayF64]] = {item: [] for item in objects}
    for instance in depsgraph.object_instances:
        source = instance.parent if instance.is_instance else instance.object
        of_source = None if source is None else boxes.get(source.original)
        if of_source is not None and instance.object.type in RENDERED_TYPES:
            of_source.append(_transformed(instance.object.bound_box, instance.matrix_world))
    return boxes


def _corners_m(object: bpy.types.Object, boxes: list[ArrayF64], depsgraph: bpy.types.Depsgraph) -> ArrayF64:
    evaluated = object.evaluated_get(depsgraph)
    if not boxes and object.type in GEOMETRY_TYPES:
        # Not among the instances: hidden in this view layer, which does not move it.
        corners = _corners_of_curve(evaluated) if object.type == "CURVE" else evaluated.bound_box
        boxes = [_transformed(corners, evaluated.matrix_world)]
    corners = np.concatenate(boxes) if boxes else np.array([evaluated.matrix_world.translation], np.float64)
    return corners * metres_per_unit(depsgraph.scene)


def _corners_of_curve(evaluated: bpy.types.Object) -> Any:
    """Two corners (2, 3) of what a curve puts into the render; (1, 3) its origin if nothing."""
    mesh = evaluated.to_mesh()
    places = [tuple(vertex.co) for vertex in mesh.vertices] if mesh is not None else []
    evaluated.to_mesh_clear()
    return [*zip(*((min(axis), max(axis)) for axis in zip(*places, strict=True)), strict=True)] or [(0.0, 0.0, 0.0)]


def _transformed(corners: Any, world_from_object: Any) -> ArrayF64:
    """Corners (8, 3) through a 4x4 matrix, in float64."""
    matrix = np.array(world_from_object, np.float64)
    moved: ArrayF64 = np.array(corners, np.float64).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
