"""SH worlds: an estimate as light in Blender, a World per virtual object whose background is the SH itself.

The node group `Xihe SH Radiance` evaluates nine vector coefficients in the direction that Cycles looks into a world and
multiplies the sum by a gain. Nothing is clamped: Cycles takes negative radiance as it is, and a clamp at 0 would add
light (24 % for one distant lamp at order 2). Coefficients carry the session's exposure, as estimates do; the gain takes
it out, once.

Inputs are keyed, with constant interpolation, at the frames at which estimates arrive, so that the timeline plays the
lighting back and the Graph Editor shows it; timeline markers show the triggers. All that is left in a file is named
`Xihe ...`; `remove_applied_light` and `remove_trigger_markers` take it away.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.apply.datablocks import MARKER_PREFIX, NODE_GROUP_NAME, lights_by_sh, trigger_markers
from xihe_blender.apply.keys import add_keys, clear_keys, f_curves, hold_keys, remove_animation
from xihe_blender.scene.colour_management import in_working_space
from xihenet.sh import dering_for_display

GAIN = "Gain"
COEFFICIENTS = [
    f"l={level} m={m:+d}" if m else f"l={level} m=0" for level in range(3) for m in range(-level, level + 1)
]

# Real orthonormal basis of order 2: factor and the product of direction components it multiplies; see xihenet.sh.
_Y0, _Y1, _Y2 = 0.5 / np.sqrt(np.pi), np.sqrt(3 / (4 * np.pi)), np.sqrt(15 / (4 * np.pi))


def sh_node_group() -> bpy.types.NodeTree:
    """The node group `Xihe SH Radiance`, made on first use.

    Inputs: nine vectors (R, G, B of each coefficient, in the order l*l + l + m) and a gain. Output: radiance.
    """
    group = _local(bpy.data.node_groups, NODE_GROUP_NAME)
    if group is None:
        group = bpy.data.node_groups.new(NODE_GROUP_NAME, "ShaderNodeTree")
        group.interface.new_socket("Radiance", in_out="OUTPUT", socket_type="NodeSocketColor")
        for name in COEFFICIENTS:
            group.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketVector")
        gain = group.interface.new_socket(GAIN, in_out="INPUT", socket_type="NodeSocketFloat")
        gain.default_value = 1.0
        _write_sum(group)
    return group


def make_sh_world(name: str) -> bpy.types.World:
    """A world named `name` that is lit by the node group; an older one of that name is set up anew.

    The importance map is small and fixed: choosing its size automatically costs Cycles seconds per change, and must be
    decided before the first render.
    """
    world = _local(bpy.data.worlds, name) or bpy.data.worlds.new(name)
    clear_keys(world)
    if bpy.app.version < (5, 0, 0):
        # From 5.0 on a world always has nodes, and the switch is deprecated.
        world.use_nodes = True
    tree = world.node_tree
    clear_keys(tree)
    tree.nodes.clear()
    group = tree.nodes.new("ShaderNodeGroup")
    group.name = group.label = NODE_GROUP_NAME
    group.node_tree = sh_node_group()
    background = tree.nodes.new("ShaderNodeBackground")
    background.location = (250, 0)
    output = tree.nodes.new("ShaderNodeOutputWorld")
    output.location = (450, 0)
    tree.links.new(group.outputs[0], background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])
    world.cycles.sampling_method = "MANUAL"
    world.cycles.sample_map_resolution = 64
    return world


def apply_sh_to_world(
    world: bpy.types.World, sh_radiance: ArrayLike, exposure: float = 1.0, *, is_deringed: bool = False
) -> None:
    """Light `world`, made by `make_sh_world`, with (9, 3) radiance coefficients that carry `exposure`.

    For a world that is looked at, `is_deringed` takes away what is negative, by `xihenet.sh.dering_for_display`.
    ValueError for another shape, numbers that are not finite, or an exposure that is not positive.
    """
    coefficients = np.asarray(sh_radiance, np.float64)
    if coefficients.shape != (9, 3) or not np.isfinite(coefficients).all():
        raise ValueError(f"expected finite coefficients of shape (9, 3), got shape {coefficients.shape}")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"expected a positive exposure, got {exposure}")
    if is_deringed:
        coefficients = dering_for_display(coefficients)
    inputs = inputs_of_world(world)
    for name, coefficient in zip(COEFFICIENTS, in_working_space(coefficients), strict=True):
        inputs[name].default_value = coefficient
    inputs[GAIN].default_value = 1.0 / exposure


def key_light_changes(world: bpy.types.World, lights: Mapping[int, ArrayLike], exposure: float = 1.0) -> None:
    """Like `apply_sh_to_world` from each frame of `lights` on, (9, 3) each, in order, in place of all keys.

    Keyed with constant interpolation, as estimates arrive.
    """
    clear_keys(world.node_tree)
    if not lights:
        return
    frames = list(lights)
    values = in_working_space(np.array(list(lights.values()), np.float64))
    apply_sh_to_world(world, lights[frames[0]], exposure)
    animation = world.node_tree.animation_data_create()
    if animation.action is None:
        # Blender 4.3 names an action after the node tree, "Shader Nodetree": nobody would know whose it is.
        animation.action = bpy.data.actions.new(world.name)
    inputs = inputs_of_world(world)
    for name in (*COEFFICIENTS, GAIN):
        inputs[name].keyframe_insert("default_value", frame=frames[0])
    for index, curve in light_curves(world):
        own = values[:, index, curve.array_index] if index < len(COEFFICIENTS) else np.full(len(frames), 1 / exposure)
        add_keys(curve, frames, own)
    hold_keys(world.node_tree)


def mark_trigger(scene: bpy.types.Scene, frame: int, reasons: Iterable[str]) -> None:
    """A timeline marker at `frame` that says why estimates were made there, once per frame."""
    name = f"{MARKER_PREFIX} ({', '.join(sorted(set(reasons)))})"
    for marker in [marker for marker in trigger_markers(scene) if marker.frame == frame]:
        scene.timeline_markers.remove(marker)
    scene.timeline_markers.new(name, frame=frame).select = False  # Else it is moved and deleted with the user's own.


def remove_trigger_markers(scene: bpy.types.Scene) -> None:
    """Take away the markers of earlier runs; the user's own stay."""
    for marker in trigger_markers(scene):
        scene.timeline_markers.remove(marker)


