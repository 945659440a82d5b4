"""The survey of light transport: with which interactions, on which objects, light can meet over the frames of a run.

Everything that Cycles would be given counts, wherever it stands: a glass vase behind the camera is in a mirror, and
lights the wall that the camera sees. So nothing is left out by the camera's view. What Cycles is not given (hidden in
renders, excluded, no ray type left by the visibility switches) does not count. Holdout and indirect-only objects do:
other surfaces still see them. An object that only casts shadows counts for transparency alone.

Subsurface alone is also asked what reaches it, since no setting of a scene switches it: a wrong answer costs a line of
the plan, and no light. A surface is left out if no ray meets it: not on the walks that count the bounces (see
`enclosure`), which go on from surface to surface, and not out of N_AIMED that are aimed at it from the camera at every
frame and the probes, and as many from what the walks met. Where rays cannot tell it counts: surfaces move, light passes
what they met in ways that they do not (thin paper, displacement, animated materials, a wall hidden from some rays), a
surface is made of strands, there are too many. Not considered: the camera's clip start, and portals of rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from xihe_blender.light_transport.animation import placement, read_once
from xihe_blender.light_transport.enclosure import (
    Look,
    Ray,
    Solids,
    aim,
    carried,
    rays_all_round,
    rays_through_picture,
    undivided_mesh,
)
from xihe_blender.light_transport.inspection import SceneInspection
from xihe_blender.scene.mesh_arrays import array_of
from xihe_blender.scene.shader_nodes import Interaction, Shading, light_emits, material_shading, world_shading
from xihe_blender.scene.virtual_objects import GEOMETRY_TYPES
from xihenet.records import ArrayF64

RAYS = ("camera", "diffuse", "glossy", "transmission", "volume_scatter")
PASSED = Interaction.TRANSPARENT | Interaction.REFRACTION
LEAKY = Interaction.TRANSLUCENT | Interaction.DISPLACEMENT
N_AIMED = 1000
MAX_AIMED_AT = 20  # surfaces; 0.02 s for each in a room of few triangles


@dataclass
class TransportSurvey:
    """What light can reach over the inspected frames.

    `surfaces` have an interaction, in words ("material 'Glass' on 'Vase'"), in the order in which they were found;
    without those `unreached`, of which no ray of the camera or a probe reaches the subsurface. Names are the keys of
    dictionaries: in a list, to look for one would take minutes with tens of thousands of objects.
    """

    surfaces: dict[Interaction, dict[str, None]] = field(default_factory=dict)
    unreached: list[str] = field(default_factory=list)
    strands: dict[str, None] = field(default_factory=dict)  # objects with hair
    n_lights: int = 0  # the most lamps, emitting objects and emitting worlds at any one frame
    has_lamps: bool = False  # whether there are lamps, switched on at any frame
    emitters: dict[str, None] = field(default_factory=dict)  # names of the emitting objects
    world: Interaction = Interaction.NOTHING  # what the world may do
    defocused: dict[str, None] = field(default_factory=dict)  # cameras with depth of field
    is_moving: bool = False  # something stands otherwise in one frame than in another
    carried: list[ArrayF64] = field(default_factory=list)  # (N_SURFACES,) of each walk of light; see `enclosure`

    def which(self, *interactions: Interaction) -> list[str]:
        """What has any of `interactions`, in words."""
        found = [words for interaction in interactions for words in self.surfaces.get(interaction, ())]
        return list(dict.fromkeys(found))


class TransportSurveyor:
    """Gathers a `TransportSurvey`, one evaluated frame after the other.

    Light probes stand at `positions` (K, 3), world, metres, of which there may be none.
    """

    def __init__(self, frames: Sequence[int], positions: Sequence[Sequence[float]]) -> None:
        self.frames, self.positions = frames, positions
        self.walked = sorted({frames[0], frames[len(frames) // 2], frames[-1]})
        self.found = TransportSurvey()
        self.placements: set[tuple[int, int]] = set()
        self.leaky: set[str] = set()  # surfaces, in words, which light passes in ways that the walks do not
        self.views: list[Ray] = rays_all_round(positions)
        self.reached: list[Ray] = []  # places on surfaces that the walks met, with their normals
        self.still: dict[Any, Shading] = {}  # of what no animation changes, by original data-block
        self.slots: dict[tuple[int, int], list[int]] = {}
        """That the faces of a mesh have, at the frame that is looked at, by its address and the number of slots."""
        self.solids: dict[int, Solids] = {}
        """By how all stands: where only the phone moves, two are made, with the virtual objects and without."""

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        layer = depsgraph.view_layer_eval
        self.slots.clear()
        n_lights = self._world(getattr(layer, "world_override", None) or depsgraph.scene_eval.world)
        for instance in depsgraph.object_instances:
            n_lights += self._instance(instance)
        self.found.n_lights = max(self.found.n_lights, n_lights)
        camera = depsgraph.scene.camera.evaluated_get(depsgraph)
        if camera.type == "CAMERA" and camera.data.dof.use_dof:
            self.found.defocused[camera.name] = None
        picture = rays_through_picture(camera, depsgraph.scene)
        self.views += picture
        if depsgraph.scene.frame_current in self.walked:
            self._walk(depsgraph, picture)
        self.look_for_movement(depsgraph)

    def ended(self, inspection: SceneInspection, *, has_motion_blur: bool) -> TransportSurvey:
        """What was gathered, once light has walked the room as well; `inspection` has no virtual objects from then on.

        With `has_motion_blur` one frame alone is compared with the next.
        """
        if len(self.frames) == 1 and has_motion_blur:
            inspection.look_at(self.frames[0] + 1, self.look_for_movement)
        inspection.exclude_virtual_objects(is_excluded=True)
        for frame in self.walked:
            inspection.look_at(frame, self.walk_room)
        self.found.is_moving = len(self.placements) > 1
        self._leave_out_unreached()
        return self.found

    def walk_room(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Walk light through a graph without virtual objects, as captures and light probes show it."""
        picture = rays_through_picture(depsgraph.scene.camera.evaluated_get(depsgraph), depsgraph.scene)
        self._walk(depsgraph, rays_all_round(self.positions), picture)

    def _leave_out_unreached(self) -> None:
        """Keep what has a subsurface that a ray meets; all of it if none is met and the rays cannot tell."""
        surfaces = list(self.found.surfaces.get(Interaction.SUBSURFACE, ()))
        rooms, rng = self.solids.values(), np.random.default_rng(0)
        is_known = len(surfaces) <= MAX_AIMED_AT and len({of_surfaces for of_surfaces, _ in self.placements}) == 1
        if is_known and not any(room.met.intersection(surfaces) for room in rooms):
            for words in surfaces:
                targets = [(room, room.points_on(words, N_AIMED, rng)) for room in rooms]
                is_known &= any(len(points) for _, points in targets)
                for room, points in targets:
                    aim(room, self.views, points, rng)
                    aim(room, self.reached, points, rng)
        met = set[str]().union(*(room.met for room in rooms))
        is_known &= all(room.is_exact for room in rooms) and not met & self.leaky
        reached = [words for words in surfaces if words in met]
        if reached or is_known:
            self.found.unreached = [] if reached else surfaces
            self.found.surfaces[Interaction.SUBSURFACE] = dict.fromkeys(reached)

    def look_for_movement(self, depsgraph: bpy.types.Depsgraph) -> None:
        self.placements.add(placement(depsgraph.object_instances))

    def _world(self, world: bpy.types.World | None) -> int:
        look = self._look(world, world_shading)
        self.found.world |= look.interactions
        if world is not None and look.interactions & Interaction.VOLUME:
            self.found.surfaces.setdefault(Interaction.VOLUME, {})[f"world {world.name!r}"] = None
        return int(bool(look.interactions & Interaction.EMISSION))

    def _instance(self, instance: Any) -> int:
        """Note what an object or instance can do to light; 1 if it emits."""
        item = instance.object
        is_seen, casts_shadow = _is_visible(instance, RAYS), _is_visible(instance, ("shadow",))
        if not (is_seen or casts_shadow):
            return 0
        if item.type == "LIGHT":
            is_lit = instance.show_self and light_emits(item.data)
            self.found.has_lamps |= is_lit
            return int(is_lit)
        emits = 0
        if instance.show_self and item.type in GEOMETRY_TYPES:
            if item.type == "CURVES" and is_seen:
                self.found.strands[item.name] = None
            for material in self._used_materials(item):
                emits |= self._surface(item, material, is_seen)
                if not all(_is_visible(instance, (ray,)) for ray in RAYS):
                    self.leaky.add(_format_surface(item, material))
        if instance.show_particles and is_seen:
            for settings in (system.settings for system in item.particle_systems):
                if settings.type == "HAIR" and settings.render_type == "PATH":
                    self.found.strands[item.name] = None
                    self._surface(item, _slot_material(item, settings.material - 1), is_seen)
        return emits

    def _surface(self, item: bpy.types.Object, material: bpy.types.Material | None, is_seen: bool) -> int:
        look = self._look(material, material_shading)
        if material is None and item.type == "VOLUME":
            look = Shading(Interaction.VOLUME)
        words = _format_surface(item, material)
        if look.interactions & LEAKY or (material is not None and material.original not in self.still):
            self.leaky.add(words)
        for interaction in look.interactions if is_seen else look.interactions & Interaction.TRANSPARENT:
            self.found.surfaces.setdefault(interaction, {})[words] = None
        emits = is_seen and bool(look.interactions & Interaction.EMISSION)
        if emits:
            self.found.emitters[item.name] = None
        return int(emits)

    def _used_materials(self, item: bpy.types.Object) -> list[bpy.types.Material | None]:
        """Materials that faces of an evaluated object really have; [None] for one without slots, [] without faces."""
        n_slots = len(item.material_slots)
        if item.type != "MESH":
            return [slot.material for slot in item.material_slots] or [None]
        mesh = undivided_mesh(item)
        if len(mesh.polygons) == 0:
            return []
        if n_slots < 2:
            return [_slot_material(item, 0)]
        key = mesh.as_pointer(), n_slots
        if key not in self.slots:  # A forest has thousands of instances of one tree of many faces.
            indices = array_of(mesh.polygons, "material_index", np.int32).clip(0, n_slots - 1)
            self.slots[key] = np.flatnonzero(np.bincount(indices)).tolist()
        return [_slot_material(item, slot) for slot in self.slots[key]]

    def _look(self, block: Any, read: Any) -> Shading:
        """What `block`, as evaluated at this frame, may do; read once if nothing in it is animated."""
        look: Shading = read(None) if block is None else read_once(self.still, block, read)
        return look

    def _walk(self, depsgraph: bpy.types.Depsgraph, *bundles: Sequence[Ray]) -> None:
        def look(item: bpy.types.Object, slot: int) -> Look:
            material = _slot_material(item, slot)
            shading = self._look(material, material_shading)
            return _format_surface(item, material), None if shading.interactions & PASSED else shading.albedo

        key, _ = placement(depsgraph.object_instances)
        if key not in self.solids:
            self.solids[key] = Solids(depsgraph, lambda i: i.show_self and _is_visible(i, RAYS), look)
        for rays in bundles:
            weights, reached = carried(self.solids[key], rays, np.random.default_rng(0))
            self.found.carried.append(weights)
            self.reached += reached


def _is_visible(instance: Any, rays: Sequence[str]) -> bool:
    """Whether any of `rays` meets the instance: the object's switches and those of what instances it, as in Cycles."""
    items = [instance.object] if instance.parent is None else [instance.object, instance.parent]
    return any(all(getattr(item, f"visible_{ray}") for item in items) for ray in rays)


def _format_surface(item: bpy.types.Object, material: bpy.types.Material | None) -> str:
    return f"material {material.name!r} on {item.name!r}" if material is not None else f"{item.name!r}"


def _slot_material(item: bpy.types.Object, slot: int) -> bpy.types.Material | None:
    """The material of a slot; an index beyond the last means the last, as in Cycles."""
    slots = item.material_slots
    return slots[min(max(slot, 0), len(slots) - 1)].material if len(slots) else None
