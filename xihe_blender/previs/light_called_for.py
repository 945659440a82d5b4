"""What do virtual objects have to be lit with, so that nothing is missing and nothing is done for nothing?

Every object casts a shadow, for which there has to be a key light. Only a shiny one shows reflections.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from xihe_blender.scene.shader_nodes import smoothest_roughness
from xihenet.light import LightParts

SHINY_BELOW = 0.4
"""Roughness of a surface that shows more of its surroundings than nine coefficients hold: matte silver has 0.3."""


def light_called_for(objects: Sequence[bpy.types.Object]) -> LightParts:
    """Key light for all of them, and reflections where one is shiny."""
    return "sh+key+reflections" if any(map(is_shiny, objects)) else "sh+key"


def is_shiny(item: bpy.types.Object) -> bool:
    """Whether a part of a virtual object mirrors the room, by SHINY_BELOW; an instance is not asked."""
    roughness = [smoothest_roughness(slot.material) for slot in item.material_slots]
    return any(value is not None and value < SHINY_BELOW for value in roughness)