def remove_applied_light() -> None:
    """Take the worlds and the node group that applying left out of the file."""
    for world in [w for w in bpy.data.worlds if lights_by_sh(w) and w.library is None]:
        remove_animation(world)
        remove_animation(world.node_tree)
        bpy.data.worlds.remove(world)
    remove_unused_node_group()


def remove_unused_node_group() -> None:
    """Take the node group away, unless a world still has it."""
    group = _local(bpy.data.node_groups, NODE_GROUP_NAME)
    if group is not None and not group.users:
        bpy.data.node_groups.remove(group)


def light_curves(world: bpy.types.World) -> list[tuple[int, bpy.types.FCurve]]:
    """The F-curves that key the light of `world`, each with the number of its input: of COEFFICIENTS, then the gain.

    Reflections and what a user keys in the same nodes have curves of their own, which are not among them.
    """
    begin = f'nodes["{NODE_GROUP_NAME}"].inputs['
    curves = [curve for curve in f_curves(world.node_tree) if curve.data_path.startswith(begin)]
    return [(int(curve.data_path[len(begin) :].split("]")[0]), curve) for curve in curves]


def _local(blocks: bpy.types.bpy_prop_collection, name: str) -> bpy.types.ID | None:
    """The data-block of the file itself that has this name: one of a linked library may have it as well."""
    return blocks.get((name, None))


def inputs_of_world(world: bpy.types.World) -> bpy.types.NodeInputs:
    """Of the node group that lights `world`: the coefficients and the gain; ValueError where it has none."""
    node = world.node_tree.nodes.get(NODE_GROUP_NAME) if world.node_tree else None
    if node is None:
        raise ValueError(f"world {world.name!r} has no node {NODE_GROUP_NAME!r}: make it with make_sh_world")
    return node.inputs


def _write_sum(group: bpy.types.NodeTree) -> None:
    """The sum over i of coefficient_i x Y_i(direction), times the gain, as math nodes in `group`."""

    def computed(kind: str, operation: str, *operands: Any) -> bpy.types.NodeSocket:
        """Of sockets or numbers; None is for an input that the operation does not look at."""
        node = group.nodes.new(kind)
        node.operation = operation
        for socket, operand in zip(node.inputs, operands, strict=False):
            if isinstance(operand, bpy.types.NodeSocket):
                group.links.new(operand, socket)
            elif operand is not None:
                socket.default_value = float(operand)
        return node.outputs[0]

    def product(*factors: Any) -> Any:
        return functools.reduce(functools.partial(computed, "ShaderNodeMath", "MULTIPLY"), factors)

    def scaled(vector: Any, scale: Any) -> bpy.types.NodeSocket:
        return computed("ShaderNodeVectorMath", "SCALE", vector, None, None, scale)

    # In a world, Generated is the direction that light comes from, as seen from the shaded point.
    direction = group.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    separate = group.nodes.new("ShaderNodeSeparateXYZ")
    group.links.new(direction, separate.inputs[0])
    x, y, z = separate.outputs
    zonal = computed("ShaderNodeMath", "SUBTRACT", product(3.0, z, z), 1.0)
    xx_minus_yy = computed("ShaderNodeMath", "SUBTRACT", product(x, x), product(y, y))
    basis = [_Y0, product(_Y1, y), product(_Y1, z), product(_Y1, x), product(_Y2, x, y), product(_Y2, y, z),
             product(_Y2 / np.sqrt(12), zonal), product(_Y2, x, z), product(_Y2 / 2, xx_minus_yy)]  # fmt: skip
    inputs = group.nodes.new("NodeGroupInput").outputs
    terms = [scaled(inputs[name], factor) for name, factor in zip(COEFFICIENTS, basis, strict=True)]
    total = functools.reduce(functools.partial(computed, "ShaderNodeVectorMath", "ADD"), terms)
    group.links.new(scaled(total, inputs[GAIN]), group.nodes.new("NodeGroupOutput").inputs[0])
    for index, node in enumerate(group.nodes):
        node.location = (180 * (index // 8), -160 * (index % 8))
