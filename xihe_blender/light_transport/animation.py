"""Animation: what changes from frame to frame, so that what stands still is judged once, and what moves anew.

To compare frames, values that an evaluated data-block holds are read through Blender's own description of its data
(RNA): whatever a node, a lamp or a world of this or a later version has, down through its embedded node tree, its
sockets and its custom properties. The shape of an evaluated object is every attribute of its geometry, as bytes.
Rejected: a list of properties per type, which a new node would slip through.

Numbers are rounded to six digits: F-curves between two equal keys give their value to the last bit but one of single
precision. Other data-blocks are named, not entered: whoever asks looks at each of them. What cannot be read, such as
the grids of a volume, raises `UnreadableError`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

import bpy
import numpy as np

from xihe_blender.light_transport.enclosure import MESHED
from xihe_blender.scene.mesh_arrays import array_of

NOT_VALUES = {"rna_type", "animation_data", "asset_data", "execution_time", "library", "library_weak_reference",
              "original", "override_library", "preview", "session_uid", "users"}  # fmt: skip

ATTRIBUTES: dict[str, tuple[str, type, int]] = {
    "FLOAT": ("value", np.float32, 1),
    "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_VECTOR": ("vector", np.float32, 3),
    "FLOAT_COLOR": ("color", np.float32, 4),
    "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4),
    "FLOAT4X4": ("value", np.float32, 16),
    "INT": ("value", np.int32, 1),
    "INT8": ("value", np.int32, 1),
    "INT16_2D": ("value", np.int32, 2),
    "INT32_2D": ("value", np.int32, 2),
    "BOOLEAN": ("value", np.bool_, 1),
}
"""By data type of an attribute: the property that holds a value, NumPy's type for it, and how many numbers it has."""

Read = TypeVar("Read")
AS_MESH = ("CURVE", "SURFACE", "FONT", "META")


class UnreadableError(Exception):
    """Something that Python is not shown."""


def is_animated(block: bpy.types.ID | None) -> bool:
    """Whether an F-curve, an NLA strip or a driver moves anything of `block`, of its node tree, or of a group in it."""
    if block is None:
        return False
    tree = block if isinstance(block, bpy.types.NodeTree) else getattr(block, "node_tree", None)
    groups = [node.node_tree for node in tree.nodes if hasattr(node, "node_tree")] if tree is not None else []
    own_tree = [] if tree is block else [tree]
    animation = getattr(block, "animation_data", None)
    has_any = animation is not None and (animation.action or animation.drivers or animation.nla_tracks)
    return bool(has_any) or any(is_animated(inner) for inner in (*own_tree, *groups))


def read_once(known: dict[Any, Read], block: bpy.types.ID, read: Callable[[Any], Read]) -> Read:
    """What `read` says of an evaluated data-block; asked once, and `known` from then on, if nothing in it moves."""
    original = block.original
    if original in known:
        return known[original]
    found = read(block)
    if not is_animated(original):
        known[original] = found
    return found


def is_film(image: bpy.types.Image | None) -> bool:
    """Whether an image is another one in each frame."""
    return image is not None and image.source in ("MOVIE", "SEQUENCE")


def shows_a_film(tree: bpy.types.NodeTree | None) -> bool:
    """Whether a node of `tree`, or of a group in it, shows an image that is another one in each frame."""
    nodes = tree.nodes if tree is not None else ()
    return any(is_film(getattr(n, "image", None)) or shows_a_film(getattr(n, "node_tree", None)) for n in nodes)


def placement(instances: Iterable[Any]) -> tuple[int, int]:
    """Two numbers that differ where anything stands, or its bounding box is, otherwise: of surfaces, and all else."""
    total = [0, 0]
    for instance in instances:
        box = tuple(tuple(corner) for corner in instance.object.bound_box)
        place = tuple(map(tuple, instance.matrix_world))
        total[instance.object.type not in MESHED] ^= hash((instance.object.name, place, box, *instance.persistent_id))
    return total[0], total[1]


