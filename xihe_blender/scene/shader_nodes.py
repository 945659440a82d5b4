"""Shader node trees, and what they can do to light: read backwards from the active output, as Cycles reads them.

Only what reaches the output counts. Links are followed through reroutes, groups and muted nodes; a mix whose factor is
a constant 0 or 1 has one side only; a Principled shader does what its weights let it. A value that is linked to a
texture or to arithmetic may be anything, and a node that this file does not know may do anything: the answer errs
towards "it may". Values are read as they stand, so animation and drivers are the business of whoever evaluates the
tree at each frame (see `transport_survey`). Rejected: searching the tree for node types, which finds what nothing is
linked to.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import bpy

Groups = tuple[Any, ...]  # the group nodes that have been entered, outermost first
UNKNOWN_ALBEDO = 0.8
"""Of a colour that cannot be read off: a bright wall paint. Guessing too dark would cut bounces that are needed."""


class Interaction(enum.Flag):
    """One way in which a surface, a volume or a world takes part in light transport."""

    NOTHING = 0
    DIFFUSE = enum.auto()
    GLOSSY = enum.auto()
    REFRACTION = enum.auto()
    TRANSLUCENT = enum.auto()
    TRANSPARENT = enum.auto()
    SUBSURFACE = enum.auto()
    HAIR = enum.auto()
    EMISSION = enum.auto()
    VARYING_EMISSION = enum.auto()
    VOLUME = enum.auto()
    DISPLACEMENT = enum.auto()


A = Interaction
ANYTHING = ~Interaction.NOTHING & ~Interaction.DISPLACEMENT & ~Interaction.HAIR


@dataclass(frozen=True)
class Shading:
    """What a material may do, and the largest share of light (0 to 1, its brightest channel) it can send on."""

    interactions: Interaction = Interaction.NOTHING
    albedo: float = 0.0

    def __or__(self, other: Shading) -> Shading:
        return Shading(self.interactions | other.interactions, max(self.albedo, other.albedo))


NOTHING = Shading()

SIMPLE = {
    "BSDF_DIFFUSE": A.DIFFUSE,
    "BSDF_SHEEN": A.DIFFUSE,
    "BSDF_TOON": A.DIFFUSE | A.GLOSSY,
    "BSDF_TRANSLUCENT": A.DIFFUSE | A.TRANSLUCENT,
    "BSDF_GLOSSY": A.GLOSSY,
    "BSDF_METALLIC": A.GLOSSY,
    "BSDF_GLASS": A.GLOSSY | A.REFRACTION,
    "BSDF_REFRACTION": A.REFRACTION,
    "BSDF_TRANSPARENT": A.TRANSPARENT,
    "BSDF_RAY_PORTAL": A.TRANSPARENT,
    "SUBSURFACE_SCATTERING": A.DIFFUSE | A.SUBSURFACE,
    # Cycles counts light through a strand among the transmission bounces.
    "BSDF_HAIR": A.HAIR | A.GLOSSY | A.TRANSLUCENT,
    "BSDF_HAIR_PRINCIPLED": A.HAIR | A.GLOSSY | A.TRANSLUCENT,
    "HOLDOUT": A.NOTHING,
}


def material_shading(material: bpy.types.Material | None) -> Shading:
    """What `material` may do; None is Blender's default grey."""
    if material is None:
        return Shading(A.DIFFUSE, UNKNOWN_ALBEDO)
    if not has_nodes(material):
        return Shading(A.DIFFUSE, max(material.diffuse_color[:3]))
    output = material.node_tree.get_output_node("CYCLES")
    if output is None:
        return NOTHING
    look = _surface(output.inputs["Surface"]) | _volume(output.inputs["Volume"])
    if material.displacement_method != "BUMP" and _displaces(output.inputs["Displacement"]):
        look |= Shading(A.DISPLACEMENT)
    return look


def world_shading(world: bpy.types.World | None) -> Shading:
    if world is None:
        return NOTHING
    if not has_nodes(world):
        return Shading(A.EMISSION) if any(world.color) else NOTHING
    output = world.node_tree.get_output_node("CYCLES")
    return NOTHING if output is None else _surface(output.inputs["Surface"]) | _volume(output.inputs["Volume"])


