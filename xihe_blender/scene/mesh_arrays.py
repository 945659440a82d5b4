"""A mesh as arrays: what one holds, and one that is made of them; Blender copies all of an array at once."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.records import ArrayInt


def array_of(items: Any, name: str, dtype: type, width: int = 1) -> NDArray[Any]:
    """(N, `width`) what attribute `name` of each of the items holds; (N,) for a width of 1."""
    values: NDArray[Any] = np.empty(len(items) * width, dtype)
    items.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


def fill_mesh(mesh: bpy.types.Mesh, points: ArrayLike, corners: ArrayInt, starts: ArrayInt) -> None:
    """Smooth faces in an empty mesh: the numbers of their `points` (P, 3) in a row, and where each face starts there.

    For light probes: from_pydata() takes longer than all else that is done to the scene.
    """
    places = np.asarray(points, np.float32)
    mesh.vertices.add(len(places))
    mesh.loops.add(len(corners))
    mesh.polygons.add(len(starts))
    mesh.vertices.foreach_set("co", places.ravel())
    mesh.loops.foreach_set("vertex_index", corners.astype(np.int32))
    mesh.polygons.foreach_set("loop_start", starts.astype(np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
