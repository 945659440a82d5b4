"""How does an object get its reflections? Glossy and transmission rays see a picture, all others the world's SH.

`Is Glossy Ray` and `Is Transmission Ray` choose between two backgrounds. Cycles must not sample such a world by its
importance map, which knows one background for all rays: with sampling method NONE each kind of ray gets its own light,
with MANUAL they were off by 1 and 5 %.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.apply.datablocks import NODE_GROUP_NAME
from xihe_blender.apply.images import as_environment, write_image

PICTURE = "Xihe Reflections"
"""Of the nodes in a world, and the beginning of its image's name."""


def reflect_in_world(world: bpy.types.World, panorama: ArrayLike, exposure: float = 1.0) -> None:
    """Show `panorama`, (H, 2H, 3) linear, laid out as in `xihenet.panorama`, to the glossy rays of `world`.

    `world` is one of `make_sh_world`; the panorama carries `exposure`. An earlier picture is taken away: where Cycles
    keeps its scene, it would not see that the pixels of an image have changed.
    """
    tree = world.node_tree
    node = tree.nodes.get(PICTURE) or _add_picture(world)
    forget_reflections(world)
    pixels = as_environment(np.asarray(panorama, np.float32)) / np.float32(exposure)
    node.image = write_image(f"{PICTURE} {world.name}", pixels, is_float=True)


def forget_reflections(world: bpy.types.World) -> None:
    """Remove the picture that `world` reflects; nothing where there is none."""
    node = world.node_tree.nodes.get(PICTURE)
    if node is not None and node.image is not None:
        bpy.data.images.remove(node.image)


def _add_picture(world: bpy.types.World) -> bpy.types.Node:
    tree = world.node_tree
    add, link = tree.nodes.new, tree.links.new
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    picture, shown, rays, either, mix = (
        add(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "LightPath", "Math", "MixShader")
    )
    picture.name = picture.label = PICTURE
    either.operation = "MAXIMUM"
    link(rays.outputs["Is Glossy Ray"], either.inputs[0])
    link(rays.outputs["Is Transmission Ray"], either.inputs[1])
    link(picture.outputs["Color"], shown.inputs["Color"])
    link(either.outputs[0], mix.inputs[0])
    link(background.outputs[0], mix.inputs[1])
    link(shown.outputs[0], mix.inputs[2])
    link(mix.outputs[0], output.inputs["Surface"])
    group = tree.nodes[NODE_GROUP_NAME]
    for number, node in enumerate((rays, either, picture, shown, mix)):
        node.location = (group.location.x + 220 * number, group.location.y - 300)
    world.cycles.sampling_method = "NONE"
    return picture
