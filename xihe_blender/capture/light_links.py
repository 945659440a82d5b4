"""Light links: which lamps shine on which objects, and how something else joins an object's links for a while.

A lamp, or a glowing mesh, may name a collection of receivers: with objects that are included it shines on these alone,
with objects that are excluded on all others. What stands in for a virtual object has to be in the same collections.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import bpy


@contextlib.contextmanager
def joined_light_links(scene: bpy.types.Scene, standing_in: bpy.types.Object, item: bpy.types.Object) -> Iterator[None]:
    """Let lamps of `scene` shine on `standing_in` as they do on `item`; restored at the end.

    Collections of linked libraries cannot be changed: their links are left out, and `standing_in` is any other object.
    """
    collections = dict.fromkeys(lamp.light_linking.receiver_collection for lamp in scene.objects)
    joined: list[bpy.types.Collection] = []
    try:
        for receivers in [collection for collection in collections if collection is not None]:
            state = _link_state(receivers, item)
            if state is not None and receivers.library is None and standing_in.name not in receivers.objects:
                receivers.objects.link(standing_in)
                joined.append(receivers)
                index = list(receivers.objects).index(standing_in)
                receivers.collection_objects[index].light_linking.link_state = state
        yield
    finally:
        for receivers in joined:
            receivers.objects.unlink(standing_in)


def _link_state(receivers: bpy.types.Collection, item: bpy.types.Object) -> str | None:
    """ "INCLUDE" or "EXCLUDE" as `item` is linked, by itself or by a collection within; None if it is not."""
    for index, other in enumerate(receivers.objects):
        if other == item:
            return str(receivers.collection_objects[index].light_linking.link_state)
    for index, child in enumerate(receivers.children):
        if item.name in child.all_objects:
            return str(receivers.collection_children[index].light_linking.link_state)
    return None
