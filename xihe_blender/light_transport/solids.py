"""Surfaces that a ray meets in a scene as it is rendered: those of a dependency graph, asked without rendering.

Chosen: one tree of all triangles in the world, 0.1 s for 50,000 of them. Rejected: `Scene.ray_cast`, which goes by what
the viewport shows whatever graph it is given, so that a ceiling hidden to look into the room is not there, and in 5.2
meets what is hidden in renders; and a tree per mesh with boxes around the instances, which takes a ray ten times as
long in Python. Beyond a million triangles an instance counts as the box around it. Strands, points and volumes are left
out: light passes between and through them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

from xihe_blender.scene.units import metres_per_unit
from xihenet.records import ArrayF64, ArrayInt

MESHED = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META"})
MAX_TRIANGLES = 1_000_000
BOX_TRIANGLES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]
    + [[1, 5, 7], [1, 7, 3]]
)
"""Of the corners in the order of `np.ndindex(2, 2, 2)`."""
BOX_ORDER = [0, 1, 3, 2, 4, 5, 7, 6]
"""Blender's order of a bounding box' corners (x, then z, then y turn by turn), as `np.ndindex(2, 2, 2)` has them."""

Look = tuple[str, float | None]  # a surface in words, and its albedo, which is None where light passes


class Solids:
    """The surfaces of an evaluated graph, in metres; holds nothing of it, so that it may outlive it.

    `is_met` says whether rays meet an instance, `look` is asked for every slot that a face has. `met` is what rays have
    met so far, in words; `is_exact` whether no instance counts as a box.
    """

    def __init__(
        self,
        depsgraph: bpy.types.Depsgraph,
        is_met: Callable[[Any], bool],
        look: Callable[[bpy.types.Object, int], Look],
    ) -> None:
        points, triangles, surfaces = [np.zeros((0, 3))], [np.zeros((0, 3), np.intp)], [np.zeros(0, np.intp)]
        looks: dict[Look, int] = {}
        n_points = n_triangles = 0
        for instance in depsgraph.object_instances:
            item = instance.object
            if item.type not in MESHED or not is_met(instance):
                continue
            corners, faces, slots = _triangles(item, is_boxed=n_triangles > MAX_TRIANGLES)
            world = np.array(instance.matrix_world) * metres_per_unit(depsgraph.scene)
            points.append(corners @ world[:3, :3].T + world[:3, 3])
            triangles.append(faces + n_points)
            used, which = np.unique(slots, return_inverse=True)
            numbers = [looks.setdefault(look(item, int(slot)), len(looks)) for slot in used]
            surfaces.append(np.array(numbers, np.intp)[which])
            n_points, n_triangles = n_points + len(corners), n_triangles + len(faces)
        self.met: set[str] = set()
        self.is_exact = n_triangles <= MAX_TRIANGLES
        self._looks, self._surfaces = list(looks), np.concatenate(surfaces)
        self._points, self._triangles = np.concatenate(points), np.concatenate(triangles)
        self._tree = BVHTree.FromPolygons(self._points.tolist(), self._triangles.tolist(), all_triangles=True)

    def nearest(self, place: Vector, direction: Vector) -> tuple[Vector, Vector, float | None] | None:
        """The first surface from `place` along the unit vector `direction`, in the world; None if there is none.

        Where, its unit normal (as the mesh has it, not towards the ray), and its albedo, None where light passes.
        """
        where, normal, triangle, _ = self._tree.ray_cast(place, direction)
        if where is None:
            return None
        words, albedo = self._looks[self._surfaces[triangle]]
        self.met.add(words)
        return where, normal, albedo

    def points_on(self, words: str, n: int, rng: np.random.Generator) -> ArrayF64:
        """(n, 3) points at random, evenly over all surfaces that are called `words`; (0, 3) where there is none."""
        numbers = [number for number, (name, _) in enumerate(self._looks) if name == words]
        corners = self._points[self._triangles[np.isin(self._surfaces, numbers)]]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if areas.sum() <= 0:
            return np.zeros((0, 3))
        drawn = rng.choice(len(areas), n, p=areas / areas.sum())
        points: ArrayF64 = np.einsum("nc,ncx->nx", rng.dirichlet((1, 1, 1), n), corners[drawn])
        return points


def _triangles(item: bpy.types.Object, *, is_boxed: bool) -> tuple[ArrayF64, ArrayInt, ArrayInt]:
    """Corners (P, 3) in the object's own space, triangles (T, 3) of them, and the material slot (T,) of each."""
    if is_boxed:
        return np.array(item.bound_box, np.float64)[BOX_ORDER], BOX_TRIANGLES, np.zeros(len(BOX_TRIANGLES), np.intp)
    mesh = undivided_mesh(item) if item.type == "MESH" else item.to_mesh()
    if mesh is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.intp), np.zeros(0, np.intp)
    mesh.calc_loop_triangles()
    points = np.empty(3 * len(mesh.vertices), np.float32)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    slots = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.vertices.foreach_get("co", points)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    mesh.loop_triangles.foreach_get("material_index", slots)
    if item.type != "MESH":
        item.to_mesh_clear()
    return points.reshape(-1, 3).astype(np.float64), triangles.reshape(-1, 3).astype(np.intp), slots.astype(np.intp)


def undivided_mesh(item: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh of an evaluated object, or the original where that is only subdivided: to ask for more divides it.

    350 ms for a vase, at every frame. The original has the same materials, and is about where the smooth surface is.
    """
    is_only_divided = bool(item.modifiers) and all(modifier.type == "SUBSURF" for modifier in item.modifiers)
    return item.original.data if is_only_divided else item.data
