"""Animation: what changes from frame to frame, so that what stands still is judged once, and what moves anew."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

from xihe_blender.light_transport.solids import MESHED


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


def is_film(image: bpy.types.Image | None) -> bool:
    """Whether an image is another one in each frame."""
    return image is not None and image.source in ("MOVIE", "SEQUENCE")


def shows_a_film(tree: bpy.types.NodeTree | None) -> bool:
    """Whether a node of `tree`, or of a group in it, shows an image that is another one in each frame."""
    nodes = tree.nodes if tree is not None else ()
    return any(is_film(getattr(n, "image", None)) or shows_a_film(getattr(n, "node_tree", None)) for n in nodes)


def placement(instances: Iterable[Any]) -> tuple[int, int]:
    """Two numbers that differ between frames in which anything stands otherwise: of surfaces, and of all else.

    Deformation is noticed by its bounding box.
    """
    total = [0, 0]
    for instance in instances:
        box = tuple(tuple(corner) for corner in instance.object.bound_box)
        place = tuple(map(tuple, instance.matrix_world))
        total[instance.object.type not in MESHED] ^= hash((instance.object.name, place, box, *instance.persistent_id))
    return total[0], total[1]
