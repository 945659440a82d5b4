"""What must a phone know of the room besides its pictures: does any light change, and how smooth are the materials?

Both are read off the scene as Cycles is given it, frame by frame, without rendering. Virtual objects do not count: a
capture shows neither them nor their light.
"""

from __future__ import annotations

from typing import Any

import bpy

from xihe_blender.light_transport.animation import is_animated, shows_a_film
from xihe_blender.light_transport.nodes import (
    Interaction,
    light_emits,
    material_shading,
    smoothest_roughness,
    world_shading,
)
from xihe_blender.scene.virtual_objects import GEOMETRY_TYPES, virtual_collection

LAMP_SHAPE = ("shadow_soft_size", "size", "size_y", "angle", "spot_size", "spot_blend")


class RoomSurvey:
    """Gathers what the node trees and lights of a room say, one evaluated frame after the other.

    `roughness` is the smoothest by material name, for each frame; None where it is not known.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        virtual = virtual_collection(scene)
        self.virtual = {item.name for item in virtual.all_objects} if virtual is not None else set()
        self.lights: set[frozenset[Any]] = set()
        """What each frame's lights are and where; one entry as long as none of it changes."""
        self.is_driven = False
        self.roughness: dict[int, dict[str, float | None]] = {}
        self._still: dict[Any, tuple[float | None, bool]] = {}
        """Roughness and glow of materials in which nothing is animated, by original data-block."""

    @property
    def light_changes(self) -> bool:
        """Whether a lamp, a glowing object or the world is not the same in all frames."""
        return len(self.lights) > 1 or self.is_driven

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        lights: set[Any] = set()
        found: dict[str, float | None] = {}
        for instance in depsgraph.object_instances:
            parents = {instance.object.name, instance.parent.name if instance.parent else ""}
            if instance.show_self and not parents & self.virtual:
                lights |= self._lights_of(instance, found)
        world = depsgraph.scene_eval.world
        if world is not None and world_shading(world).interactions & Interaction.EMISSION:
            lights.add(world.name)
            self.is_driven |= _may_change(world.original)
        self.lights.add(frozenset(lights))
        self.roughness[depsgraph.scene.frame_current] = found

    def _lights_of(self, instance: Any, found: dict[str, float | None]) -> set[Any]:
        """What glows about an instance, as something that differs where the light does; notes its materials."""
        item = instance.object
        place = tuple(map(tuple, instance.matrix_world))
        if item.type == "LIGHT":
            if not light_emits(item.data):
                return set()
            self.is_driven |= item.data.node_tree is not None and is_animated(item.data.node_tree.original)
            shape = (float(getattr(item.data, name, 0.0)) for name in LAMP_SHAPE)
            return {(item.name, place, item.data.energy, tuple(item.data.color), *shape)}
        glowing = set()
        for slot in item.material_slots if item.type in GEOMETRY_TYPES else ():
            if slot.material is not None and self._material(slot.material, found):
                self.is_driven |= _may_change(slot.material.original)
                glowing.add((item.name, slot.material.name, place))
        return glowing

    def _material(self, material: bpy.types.Material, found: dict[str, float | None]) -> bool:
        """Note the roughness of a material; whether it glows."""
        original = material.original
        known = self._still.get(original)
        if known is None:
            known = smoothest_roughness(material), bool(material_shading(material).interactions & Interaction.EMISSION)
            if not is_animated(original):
                self._still[original] = known
        found[material.name], glows = known
        return glows


def _may_change(block: bpy.types.ID) -> bool:
    return is_animated(block) or shows_a_film(block.node_tree)
