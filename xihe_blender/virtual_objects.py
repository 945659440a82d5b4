"""Which objects are virtual, and where in space is their light estimated?

Virtual objects are what the phone would insert: they live in the collection `Xihe Virtual`, and everything outside it
is the room. A collection was chosen over a custom property because it shows in the outliner, hides as one and can be
excluded from a view layer; a naming rule was rejected because it breaks when an object is renamed.

One position stands for a small object (the paper's setting). An object bigger than `spacing_m` gets several, the
centres of an even split of its world bounding box, so that a long shelf is not lit as one point.

Not here: hiding the objects for a capture, and the worlds that light them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import bpy
import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.units import metres_per_unit
from xihenet.records import ArrayF64

COLLECTION_NAME = "Xihe Virtual"
NAME_PATTERN = re.compile(rf"{COLLECTION_NAME}(\.\d{{3,}})?")
"""Names are unique in a file: of two scenes, the second one's collection is "Xihe Virtual.001"."""

GEOMETRY_TYPES = frozenset({"MESH", "CURVE", "SURFACE", "FONT", "META", "VOLUME", "CURVES", "POINTCLOUD"})

# A box of exactly n spacings is split in n, although its world corners carry float32 rounding.
SPLIT_TOLERANCE = 1e-5

RIG_LOOKS: dict[str, dict[str, Any]] = {
    "Xihe Mirror Sphere": {"Base Color": (1.0, 1.0, 1.0, 1.0), "Metallic": 1.0, "Roughness": 0.0},
    "Xihe Matte Silver Sphere": {"Base Color": (0.9, 0.9, 0.9, 1.0), "Metallic": 1.0, "Roughness": 0.3271},
    "Xihe Diffuse Sphere": {"Base Color": (0.5, 0.5, 0.5, 1.0), "Roughness": 1.0, "Specular IOR Level": 0.0},
}


def virtual_collection(scene: bpy.types.Scene, *, create: bool = False) -> bpy.types.Collection | None:
    """The collection of virtual objects in `scene`, at any level below its master collection.

    Parameters
    ----------
    scene : searched by name, so that a collection of another scene in the same file is not found
    create : make the collection if it is missing; one that another scene shows stays that scene's

    Returns
    -------
    the collection, or None where there is none and `create` is False
    """
    found = [c for c in scene.collection.children_recursive if NAME_PATTERN.fullmatch(c.name)]
    if found:
        return min(found, key=lambda collection: collection.name)
    if not create:
        return None
    # A file that was appended to may hold the collection without any scene that shows it.
    collection = bpy.data.collections.get((COLLECTION_NAME, None))
    if collection is None or any(collection in other.collection.children_recursive for other in bpy.data.scenes):
        collection = bpy.data.collections.new(COLLECTION_NAME)
    scene.collection.children.link(collection)
    return collection


def virtual_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Objects with renderable geometry in the virtual collection and its children, sorted by name.

    Lights, cameras and plain empties are left out; an empty that instances a collection counts. Whether an object is
    hidden is not asked, because capture hides them itself. Empty without a collection.
    """
    collection = virtual_collection(scene)
    if collection is None:
        return []
    return sorted((o for o in collection.all_objects if has_renderable_geometry(o)), key=lambda o: o.name)


def make_virtual(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Move `objects` from the room of `scene` into its virtual collection, made if needed.

    An object is taken out of every collection of the room, since one that is in both would be captured and light
    itself; collections of other scenes keep it. Parents, children and transforms stay as they are. Objects without
    renderable geometry (lamps, cameras) are left where they are.

    Returns
    -------
    those that are virtual now. UserError, with nothing changed, for an object in a collection of another file
    """
    chosen = [item for item in objects if has_renderable_geometry(item)]
    virtual, room = _collections_of(scene)
    _check_are_own(chosen, [*virtual, *room])
    collection = virtual_collection(scene, create=bool(chosen))
    for item in chosen:
        assert collection is not None
        # Linked before it is unlinked, so that it stays selected.
        if not virtual & set(item.users_collection):
            collection.objects.link(item)
        for home in room & set(item.users_collection):
            home.objects.unlink(item)
    return chosen