def values_of(struct: Any, entered: set[tuple[int, str]] | None = None) -> Iterator[tuple[Any, ...]]:
    """(name, value) of all that `struct` holds, in the order in which Blender lists it; values are plain Python.

    Without what has been `entered` before.
    """
    entered = set() if entered is None else entered
    # The first member of a struct has the struct's own address.
    key = (struct.as_pointer(), struct.bl_rna.identifier)
    if key in entered:
        return
    entered.add(key)
    for described in struct.bl_rna.properties:
        name = described.identifier
        if name not in NOT_VALUES:
            yield from _property(name, described.type, getattr(struct, name, None), entered)
    # Only some types can hold custom properties; the others raise TypeError.
    try:
        custom = list(struct.items())
    except (AttributeError, TypeError):
        return
    yield from ((name, _plain(value)) for name, value in custom)


def _property(name: str, kind: str, value: Any, entered: set[tuple[int, str]]) -> Iterator[tuple[Any, ...]]:
    if value is None or kind not in ("POINTER", "COLLECTION"):
        yield name, _plain(value)
        return
    for item in value if kind == "COLLECTION" else [value]:
        if isinstance(item, bpy.types.ID) and not item.is_embedded_data:
            yield name, item.name_full
        else:
            yield (name,)
            yield from values_of(item, entered)


def _plain(value: Any) -> Any:
    if isinstance(value, set):
        return tuple(sorted(value))
    if isinstance(value, bpy.types.ID):
        return value.name_full
    if hasattr(value, "to_dict"):
        return repr(value.to_dict())
    if hasattr(value, "to_list"):
        return tuple(value.to_list())
    if isinstance(value, float):
        return float(f"{value:.6g}")
    return value if isinstance(value, str | bytes) or not hasattr(value, "__len__") else tuple(map(_plain, value))


def shape_of(item: bpy.types.Object) -> Iterator[bytes]:
    """The evaluated geometry of `item` as bytes. UnreadableError for volumes, and for attributes of an unknown type."""
    if item.type in AS_MESH:
        mesh = item.to_mesh()
        if mesh is not None:
            yield from _geometry(mesh)
        item.to_mesh_clear()
    elif hasattr(item.data, "attributes"):
        yield from _geometry(item.data)
    else:
        raise UnreadableError(item.type)


def instances_of(item: bpy.types.Object) -> Iterator[bytes]:
    """All attributes of the instances that geometry nodes make of an evaluated `item`, as bytes.

    UnreadableError before Blender 4.5, where Python is not shown them.
    """
    if not hasattr(item, "evaluated_geometry"):
        raise UnreadableError("instances")
    yield from _instances_in(item.evaluated_geometry())


def _instances_in(geometry: Any) -> Iterator[bytes]:
    points = geometry.instances_pointcloud()
    if points is None:
        return
    # The places are in "instance_transform"; "position" is what happened to be in memory.
    yield from _attributes(attribute for attribute in points.attributes if attribute.name != "position")
    for reference in geometry.instance_references():
        if isinstance(reference, bpy.types.GeometrySet):
            yield from _instances_in(reference)


def reads_instances(tree: bpy.types.NodeTree | None) -> bool:
    """Whether a node of `tree` asks for an attribute of the instance that it shades."""
    nodes = tree.nodes if tree is not None else ()
    return any(getattr(node, "attribute_type", None) == "INSTANCER" for node in nodes)


def _attributes(attributes: Iterable[Any]) -> Iterator[bytes]:
    for attribute in attributes:
        yield f"{attribute.name} {attribute.domain} {attribute.data_type} {len(attribute.data)}".encode()
        if attribute.data_type == "STRING":
            continue
        if attribute.data_type not in ATTRIBUTES:
            raise UnreadableError(attribute.data_type)
        yield array_of(attribute.data, *ATTRIBUTES[attribute.data_type]).tobytes()


def _geometry(data: Any) -> Iterator[bytes]:
    yield from _attributes(data.attributes)
    if hasattr(data, "polygons"):
        yield array_of(data.polygons, "loop_start", np.int32).tobytes()
        if data.has_custom_normals:
            yield array_of(data.corner_normals, "vector", np.float32, 3).tobytes()
    if hasattr(data, "curve_offset_data"):
        yield array_of(data.curve_offset_data, "value", np.int32).tobytes()