def light_emits(light: bpy.types.Light) -> bool:
    """Whether a lamp gives any light: it is no portal, has power, a colour, and nodes (if any) that let it through."""
    if light.energy == 0 or not any(light.color) or (light.type == "AREA" and light.cycles.is_portal):
        return False
    if not has_nodes(light):
        return True
    output = light.node_tree.get_output_node("CYCLES")
    return output is not None and bool(_surface(output.inputs["Surface"]).interactions & A.EMISSION)


def new_material(name: str) -> bpy.types.Material:
    """One with nodes: from 5.0 on all have them, and asking for them warns."""
    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    return material


def has_nodes(block: bpy.types.ID) -> bool:
    """From 5.0 on all materials and worlds are made of nodes, and the switch is deprecated."""
    return block.node_tree is not None and (bpy.app.version >= (5, 0, 0) or block.use_nodes)


def origin(socket: Any, groups: Groups) -> tuple[Any, Groups]:
    """Where the value of the input `socket` comes from: an output socket, or an input socket that nothing feeds.

    A muted node without a way through, an empty group and a link that is muted or invalid feed nothing, and then the
    input's own value counts.
    """
    while (out := _linked_output(socket)) is not None:
        node = out.node
        before = socket
        if node.mute:
            through = [link.from_socket for link in node.internal_links if link.to_socket == out]
            socket = through[0] if through else None
        elif node.type == "REROUTE":
            socket = node.inputs[0]
        elif node.type == "GROUP_INPUT" and groups:
            socket, groups = _by_identifier(groups[-1].inputs, out.identifier), groups[:-1]
        elif hasattr(node, "node_tree"):
            socket, groups = _group_output(node, out.identifier), (*groups, node)
        else:
            return out, groups
        if socket is None:
            return before, groups
    return socket, groups


def _linked_output(socket: Any) -> Any:
    """The output socket that a working link brings into the input `socket`; None without one."""
    if not socket.is_linked:
        return None
    working = (link for link in socket.links if link.is_valid and not link.is_muted and link.from_socket.enabled)
    return next((link.from_socket for link in working), None)


def _group_output(node: Any, identifier: str) -> Any:
    """The input of the active Group Output inside the group `node` that feeds its output `identifier`."""
    nodes = node.node_tree.nodes if node.node_tree is not None else ()
    output = next((inner for inner in nodes if inner.type == "GROUP_OUTPUT" and inner.is_active_output), None)
    return None if output is None else _by_identifier(output.inputs, identifier)


def _by_identifier(sockets: Any, identifier: str) -> Any:
    return next((socket for socket in sockets if socket.identifier == identifier), None)


def constant(socket: Any, groups: Groups) -> Any:
    """The value of an input, where it is the same everywhere: a number or a tuple (R, G, B). None: may be anything."""
    found, _ = origin(socket, groups)
    if found.is_output and found.node.type not in ("VALUE", "RGB"):
        return None
    value = found.default_value
    return tuple(value)[:3] if hasattr(value, "__len__") else value


def number(socket: Any, groups: Groups) -> float | None:
    """`constant` of an input that takes one number; of a colour that is linked to it the luminance, as in Cycles."""
    value = constant(socket, groups)
    if not isinstance(value, tuple):
        return value
    # NumPy comes with it, which must wait: the panel imports this module.
    from xihenet.colour import LUMINANCE

    return float(LUMINANCE @ value)


def largest(node: Any, name: str, groups: Groups) -> float | None:
    """The largest channel of the input `name`; 0 where the node has none of that name, None if it may be anything."""
    return _largest_of(node.inputs[name], groups) if name in node.inputs else 0.0


def _largest_of(socket: Any, groups: Groups) -> float | None:
    value = constant(socket, groups)
    return float(max(value)) if isinstance(value, tuple) else value


def may_be_positive(node: Any, name: str, groups: Groups) -> bool:
    value = largest(node, name, groups)
    return value is None or value > 0


