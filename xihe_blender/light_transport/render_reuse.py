"""In which frames is everything that Cycles would be given the same, so that a render need not be made again?

The scene is evaluated at each frame, as Cycles would be given it, and what could differ becomes a digest: where
everything stands, visibility, the shape of what can deform, the values of what is animated or driven. Two frames with
equal digests give the same pixels, because the seed of Cycles is fixed for a run. Rejected: to compare F-curves, which
says nothing of drivers, constraints, simulations and Python; and Blender's own list of what it evaluated anew, which
names whatever is animated, also where no value changes.

When unsure, a frame counts as changed: with particles, smoke, image sequences, movies and volumes that come in frames,
with motion blur, which looks beyond the frame, and wherever an add-on has a hand in every frame (handlers).
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import bpy

from xihe_blender.light_transport.animation import (
    UnreadableError,
    instances_of,
    is_animated,
    is_film,
    reads_instances,
    shape_of,
    values_of,
)
from xihe_blender.scene.virtual_objects import GEOMETRY_TYPES, in_virtual_collection

HANDLERS = ("frame_change_pre", "frame_change_post", "depsgraph_update_pre", "depsgraph_update_post", "render_pre")
RAYS = ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
FIXED = {"ARRAY", "BEVEL", "DECIMATE", "EDGE_SPLIT", "MIRROR", "MULTIRES", "REMESH", "SCREW", "SMOOTH", "SOLIDIFY",
         "SUBSURF", "TRIANGULATE", "WEIGHTED_NORMAL", "WELD", "WIREFRAME"}  # fmt: skip
"""Modifiers that give the same shape in every frame, where nothing is animated and they follow no other object."""

MATRICES = {"matrix_world", "matrix_local", "matrix_basis", "matrix_parent_inverse"}
SHADERS = {"MATERIAL", "NODETREE", "WORLD", "LIGHT", "TEXTURE"}


@dataclass(frozen=True)
class SceneState:
    """Digests of one frame; equal where a render would be equal, different where it may differ."""

    room: str  # of all that lights the room: everything but the camera and the virtual objects
    virtual: str
    camera: str


def each_its_own(frames: Iterable[int]) -> dict[int, SceneState]:
    """States of which no two are equal, where nothing is known of the frames."""
    return {frame: SceneState(*[f"frame {frame}"] * 3) for frame in frames}


class StateSurvey:
    """Gathers the state of `scene` at each frame that is looked at."""

    def __init__(self, scene: bpy.types.Scene) -> None:
        self.virtual = set(in_virtual_collection(scene))
        users = bpy.data.user_map(key_types={"OBJECT"}, value_types=SHADERS)
        self.in_shaders = {item for item, of_item in users.items() if of_item}
        """Objects whose place a texture follows."""
        trees = [*(material.node_tree for material in bpy.data.materials), *bpy.data.node_groups]
        self.reads_instances = any(map(reads_instances, trees))
        handlers = [handler for name in HANDLERS for handler in getattr(bpy.app.handlers, name)]
        # The panel's own handlers only take notice.
        self.is_sure = all(str(getattr(one, "__module__", "")).startswith("xihe_blender.") for one in handlers)
        self.states: dict[int, SceneState] = {}

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        with warnings.catch_warnings():
            # Every property is read, those that a later Blender will not have any more included.
            warnings.simplefilter("ignore", DeprecationWarning)
            self._look_at(depsgraph)

    def _look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        frame = depsgraph.scene.frame_current
        room, virtual = _Digest(frame), _Digest(frame)
        if not self.is_sure:
            room.never_the_same()
        camera = depsgraph.scene.camera
        for block in depsgraph.ids:
            if isinstance(block, bpy.types.Object):
                is_apart = block.original in self.virtual or block.type == "CAMERA"
                if not is_apart or block.original in self.in_shaders:
                    room.add(block.name_full, _matrix(block))
                if block.type != "CAMERA" and is_animated(block.original):
                    values = (entry for entry in values_of(block) if entry[0] not in MATRICES)
                    (virtual if block.original in self.virtual else room).add(block.name_full, *values)
                if self.reads_instances and any(modifier.type == "NODES" for modifier in block.modifiers):
                    (virtual if block.original in self.virtual else room).add_all(instances_of(block))
            elif not isinstance(block, bpy.types.Camera):
                _add_block(room, block)
        self._instances(depsgraph, room, virtual)
        digests = room, virtual, _camera_digest(camera, depsgraph)
        self.states[frame] = SceneState(*(digest.hash.hexdigest() for digest in digests))

    def _instances(self, depsgraph: bpy.types.Depsgraph, room: _Digest, virtual: _Digest) -> None:
        read: set[tuple[int, int]] = set()
        for instance in depsgraph.object_instances:
            item = instance.object
            owner = instance.parent.original if instance.is_instance else item.original
            digest = virtual if owner in self.virtual else room
            if item.type == "CAMERA":
                continue
            visible = tuple(getattr(item, f"visible_{ray}") for ray in RAYS)
            shown = (instance.show_self, instance.show_particles, instance.random_id, *instance.persistent_id)
            digest.add(item.name_full, _matrix(instance), *visible, *shown)
            if instance.particle_system is not None or (instance.show_particles and len(item.particle_systems)):
                digest.never_the_same()
            if item.type in GEOMETRY_TYPES:
                _add_shape(digest, item, read)


class _Digest:
    def __init__(self, frame: int) -> None:
        self.frame = frame
        self.hash = hashlib.blake2b(digest_size=16)

    def add(self, *values: Any) -> None:
        self.hash.update(repr(values).encode())

    def add_all(self, parts: Iterable[bytes]) -> None:
        """Where `parts` cannot be read no frame is like another."""
        try:
            for part in parts:
                self.hash.update(part)
        except UnreadableError:
            self.never_the_same()

    def never_the_same(self) -> None:
        self.add("frame", self.frame)


def _matrix(item: Any) -> tuple[float, ...]:
    """Rounded to a micrometre: an F-curve between two equal keys gives their value to the last bit but one."""
    return tuple(round(value, 6) for row in item.matrix_world for value in row)


def _add_block(digest: _Digest, block: bpy.types.ID) -> None:
    """What a data-block other than an object may change from frame to frame."""
    is_image, is_volume = isinstance(block, bpy.types.Image), isinstance(block, bpy.types.Volume)
    if (is_image and is_film(block)) or (is_volume and block.is_sequence):
        digest.never_the_same()
    elif not is_animated(block.original):
        return
    elif isinstance(block, bpy.types.Scene):
        parts = [block, block.cycles, block.render, block.view_layers[0]]
        digest.add(*(entry for part in parts for entry in _scene_values(part)))
    else:
        digest.add(block.name_full, *values_of(block))


def _scene_values(part: Any) -> Iterator[tuple[Any, ...]]:
    """Numbers and switches only: what a scene holds is looked at one by one, and its frame always differs."""
    for described in part.bl_rna.properties:
        if described.type in ("BOOLEAN", "INT", "FLOAT", "ENUM") and not described.identifier.startswith("frame_"):
            value: Any = getattr(part, described.identifier, None)
            yield described.identifier, tuple(value) if hasattr(value, "__len__") else value
    if isinstance(part, bpy.types.Scene | bpy.types.ViewLayer):
        yield from ((key, str(part[key])) for key in part.keys() if key != "cycles")  # noqa: SIM118 - not a dict


def _add_shape(digest: _Digest, item: bpy.types.Object, read: set[tuple[int, int]]) -> None:
    """What an evaluated object is made of; `read` gathers the shapes that are in a digest already."""
    digest.add(*(slot.material.name_full for slot in item.material_slots if slot.material is not None))
    if not _may_deform(item.original):
        return
    if any(modifier.type == "FLUID" for modifier in item.modifiers):
        digest.never_the_same()
    # A shape that the room and a virtual object share belongs to both.
    key = (item.data.as_pointer(), id(digest))
    if key in read:
        return
    read.add(key)
    digest.add_all(shape_of(item))


def _may_deform(item: bpy.types.Object) -> bool:
    """Whether the shape of `item` can be another one in another frame. Not by reading it: that would subdivide it."""
    if item.type == "VOLUME":
        return bool(item.modifiers)
    if item.type != "MESH" or item.data.shape_keys is not None or is_animated(item.data):
        return True
    if item.modifiers and is_animated(item):
        return True
    return any(modifier.type not in FIXED or _follows_an_object(modifier) for modifier in item.modifiers)


def _follows_an_object(modifier: bpy.types.Modifier) -> bool:
    pointers = (described.identifier for described in modifier.bl_rna.properties if described.type == "POINTER")
    return any(isinstance(getattr(modifier, name), bpy.types.Object) for name in pointers)


def _camera_digest(camera: bpy.types.Object | None, depsgraph: bpy.types.Depsgraph) -> _Digest:
    digest = _Digest(depsgraph.scene.frame_current)
    if camera is not None:
        evaluated = camera.evaluated_get(depsgraph)
        digest.add(camera.name_full, _matrix(evaluated), *values_of(evaluated.data))
        focus = evaluated.data.dof.focus_object
        if focus is not None:
            digest.add(_matrix(focus.evaluated_get(depsgraph)))
    return digest


@dataclass(frozen=True)
class RenderReuse:
    """Which earlier frame of a run holds a render that would come out the same; made by `plan_render_reuse`."""

    states: Mapping[int, SceneState]  # of the scene, by frame
    captures: Mapping[int, int]  # for each captured frame, the frame that holds its capture: an earlier one, or itself
    probes: Mapping[tuple[int, str], int]  # the same for each light probe, which does not depend on the camera, by name

    def comparison(self, frame: int, *made_from: bytes) -> tuple[Any, ...]:
        """Equal for frames whose comparisons are, which are made from capture and lights, `made_from`, as well."""
        return self.states[frame], *(hashlib.blake2b(content, digest_size=16).digest() for content in made_from)


def plan_render_reuse(
    states: Mapping[int, SceneState],
    in_view: Mapping[int, Iterable[str]],
    moved: Mapping[int, Mapping[str, tuple[float, ...]]],
) -> RenderReuse:
    """For a run that captures the frames of `in_view`, in that order, with the light probes that each sees.

    `moved` has the places of probes that are not at their first one, by frame.
    """
    first: dict[tuple[Any, ...], int] = {}
    captures, probes = {}, {}
    for frame, names in in_view.items():
        room = states[frame].room
        captures[frame] = first.setdefault((room, "capture", states[frame].camera), frame)
        for name in names:
            probes[frame, name] = first.setdefault((room, "probe", name, moved.get(frame, {}).get(name)), frame)
    return RenderReuse(states, captures, probes)
