"""What of a run is in the open file? Its worlds, markers and images, known by their names and by what made them.

The panel asks at every redraw whether there is anything to remove, so nothing here needs NumPy; what makes these things
is in `sh_worlds` and `addon.results_in_blender`.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy

NODE_GROUP_NAME = "Xihe SH Radiance"
PREFIX = "Xihe "
MARKER_PREFIX = "Xihe trigger"
COMPARISON_NAME = "Xihe Comparison"
LIGHT_PREFIX = "Xihe Light "
LIT_SCENE = "Xihe Lit"
ROOM = "xihe_room"
"""Custom property of the scene `Xihe Lit` in an open file: the scene that it shows the objects of."""

MADE_BY = "xihe_image"
"""Custom property of our images, so that one of the user's of the same name is left alone."""


FRAME = "xihe_frame"
"""Custom property of the comparison: the compared frame that it shows."""


def has_anything(scene: bpy.types.Scene) -> bool:
    """Whether there is something for `results_in_blender.remove_everything` to remove."""
    lit = any(lights_by_sh(world) and world.library is None for world in bpy.data.worlds)
    return bool(trigger_markers(scene)) or lit or lit_scene() is not None or next(our_images(), None) is not None


def lit_scene() -> bpy.types.Scene | None:
    """The scene `Xihe Lit` of the open file, whatever Blender calls it now; None where it is not shown."""
    return next((scene for scene in bpy.data.scenes if ROOM in scene and scene.library is None), None)


def lights_by_sh(world: bpy.types.World) -> bool:
    """Whether `world` is one of ours: named so and lit by our node group."""
    return world.name.startswith(PREFIX) and world.node_tree is not None and NODE_GROUP_NAME in world.node_tree.nodes


def trigger_markers(scene: bpy.types.Scene) -> list[bpy.types.TimelineMarker]:
    """The markers that runs set; the user's own are not among them."""
    return [marker for marker in scene.timeline_markers if marker.name.startswith(MARKER_PREFIX)]


def image_named(name: str) -> bpy.types.Image | None:
    """Our image of that name, whatever Blender calls it now."""
    return next((image for image in our_images() if image[MADE_BY] == name), None)


def our_images() -> Iterator[bpy.types.Image]:
    """All images of the file itself that results were shown in."""
    return (image for image in bpy.data.images if MADE_BY in image and image.library is None)
