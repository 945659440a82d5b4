"""Reflection pictures: glossy and transmission rays see a picture, all others the world's SH.

`Is Glossy Ray` and `Is Transmission Ray` choose between two backgrounds. Cycles must not sample such a world by its
importance map, which knows one background for all rays: with sampling method NONE each kind of ray gets its own light,
with MANUAL they were off by 1 and 5 %.

So Cycles finds a lamp in the picture by luck alone, a small one seldom, and on rough metal that is noise. It finds a
sun in every sample. Rough things have the sun of the key light, and a picture without its lamp. Mirrors and clear glass
have the picture with its lamp, which shows what it looks like, and no sun.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.apply.datablocks import MADE_BY, NODE_GROUP_NAME
from xihe_blender.apply.images import write_image
from xihe_blender.apply.keys import curve_lists, hold_keys
from xihe_blender.scene.colour_management import read_as_linear_rec709
from xihe_blender.scene.shader_nodes import smoothest_roughness
from xihenet.light import LightParts
from xihenet.light.environments import laid_out

PICTURE = "Xihe Reflections"
"""Of the nodes in a world, and the beginning of its image's name."""

ROUGH_FROM = 0.2
"""Roughness of a highlight in which a lamp is not to be told from a disc: some 5 degrees wide."""


def has_sun_for_lamp(item: bpy.types.Object) -> bool:
    """Whether a virtual object is so rough that the sun takes the place of its lamp in the picture."""
    roughness = [smoothest_roughness(slot.material) for slot in item.material_slots]
    return all(value is not None and value >= ROUGH_FROM for value in roughness)


SHINY_BELOW = 0.4
"""Roughness of a surface that shows more of its surroundings than nine coefficients hold: matte silver has 0.3."""


def required_light(objects: Sequence[bpy.types.Object]) -> LightParts:
    """What objects need, and no more: a key light for the shadow of each, and reflections where one is shiny."""
    return "sh+key+reflections" if any(map(is_shiny, objects)) else "sh+key"


def is_shiny(item: bpy.types.Object) -> bool:
    """Whether a part of a virtual object mirrors the room, by SHINY_BELOW; an instance is not asked."""
    roughness = [smoothest_roughness(slot.material) for slot in item.material_slots]
    return any(value is not None and value < SHINY_BELOW for value in roughness)


def reflect_in_world(world: bpy.types.World, panorama: ArrayLike, exposure: float = 1.0) -> None:
    """Show `panorama`, (H, 2H, 3) linear, laid out as in `xihenet.panorama`, to the glossy rays of `world`.

    `world` is one of `make_sh_world`; the panorama carries `exposure`. An earlier picture is taken away: where Cycles
    keeps its scene, it would not see that the pixels of an image have changed.
    """
    node = _picture(world) or _add_picture(world)
    _remove_image(node)
    pixels = laid_out(np.asarray(panorama, np.float32), "+X") / np.float32(exposure)
    node.image = write_image(f"{PICTURE} {world.name}", pixels, is_float=True)


def reflect_on_timeline(world: bpy.types.World, pictures: Mapping[int, Path]) -> None:
    """Show the glossy rays of `world` one of the files `pictures` from each of those frames on.

    The files are laid out as Blender's Environment Texture reads them, in scene radiance, and end with a number of
    four digits. Which one is shown is keyed, as the number that is added to the image's first frame. The file keeps
    their paths and not their pixels: Blender does not pack a sequence.
    """
    forget_reflections(world)
    if not pictures:
        return
    node = _add_picture(world)
    # In order from the first on, whatever file comes first on the timeline.
    files = sorted(pictures.values())
    image = bpy.data.images.load(str(files[0]))
    image.name = f"{PICTURE} {world.name}"
    image[MADE_BY] = image.name
    image.source = "SEQUENCE"
    read_as_linear_rec709(image)
    node.image, user = image, node.image_user
    user.frame_start, user.frame_duration, user.use_auto_refresh = 1, 1, True
    for frame, path in pictures.items():
        user.frame_offset = int(path.stem[-4:]) - 1
        user.keyframe_insert("frame_offset", frame=frame)
    hold_keys(world.node_tree)


def forget_reflections(world: bpy.types.World) -> None:
    """Have glossy rays see what all others see; nothing where they do."""
    picture = _picture(world)
    if picture is None:
        return
    tree = world.node_tree
    for curves in curve_lists(tree):
        for curve in [curve for curve in curves if PICTURE in curve.data_path]:
            curves.remove(curve)
    _remove_image(picture)
    mixed = next(node for node in tree.nodes if node.type == "MIX_SHADER")
    seen_by_all, output = mixed.inputs[1].links[0].from_socket, mixed.outputs[0].links[0].to_socket
    tree.links.new(seen_by_all, output)
    for node in [node for node in tree.nodes if node.name.startswith(PICTURE)]:
        tree.nodes.remove(node)
    world.cycles.sampling_method = "MANUAL"


def _picture(world: bpy.types.World) -> bpy.types.Node | None:
    return world.node_tree.nodes.get(PICTURE)


def _remove_image(node: bpy.types.Node) -> None:
    if node.image is not None:
        bpy.data.images.remove(node.image)


def _add_picture(world: bpy.types.World) -> bpy.types.Node:
    tree = world.node_tree
    add, link = tree.nodes.new, tree.links.new
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    output = next(node for node in tree.nodes if node.type == "OUTPUT_WORLD")
    picture, shown, rays, either, mix = (
        add(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "LightPath", "Math", "MixShader")
    )
    for node in (shown, rays, either, mix):
        node.name = f"{PICTURE} {node.type}"
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
