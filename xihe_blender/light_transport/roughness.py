"""How smooth is the smoothest reflection of a material? A range sensor's light does not come back from a mirror.

Read backwards from the active output, as `nodes` does. A roughness that a texture drives may be anything, and so may a
shader that is not known here: the answer is then None. Whether the material also spreads light, so that a sensor sees
it whatever its gloss, is not asked here: the render's own diffuse pass says it for each pixel.
"""

from __future__ import annotations

from typing import Any

import bpy

from xihe_blender.light_transport.sockets import Groups, constant, has_nodes, origin, sides

REFLECTING = ("BSDF_GLOSSY", "BSDF_METALLIC", "BSDF_GLASS", "BSDF_REFRACTION", "BSDF_PRINCIPLED")
DULL = (
    "BSDF_DIFFUSE", "BSDF_SHEEN", "BSDF_TOON", "BSDF_TRANSLUCENT", "BSDF_TRANSPARENT", "BSDF_RAY_PORTAL",
    "SUBSURFACE_SCATTERING", "BSDF_HAIR", "BSDF_HAIR_PRINCIPLED", "HOLDOUT", "EMISSION", "BACKGROUND",
)  # fmt: skip
"""Shaders without a mirror in them; 1 stands for these."""


def smoothest_roughness(material: bpy.types.Material | None) -> float | None:
    """0 for a mirror, 1 for chalk; None if it may be anything. A material that is None is Blender's default grey."""
    if material is None or not has_nodes(material):
        return 1.0
    output = material.node_tree.get_output_node("CYCLES")
    return 1.0 if output is None else _smoothest(output.inputs["Surface"], ())


def _smoothest(socket: Any, groups: Groups) -> float | None:
    out, groups = origin(socket, groups)
    if not out.is_output or out.type != "SHADER":
        return 1.0
    node = out.node
    if node.type in REFLECTING:
        value = constant(node.inputs["Roughness"], groups)
        return None if value is None else min(max(float(value), 0.0), 1.0)
    if node.type in DULL:
        return 1.0
    if node.type in ("MIX_SHADER", "ADD_SHADER"):
        below = [_smoothest(side, groups) for side in sides(node, groups)]
        known = [value for value in below if value is not None]
        return min(known) if len(known) == len(below) else None
    return None