def make_room(scene: bpy.types.Scene, objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Move virtual `objects` back into the room of `scene`, into its master collection.

    Returns
    -------
    those that were virtual. UserError, with nothing changed, for an object in a collection of another file
    """
    virtual, room = _collections_of(scene)
    chosen = [item for item in objects if virtual & set(item.users_collection)]
    _check_are_own(chosen, [*virtual, *room])
    for item in chosen:
        if not room & set(item.users_collection):
            scene.collection.objects.link(item)
        for home in virtual & set(item.users_collection):
            home.objects.unlink(item)
    return chosen


def _collections_of(scene: bpy.types.Scene) -> tuple[set[bpy.types.Collection], set[bpy.types.Collection]]:
    """The collections of virtual objects, and those of the room."""
    collection = virtual_collection(scene)
    virtual = set() if collection is None else {collection, *collection.children_recursive}
    return virtual, {scene.collection, *scene.collection.children_recursive} - virtual


def _check_are_own(objects: Sequence[bpy.types.Object], collections: Sequence[bpy.types.Collection]) -> None:
    """UserError if one of `objects` is in a collection that only its own file can change."""
    for home in (home for home in collections if home.library is not None):
        for item in objects:
            if home in item.users_collection:
                raise UserError(
                    f"object {item.name!r} is in collection {home.name!r}, which is linked from another file: "
                    "make that local first (Object > Relations > Make Local)"
                )


def has_renderable_geometry(object: bpy.types.Object) -> bool:
    """Whether `object` shows up in a render by itself, as geometry or as an instancing empty."""
    if object.type == "EMPTY":
        return object.instance_type == "COLLECTION" and object.instance_collection is not None
    return object.type in GEOMETRY_TYPES


def estimation_positions(
    object: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None, *, spacing_m: float = 1.0
) -> ArrayF64:
    """Positions at which the light of `object` is estimated.

    Parameters
    ----------
    object : a virtual object; modifiers and instances count
    depsgraph : evaluated at the frame in question; the current context's if None
    spacing_m : an axis of the world bounding box longer than this is split evenly into cells no longer than this

    Returns
    -------
    (K, 3) float64, world metres, K >= 1: the centre of the box or the centres of its cells, x slowest and z fastest.
    An object without geometry has its origin.

    Raises
    ------
    ValueError : if `spacing_m` is not positive and finite
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise ValueError(f"estimation_positions: spacing_m must be positive and finite, got {spacing_m}")
    depsgraph = depsgraph or bpy.context.evaluated_depsgraph_get()
    corners = world_box_corners(object, depsgraph) * metres_per_unit(depsgraph.scene)
    return box_cell_centres(corners.min(axis=0), corners.max(axis=0), spacing_m)


def box_cell_centres(low_m: ArrayF64, high_m: ArrayF64, spacing_m: float) -> ArrayF64:
    """Centres (K, 3) of the even split of an axis-aligned box into cells of at most `spacing_m` along each axis."""
    n_cells = np.maximum(1, np.ceil((high_m - low_m) / spacing_m - SPLIT_TOLERANCE)).astype(int)
    axes = [low + (high - low) * (np.arange(n) + 0.5) / n for low, high, n in zip(low_m, high_m, n_cells, strict=True)]
    centres: ArrayF64 = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return centres


def world_box_corners(object: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> ArrayF64:
    """Box corners (8 n, 3), in Blender units, of all that `object` puts into the render; its origin if nothing."""
    boxes = [_instance_corners(i) for i in depsgraph.object_instances if _belongs_to(i, object)]
    evaluated = object.evaluated_get(depsgraph)
    if not boxes and object.type in GEOMETRY_TYPES:
        # Not among the instances: hidden in this view layer, which does not move it.
        boxes = [_transformed(evaluated.bound_box, evaluated.matrix_world)]
    return np.concatenate(boxes) if boxes else np.array([evaluated.matrix_world.translation], np.float64)


def _belongs_to(instance: Any, object: bpy.types.Object) -> bool:
    source = instance.parent if instance.is_instance else instance.object
    return source is not None and source.original == object and instance.object.type in GEOMETRY_TYPES


def _instance_corners(instance: Any) -> ArrayF64:
    return _transformed(instance.object.bound_box, instance.matrix_world)


def _transformed(corners: Any, world_from_object: Any) -> ArrayF64:
    """Corners (8, 3) through a 4x4 matrix, in float64."""
    matrix = np.array(world_from_object, np.float64)
    moved: ArrayF64 = np.array(corners, np.float64).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def add_three_sphere_rig(
    scene: bpy.types.Scene, location: tuple[float, float, float], radius_m: float = 0.06
) -> list[bpy.types.Object]:
    """Put the usual three comparison spheres side by side along X, resting on `location`.

    Mirror, matte silver (roughness 0.3271) and grey diffuse (albedo 0.5, no specular) are what the field's
    comparisons render: together they show sharp reflections, the main light's direction and the irradiance.

    Parameters
    ----------
    scene : gets the virtual collection if it has none
    location : world point under the middle sphere, Blender units, as the 3D cursor has it
    radius_m : of each sphere, positive

    Returns
    -------
    three objects, each a virtual object of its own: mirror, matte silver, diffuse

    Raises
    ------
    ValueError : if `radius_m` is not positive and finite
    """
    if not (np.isfinite(radius_m) and radius_m > 0):
        raise ValueError(f"add_three_sphere_rig: radius_m must be positive and finite, got {radius_m}")
    collection = virtual_collection(scene, create=True)
    assert collection is not None
    x, y, z = location
    radius = radius_m / metres_per_unit(scene)
    spheres = []
    for step, (name, look) in zip((-1, 0, 1), RIG_LOOKS.items(), strict=True):
        sphere = bpy.data.objects.new(name, _sphere_mesh(name, radius))
        sphere.data.materials.append(_rig_material(name, look))
        sphere.location = (x + 2.3 * radius * step, y, z + radius)
        collection.objects.link(sphere)
        spheres.append(sphere)
    return spheres


def _sphere_mesh(name: str, radius: float, n_around: int = 64, n_up: int = 32) -> bpy.types.Mesh:
    """A smooth UV sphere around the origin; bmesh's own orders its vertices differently from version to version."""
    polar = np.pi * np.arange(1, n_up) / n_up
    azimuth = 2 * np.pi * np.arange(n_around) / n_around
    across, along = np.sin(polar)[:, None], np.cos(polar)[:, None] * np.ones(n_around)
    rings = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), along], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([rings, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]]) * radius
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], _sphere_faces(n_around, n_up - 1))
    mesh.shade_smooth()
    return mesh


def _sphere_faces(n_around: int, n_rings: int) -> list[tuple[int, ...]]:
    """Faces of rings from the top down, followed by the top and the bottom pole; they turn outwards."""
    ring = np.arange(n_around)
    after = np.roll(ring, -1)
    top, last = n_rings * n_around, (n_rings - 1) * n_around
    faces: list[tuple[int, ...]] = [(top, a, b) for a, b in zip(ring.tolist(), after.tolist(), strict=True)]
    faces += [(top + 1, last + b, last + a) for a, b in zip(ring.tolist(), after.tolist(), strict=True)]
    for upper in range(0, last, n_around):
        lower = upper + n_around
        quads = np.stack([upper + ring, lower + ring, lower + after, upper + after], axis=-1)
        faces += map(tuple, quads.tolist())
    return faces


def _rig_material(name: str, look: dict[str, Any]) -> bpy.types.Material:
    """The rig's material `name`, the existing one if a rig was added before."""
    known = bpy.data.materials.get(name)
    if known is not None:
        return known
    material = bpy.data.materials.new(name)
    if material.node_tree is None:  # from 5.0 on a new material has its nodes, and asking for them warns
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket, value in look.items():
        shader.inputs[socket].default_value = value
    return material
