"""The survey of a camera path: what is to be known of each frame before the first of them is captured.

The path is stepped through once. At each frame the scene is evaluated as the phone's camera and the checks read it, and
once more as Cycles is given it; whoever needs to know something of all frames takes notes of these two. Then, at three
frames, light walks the room alone; see `enclosure`. A resumed run reads the survey that it kept.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import phone_camera
from xihe_blender.errors import UserError
from xihe_blender.io.run_results import Fault
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.animation import is_animated, read_once, shows_a_film
from xihe_blender.light_transport.inspection import open_inspection
from xihe_blender.light_transport.plan import required_by_survey
from xihe_blender.light_transport.render_reuse import SceneState, StateSurvey
from xihe_blender.light_transport.transport_survey import TransportSurveyor
from xihe_blender.previs.plan import PrevisPlan, Probe
from xihe_blender.previs.scene_faults import (
    blur_faults,
    faults_at_frame,
    image_faults,
    layer_faults,
    place_faults,
    timing_faults,
    unseen_faults,
)
from xihe_blender.scene import shader_nodes
from xihe_blender.scene.estimation_positions import all_box_corners_m
from xihe_blender.scene.units import seconds_of
from xihe_blender.scene.virtual_objects import GEOMETRY_TYPES, in_virtual_collection
from xihenet.camera import in_view
from xihenet.controller import MOVED_M
from xihenet.effects import Requirement
from xihenet.phone import CameraMotion, motion_between
from xihenet.records import ArrayF64, Intrinsics

LAMP_VALUES = (
    *("shadow_soft_size", "size", "size_y", "spread", "angle", "spot_size", "spot_blend"),
    *("exposure", "use_temperature", "temperature"),
)
"""What decides a lamp's light beside power and colour: its shape, and its brightness and colour in Blender 4.5."""

LONGEST_LOOK_S = 5.0
"""Of `may_see_a_position`, for which who pressed Run waits."""

