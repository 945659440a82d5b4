"""The enclosure of light by a room: how often light bounces before it is lost, and how many diffuse bounces follow.

A walk of light: rays leave through the phone's picture, or from an estimation position in all directions, and at each
surface go on in a diffuse direction, weaker by the surface's albedo. What they carry to the k-th surface says how much
of the picture the k-th bounce can make. In a closed room of albedo 0.7 that is 0.7^k; over bare ground nothing after
the first. No light is sampled: a lamp shows at every bounce alike. Glass and transparent surfaces are passed. To walk
from within a virtual object, leave it out of the graph: its inside is no room.

Chosen: as many rays leave each surface as came to the first, drawn from those that arrived, by what they carry.
Rejected: to follow each ray until it is lost, by which few are left for a corner in an open place, and none for its
third bounce.

Surfaces are those of a dependency graph, in one tree of all triangles in the world, 0.1 s for 50,000 of them. Rejected:
`Scene.ray_cast`, which goes by what the viewport shows whatever graph it is given, so that a ceiling hidden to look
into the room is not there, and in 5.2 meets what is hidden in renders; and a tree per mesh with boxes around the
instances, which takes a ray ten times as long in Python. Beyond a million triangles an instance counts as the box
around it. Strands, points and volumes are left out: light passes between and through them.

Source: a closed room whose walls of albedo a all glow alike leaves out a^(n + 1) of its light with n bounces, which is
what the walk says. A lamp sampled directly leaves out less: measured in a closed room of albedo 0.7, against 12 bounces
a picture is 24 % (n = 2), 11 % (4) and 2 % (8) too dark, and the walk says 34, 17 and 4 %, on the careful side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from numpy.typing import NDArray

from xihe_blender.scene.mesh_arrays import array_of
from xihe_blender.scene.units import metres_per_unit
from xihenet.records import ArrayF64, ArrayInt
from xihenet.sphere import AnchorLattice

N_RAYS = 100
MAX_BOUNCES = 32  # of any kind, as in Blender's own preset "Full Global Illumination"
N_SURFACES = MAX_BOUNCES + 2
GRAZING = 0.01  # cosine to the normal, below which a ray may slip along a face and past the edge of the next
MAX_PASSED = 8
OFFSET_M = 1e-4
LEFT_OUT = 2e-4
"""Share of the light that may be cut. The mean of a small picture over 16 seeds is known to some 3e-4, where a cut of
1e-3 was seen. Late bounces are nearly free, since Cycles ends weak paths by chance: 32 in place of 8 cost 0 to 5 %."""

Ray = tuple[Vector, Vector]  # where it starts, and its direction, in the world, metres

MESHED = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META"})
MAX_TRIANGLES = 1_000_000
BOX_TRIANGLES = np.array(
    [[0, 1, 2], [0, 2, 3], [4, 7, 6], [4, 6, 5], [0, 4, 5], [0, 5, 1], [3, 2, 6], [3, 6, 7], [0, 3, 7], [0, 7, 4]]
    + [[1, 5, 6], [1, 6, 2]]
)
"""Of the corners of a bounding box in Blender's order, where x, then z, then y turn by turn."""

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
        self._surfaces = np.concatenate(surfaces)
        self._looks = list(looks)
        self._looks_of_triangles = [self._looks[number] for number in self._surfaces.tolist()]
        self._points, self._triangles = np.concatenate(points), np.concatenate(triangles)
        self._tree = BVHTree.FromPolygons(_rows(self._points), _rows(self._triangles), all_triangles=True)

    def next_surface(self, place: Vector, direction: Vector) -> tuple[Vector, Vector, float] | None:
        """Where a ray ends, just above the surface, the unit normal on its side, and the albedo; None where it is lost.

        `direction` is a unit vector. From on the surface, 10 of 340,000 rays in a closed room of 4 x 4 x 3 m left it
        through a corner; so, none.
        """
        for _ in range(MAX_PASSED):
            where, normal, triangle, _ = self._tree.ray_cast(place, direction)
            if where is None:
                return None
            words, albedo = self._looks_of_triangles[triangle]
            self.met.add(words)
            if albedo is not None:
                if normal.dot(direction) >= 0:
                    normal.negate()
                return where + normal * OFFSET_M, normal, albedo
            place = where + direction * OFFSET_M
        return None

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
        return np.array(item.bound_box, np.float64), BOX_TRIANGLES, np.zeros(len(BOX_TRIANGLES), np.intp)
    mesh = undivided_mesh(item) if item.type == "MESH" else item.to_mesh()
    if mesh is None:
        return np.zeros((0, 3)), np.zeros((0, 3), np.intp), np.zeros(0, np.intp)
    mesh.calc_loop_triangles()
    points = array_of(mesh.vertices, "co", np.float32, 3).astype(np.float64)
    triangles = array_of(mesh.loop_triangles, "vertices", np.int32, 3).astype(np.intp)
    slots = array_of(mesh.loop_triangles, "material_index", np.int32).astype(np.intp)
    if item.type != "MESH":
        item.to_mesh_clear()
    return points, triangles, slots