def is_whole(node: Any, name: str, groups: Groups) -> bool:
    value = largest(node, name, groups)
    return value is not None and value >= 1


def sides(node: Any, groups: Groups) -> list[Any]:
    """The shader inputs that an Add or a Mix Shader lets through: both, but for a mix by a constant 0 or 1."""
    factor = number(node.inputs[0], groups) if node.type == "MIX_SHADER" else None
    if factor is None or 0 < factor < 1:
        return [node.inputs[-2], node.inputs[-1]]
    return [node.inputs[-1 if factor >= 1 else -2]]


def _albedo(node: Any, name: str, groups: Groups) -> float:
    value = _brightest(node.inputs[name], groups) if name in node.inputs else UNKNOWN_ALBEDO
    return min(max(value, 0.0), 1.0)


def _brightest(socket: Any, groups: Groups) -> float:
    """The largest channel that a colour can have: of a constant, a colour ramp, or a mix of these; else a guess."""
    value = _largest_of(socket, groups)
    if value is not None:
        return value
    out, groups = origin(socket, groups)
    node = out.node
    if node.type == "VALTORGB":
        return float(max(max(element.color[:3]) for element in node.color_ramp.elements))
    if node.type == "MIX" and node.data_type == "RGBA" and node.blend_type in ("MIX", "MULTIPLY"):
        return max(_brightest(side, groups) for side in node.inputs if side.identifier in ("A_Color", "B_Color"))
    return UNKNOWN_ALBEDO


def _shaders(socket: Any, groups: Groups = (), *, varies: bool = False) -> Iterator[tuple[Any, Groups, bool]]:
    """What arrives at a shader input, through Mix and Add Shaders: outputs of nodes, and whether a mix may vary it."""
    out, groups = origin(socket, groups)
    if not out.is_output:
        return
    if out.node.type not in ("MIX_SHADER", "ADD_SHADER"):
        yield out, groups, varies
        return
    varies |= out.node.type == "MIX_SHADER" and constant(out.node.inputs[0], groups) is None
    for side in sides(out.node, groups):
        yield from _shaders(side, groups, varies=varies)


def _surface(socket: Any) -> Shading:
    """What the shaders at the input of an output node may do together."""
    look = NOTHING
    for out, groups, varies in _shaders(socket):
        one = _shader(out, groups)
        look |= one | Shading(A.VARYING_EMISSION) if varies and one.interactions & A.EMISSION else one
    return look


def _shader(out: Any, groups: Groups) -> Shading:
    if out.type != "SHADER":
        return Shading(A.EMISSION | A.VARYING_EMISSION)  # Cycles shows a bare colour as emission
    node = out.node
    if node.type in SIMPLE:
        return _simple(node, groups)
    if node.type == "BSDF_PRINCIPLED":
        return _principled(node, groups)
    if node.type in ("EMISSION", "BACKGROUND"):
        return Shading(_emitted(node, "Color", "Strength", groups))
    return Shading(ANYTHING, UNKNOWN_ALBEDO)


def _simple(node: Any, groups: Groups) -> Shading:
    colour = "Base Color" if "Base Color" in node.inputs else "Color"
    # The hair shaders have other ways to be coloured than by their colour.
    if not SIMPLE[node.type] & A.HAIR and not may_be_positive(node, colour, groups):
        return NOTHING
    is_passed_through = SIMPLE[node.type] in (A.TRANSPARENT, A.NOTHING)
    return Shading(SIMPLE[node.type], 0.0 if is_passed_through else _albedo(node, colour, groups))


def _emitted(node: Any, colour: str, strength: str, groups: Groups) -> Interaction:
    values = largest(node, colour, groups), largest(node, strength, groups)
    if 0.0 in values:
        return A.NOTHING
    return A.EMISSION | A.VARYING_EMISSION if None in values else A.EMISSION