STILL = CameraMotion(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class SurveyedFrame:
    """One frame of the path, at `time_s` of the session.

    `moved` says where, in world metres, those estimation positions are that have left their first place, `in_view`
    names those that the camera sees, `motion` is the camera's while it takes the frame,
    `state` are digests of the scene, by which renders are used again, and `roughness` is the smoothest by material
    name; None where it is not known.
    """

    frame: int
    time_s: float
    moved: Mapping[str, tuple[float, ...]]
    in_view: tuple[str, ...]
    motion: CameraMotion
    state: SceneState
    roughness: Mapping[str, float | None]


@dataclass(frozen=True, eq=False)
class SceneSurvey:
    """What a scene is like along a camera path: its frames by number, in order, and what holds for all of them.

    `faults` are no reason to stop, `required` goes by effect of light transport, and `light_changes` says whether a
    light of the room is not the same in all frames.
    """

    frames: Mapping[int, SurveyedFrame]
    faults: tuple[Fault, ...]
    required: Mapping[str, Requirement]
    light_changes: bool

    @property
    def in_view(self) -> dict[int, tuple[str, ...]]:
        """Names of the estimation positions in view, by those frames that see any."""
        return {frame: one.in_view for frame, one in self.frames.items() if one.in_view}

    @property
    def states(self) -> dict[int, SceneState]:
        return {frame: one.state for frame, one in self.frames.items()}

    @property
    def moved(self) -> dict[int, Mapping[str, tuple[float, ...]]]:
        """Where estimation positions are that are not at their first place, by frame and name."""
        return {frame: one.moved for frame, one in self.frames.items()}

    def followed(self, plan: PrevisPlan) -> PrevisPlan:
        """`plan` with the places to which its estimation positions move."""
        return replace(plan, probes=tuple(_followed(probe, self.moved) for probe in plan.probes))


@dataclass(frozen=True, eq=False)
class _CameraView:
    """What the scene's camera is at one frame: which, its intrinsics and pose (4, 4) in metres, and the time."""

    camera: bpy.types.Object
    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    time_s: float


def survey_path(scene: bpy.types.Scene, plan: PrevisPlan) -> Job[SceneSurvey]:
    """A job: step through the frames of `plan` once; `scene` stays as it is.

    UserError for a frame without a phone's camera, or with numbers that Cycles leaves out.
    """
    transport = TransportSurveyor(plan.frames, [probe.position_m.tolist() for probe in plan.probes])
    states, room, movement = StateSurvey(scene), RoomSurvey(scene), MovementSurvey(plan)
    views: dict[int, _CameraView] = {}
    in_scene = range(scene.frame_start, scene.frame_end + 1)
    visited = {frame + step for frame in plan.frames for step in (-1, 0, 1) if frame + step in in_scene}
    faults = [*image_faults(scene.world), *unseen_faults(scene), *layer_faults(scene), *blur_faults(scene)]
    faults += timing_faults(scene)
    settings = RenderSettings(plan.size, samples=1)
    with open_inspection(scene) as inspection, working_scene(scene, "Xihe Survey", settings) as working:
        for frame in sorted(visited):
            yield Progress(0, 1, "surveying the path")
            working.frame_set(frame)
            is_on_path = frame in plan.frames
            # Beside the path the camera only tells how it moves: no phone's is one that was switched to.
            with contextlib.nullcontext() if is_on_path else contextlib.suppress(UserError):
                views[frame] = _CameraView(working.camera, *phone_camera(working), seconds_of(working, frame))
            if is_on_path:
                faults += faults_at_frame(working.view_layers[0].depsgraph, is_first=frame == plan.frames[0])
                inspection.look_at(frame, transport.look_at, states.look_at, room.look_at, movement.look_at)
        surveyed = transport.ended(inspection, has_motion_blur=scene.render.use_motion_blur)
    required = required_by_survey(scene, surveyed)
    cameras_m = np.stack([views[frame].world_from_camera[:3, 3] for frame in plan.frames])
    probes = [_followed(probe, movement.moved) for probe in plan.probes]
    places_m = {probe.name: np.stack([probe.at(frame) for frame in plan.frames]) for probe in probes}
    faults += place_faults(scene, places_m, cameras_m)
    frames = {
        frame: SurveyedFrame(
            frame,
            views[frame].time_s,
            movement.moved[frame],
            names_seen({p.name: p.at(frame) for p in probes}, views[frame].intrinsics, views[frame].world_from_camera),
            _camera_motion(frame, views),
            states.states[frame],
            room.roughness[frame],
        )
        for frame in plan.frames
    }
    return SceneSurvey(frames, tuple(dict.fromkeys(faults)), required, room.light_changes)


def may_see_a_position(scene: bpy.types.Scene, plan: PrevisPlan, within_s: float = LONGEST_LOOK_S) -> Job[bool]:
    """Whether any estimation position is in view of the camera in any frame; True if `within_s` is too short to tell.

    Where the first frame sees one, as the plan knows, none is looked at. `scene` stays as it is.
    """
    # Where the plan puts them is where they are in that frame.
    places_m = {probe.name: probe.position_m for probe in plan.probes}
    if plan.first_view is not None and names_seen(places_m, *plan.first_view):
        return True
    until_s, movement = time.perf_counter() + within_s, MovementSurvey(plan)
    settings, looking = RenderSettings(plan.size, samples=1), Progress(0, 1, "looking at the camera path")
    yield looking
    with open_inspection(scene) as inspection, working_scene(scene, "Xihe Look", settings) as working:
        for frame in plan.frames:
            working.frame_set(frame)
            view = phone_camera(working)
            yield looking
            inspection.look_at(frame, movement.look_at)
            if names_seen(movement.places, *view) or time.perf_counter() > until_s:
                return True
            yield looking
    return False


def _followed(probe: Probe, moved: Mapping[int, Mapping[str, tuple[float, ...]]]) -> Probe:
    places = {frame: np.array(of_frame[probe.name]) for frame, of_frame in moved.items() if probe.name in of_frame}
    return replace(probe, moved_m=places)


def names_seen(
    places_m: Mapping[str, ArrayF64], intrinsics: Intrinsics, world_from_camera: ArrayF64
) -> tuple[str, ...]:
    """Of positions (3,) by name, those that the camera sees."""
    positions_m = np.array(list(places_m.values())).reshape(-1, 3)
    seen = in_view(positions_m, intrinsics, world_from_camera)
    return tuple(name for name, is_seen in zip(places_m, seen, strict=True) if is_seen)


def _camera_motion(frame: int, views: Mapping[int, _CameraView]) -> CameraMotion:
    """How the camera moves in `frame`: evenly to the next one of `views`, or as from the one before.

    A camera that is switched, or turned by half a circle within a frame, was cut and stands still, as one does of which
    neither is known.
    """
    for before, after in ((frame, frame + 1), (frame - 1, frame)):
        if before not in views or after not in views or views[before].camera != views[after].camera:
            continue
        start, end = views[before], views[after]
        with contextlib.suppress(ValueError):
            return motion_between(start.world_from_camera, end.world_from_camera, end.time_s - start.time_s)
    return STILL


class RoomSurvey:
    """What a phone must know of the room besides its pictures: does any light change, and how smooth are the materials?

    Both are read off node trees and lights as Cycles is given them, one evaluated frame after the other. Virtual
    objects do not count: a capture shows neither them nor their light. `roughness` is the smoothest by material name,
    for each frame; None where it is not known.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self.virtual = set(in_virtual_collection(scene))
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
            parents = {one.original for one in (instance.object, instance.parent) if one is not None}
            if instance.show_self and not parents & self.virtual:
                lights |= self._lights_of(instance, found)
        world = depsgraph.scene_eval.world
        if world is not None and shader_nodes.world_shading(world).interactions & shader_nodes.Interaction.EMISSION:
            lights.add(world.name)
            self.is_driven |= _may_change(world.original)
        self.lights.add(frozenset(lights))
        # Of 3,000 materials each takes 0.4 MB, and few ever change.
        before = next(reversed(self.roughness.values()), found)
        self.roughness[depsgraph.scene.frame_current] = before if before == found else found

    def _lights_of(self, instance: Any, found: dict[str, float | None]) -> set[Any]:
        """What glows about an instance, as something that differs where the light does; notes its materials."""
        item = instance.object
        place = tuple(map(tuple, instance.matrix_world))
        if item.type == "LIGHT":
            if not shader_nodes.light_emits(item.data):
                return set()
            self.is_driven |= item.data.node_tree is not None and _may_change(item.data.node_tree.original)
            others = (float(getattr(item.data, name, 0.0)) for name in LAMP_VALUES)
            return {(item.name, place, item.data.energy, tuple(item.data.color), *others)}
        glowing = set()
        slots = item.material_slots if item.type in GEOMETRY_TYPES else ()
        for material in (slot.material for slot in slots if slot.material is not None):
            found[material.name], glows = read_once(self._still, material, _roughness_and_glow)
            if glows:
                self.is_driven |= _may_change(material.original)
                box = tuple(map(tuple, item.bound_box))  # It may grow where it stands.
                glowing.add((item.name, material.name, place, box, tuple(item.color)))
        return glowing


def _roughness_and_glow(material: bpy.types.Material) -> tuple[float | None, bool]:
    glows = shader_nodes.material_shading(material).interactions & shader_nodes.Interaction.EMISSION
    return shader_nodes.smoothest_roughness(material), bool(glows)


def _may_change(block: bpy.types.ID) -> bool:
    return is_animated(block) or shows_a_film(block if isinstance(block, bpy.types.NodeTree) else block.node_tree)


class MovementSurvey:
    """Gathers the places of the estimation positions of `plan`, one evaluated frame after the other.

    They keep their share of the object's box, which turns as the object does: so an object that moves by keys, parents,
    constraints, bones or physics takes them with it, and one that spins or breathes hardly does. Rejected: splitting
    the box anew at each frame, which for a long shelf that turns gives other positions, and another number of them.

    `moved` has those that are not where the plan has them, by frame. One stays where it was until it is further than
    MOVED_M from there, and in frames in which its object is nowhere.
    """

    def __init__(self, plan: PrevisPlan) -> None:
        self.plan = plan
        self.places = {probe.name: probe.position_m for probe in plan.probes}
        self.first: dict[str, tuple[ArrayF64, ArrayF64]] = {}
        """By object: its axes (3, 3) in the first frame, and which share of its box (K, 3) the positions have."""
        self.moved: dict[int, dict[str, tuple[float, ...]]] = {}

    def look_at(self, depsgraph: bpy.types.Depsgraph) -> None:
        corners_m = all_box_corners_m(self.plan.objects, depsgraph)
        for item in self.plan.objects:
            probes, axes = self.plan.probes_of(item.name), _axes(item.evaluated_get(depsgraph))
            if item.name not in self.first:
                low_m, size_m = _box(corners_m[item], np.eye(3))
                within_m = np.stack([probe.position_m for probe in probes]) - low_m
                # Outside of the box is one that the plan, which does not look as renders do, has found elsewhere.
                is_known = (size_m > MOVED_M) & (within_m > 0) & (within_m < size_m)
                self.first[item.name] = axes, np.where(is_known, within_m / np.where(is_known, size_m, 1), 0.5)
            first_axes, shares = self.first[item.name]
            turn = axes @ first_axes.T
            low_m, size_m = _box(corners_m[item], turn)
            for probe, place in zip(probes, (low_m + shares * size_m) @ turn.T, strict=True):
                if np.linalg.norm(place - self.places[probe.name]) > MOVED_M:
                    self.places[probe.name] = place
        self.moved[depsgraph.scene.frame_current] = {
            probe.name: tuple(self.places[probe.name].tolist())
            for probe in self.plan.probes
            if self.places[probe.name] is not probe.position_m
        }


def _axes(item: bpy.types.Object) -> ArrayF64:
    """(3, 3) a rotation, whatever the scale."""
    return np.array(item.matrix_world.to_quaternion().normalized().to_matrix(), np.float64)


def _box(corners_m: ArrayF64, axes: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
    """(3,) the low corner and the size of a box with these corners (K, 3) along the columns of `axes`, in metres."""
    turned_m = corners_m @ axes
    low_m: ArrayF64 = turned_m.min(axis=0)
    return low_m, turned_m.max(axis=0) - low_m