def _rows(table: NDArray[Any]) -> list[tuple[Any, ...]]:
    """Its rows as Python's numbers: by columns, since a list of each row takes three times as long."""
    return list(zip(*table.T.tolist(), strict=True))


def undivided_mesh(item: bpy.types.Object) -> bpy.types.Mesh:
    """The mesh of an evaluated object, or the original where that is only subdivided: to ask for more divides it.

    350 ms for a vase, at every frame. The original has the same materials, and is about where the smooth surface is.
    """
    is_only_divided = bool(item.modifiers) and all(modifier.type == "SUBSURF" for modifier in item.modifiers)
    return item.original.data if is_only_divided else item.data


def rays_all_round(origins: Sequence[Sequence[float]]) -> list[Ray]:
    """Rays in all directions from `origins` (world, metres), some N_RAYS in all; empty without an origin."""
    directions = AnchorLattice(max(16, N_RAYS // max(1, len(origins)))).directions
    return [(Vector(origin), Vector(direction)) for origin in origins for direction in directions]


def rays_through_picture(camera: bpy.types.Object, scene: bpy.types.Scene) -> list[Ray]:
    """Rays through an even grid of the picture of an evaluated `camera`; all round for one that is not perspective."""
    place = camera.matrix_world.translation * metres_per_unit(scene)
    if camera.type != "CAMERA" or camera.data.type != "PERSP":
        return rays_all_round([tuple(place)])
    right_top, right_bottom, left_bottom, left_top = camera.data.view_frame(scene=scene)
    world_from_camera = camera.matrix_world.to_3x3().normalized()
    along = (np.arange(round(N_RAYS**0.5)) + 0.5) / round(N_RAYS**0.5)
    grid = [left_bottom.lerp(right_bottom, x).lerp(left_top.lerp(right_top, x), y) for y in along for x in along]
    return [(place.copy(), (world_from_camera @ direction).normalized()) for direction in grid]


def carried(solids: Solids, rays: Sequence[Ray], rng: np.random.Generator) -> tuple[ArrayF64, list[Ray]]:
    """(N_SURFACES,) share of `rays` that reach a k-th surface, weakened on the way, and where, with normals."""
    weights, reached = np.zeros(N_SURFACES), []
    weight = 1.0
    for surface in range(N_SURFACES):
        hits = [hit for ray in rays if (hit := solids.next_surface(*ray)) is not None]
        reached += [(place, normal) for place, normal, _ in hits]
        albedos = np.array([share for _, _, share in hits])
        if albedos.sum() <= 0:
            weights[surface] = weight * len(hits) / max(1, len(rays))
            break
        weight *= len(hits) / len(rays)
        weights[surface] = weight
        weight *= albedos.mean()
        if weight < 0.1 * LEFT_OUT * weights.sum():
            break
        drawn = rng.choice(len(hits), N_RAYS, p=albedos / albedos.sum())
        # All at once: drawn one by one they took half of the time.
        steps = rng.normal(size=(N_RAYS, 3)).tolist()
        rays = [(hits[k][0], _diffuse_direction(hits[k][1], step)) for k, step in zip(drawn, steps, strict=True)]
    return weights, reached


def aim(solids: Solids, starts: Sequence[Ray], targets: ArrayF64, rng: np.random.Generator) -> None:
    """Send a ray to each of `targets` (N, 3) from one of `starts` at random, if it is on the side that this faces."""
    for target in targets if len(starts) else ():
        place, facing = starts[rng.integers(len(starts))]
        direction = (Vector(target) - place).normalized()
        if direction.dot(facing) > GRAZING:
            solids.next_surface(place, direction)


def _diffuse_direction(normal: Vector, step: Sequence[float]) -> Vector:
    """Cosine-distributed about `normal` for a normally distributed `step`: on the sphere that touches there."""
    direction = Vector(step)
    direction.normalize()
    direction += normal
    if direction.length <= 1e-6:
        return normal
    direction.normalize()
    return direction


def bounces_needed(weights: ArrayF64) -> int:
    """Diffuse bounces, at least 2, after which no more than LEFT_OUT of what `carried` gives is left out.

    With n bounces light of the first n + 1 surfaces is seen. What all surfaces together would carry are those walked
    to, and the rest as it goes on from the last ones.
    """
    before, last = weights[-2], weights[-1]
    kept = min(last / before, 0.99) if before > 0 else 0.0
    total = float(weights.sum() + last * kept / (1 - kept))
    left_out = 1.0 - np.cumsum(weights) / total if total > 0 else np.zeros(len(weights))
    enough = np.flatnonzero(left_out <= LEFT_OUT)
    return int(np.clip(enough[0] if len(enough) else MAX_BOUNCES, 2, MAX_BOUNCES))