def _principled(node: Any, groups: Groups) -> Shading:
    """The layers of the Principled shader, from the top; each hides what is below it only where its weight is 1."""

    def may(name: str) -> bool:
        return may_be_positive(node, name, groups)

    interactions = A.NOTHING if is_whole(node, "Alpha", groups) else A.TRANSPARENT
    if not may("Alpha"):
        return Shading(interactions)
    interactions |= A.DIFFUSE if may("Sheen Weight") else A.NOTHING
    interactions |= A.GLOSSY if may("Coat Weight") or may("Metallic") else A.NOTHING
    interactions |= _emitted(node, "Emission Color", "Emission Strength", groups)
    if not is_whole(node, "Metallic", groups):
        if may("Transmission Weight"):
            # To Cycles a smooth thin wall (from 5.2 on) is transparent to light on its way from lamps and the sky.
            interactions |= A.GLOSSY | A.REFRACTION | (A.TRANSPARENT if may("Thin Wall") else A.NOTHING)
        if not is_whole(node, "Transmission Weight", groups):
            interactions |= _principled_base(node, groups)
    return Shading(interactions, _albedo(node, "Base Color", groups))


def _principled_base(node: Any, groups: Groups) -> Interaction:
    """Diffuse below a dielectric coat, with light that spreads below the surface or passes a thin wall."""
    interactions = A.DIFFUSE
    if may_be_positive(node, "Specular IOR Level", groups):
        interactions |= A.GLOSSY
    if may_be_positive(node, "Subsurface Weight", groups):
        interactions |= A.SUBSURFACE
        if may_be_positive(node, "Thin Wall", groups):
            interactions |= A.TRANSLUCENT
    return interactions


VOLUME_WEIGHTS = {
    "VOLUME_ABSORPTION": ("Density",),
    "VOLUME_SCATTER": ("Density",),
    "PRINCIPLED_VOLUME": ("Density", "Emission Strength", "Blackbody Intensity"),
    "EMISSION": ("Strength",),
}


def _volume(socket: Any) -> Shading:
    """VOLUME where something is linked that can absorb, scatter or glow."""
    for out, groups, _ in _shaders(socket):
        weights = VOLUME_WEIGHTS.get(out.node.type)
        if weights is None or any(may_be_positive(out.node, name, groups) for name in weights):
            return Shading(A.VOLUME)
    return NOTHING


def _displaces(socket: Any) -> bool:
    """Whether what is linked to a Displacement input can move the surface."""
    out, groups = origin(socket, ())
    if not out.is_output:
        return False
    node = out.node
    if node.type not in ("DISPLACEMENT", "VECTOR_DISPLACEMENT"):
        return True
    if largest(node, "Scale", groups) == 0:
        return False
    values = [largest(node, name, groups) for name in ("Height", "Midlevel")]
    return node.type == "VECTOR_DISPLACEMENT" or None in values or values[0] != values[1]


REFLECTING = ("BSDF_GLOSSY", "BSDF_METALLIC", "BSDF_GLASS", "BSDF_REFRACTION", "BSDF_PRINCIPLED")
DULL = {*SIMPLE, "EMISSION", "BACKGROUND"} - {*REFLECTING}  # shaders without a mirror in them; 1 stands for these


def smoothest_roughness(material: bpy.types.Material | None) -> float | None:
    """Of a material's smoothest reflection: 0 for a mirror, 1 for chalk; None if it may be anything.

    A range sensor's light does not come back from a mirror. Whether the material also spreads light, so that a sensor
    sees it whatever its gloss, is not asked here: the render's own diffuse pass says it for each pixel.
    """
    if material is None or not has_nodes(material):
        return 1.0
    output = material.node_tree.get_output_node("CYCLES")
    shaders = () if output is None else _shaders(output.inputs["Surface"])
    found = [_roughness(out, groups) for out, groups, _ in shaders]
    known = [value for value in found if value is not None]
    return min(known, default=1.0) if len(known) == len(found) else None


def _roughness(out: Any, groups: Groups) -> float | None:
    if out.type != "SHADER" or out.node.type in DULL:
        return 1.0
    if out.node.type not in REFLECTING:
        return None
    value = number(out.node.inputs["Roughness"], groups)
    return None if value is None else min(max(value, 0.0), 1.0)
