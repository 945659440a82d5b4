"""The survey of a camera path: what is to be known of each frame before the first of them is captured.

The path is stepped through once. At each frame the scene is evaluated as the phone's camera and the checks read it, and
once more as Cycles is given it; whoever needs to know something of all frames takes notes of these two. Then, at three
frames, light walks the room alone; see `enclosure`. A resumed run reads the survey that it kept.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import phone_camera, session_time_s
from xihe_blender.errors import UserError
from xihe_blender.io.run_results import Fault
from xihe_blender.light_transport.inspection import open_inspection
from xihe_blender.light_transport.plan import required_by_survey
from xihe_blender.light_transport.render_reuse import SceneState, StateSurvey
from xihe_blender.light_transport.transport_survey import TransportSurveyor
from xihe_blender.previs.phone_room import RoomSurvey
from xihe_blender.previs.plan import PrevisPlan, Probe
from xihe_blender.previs.scene_faults import faults_at_frame, image_faults, place_faults
from xihenet.camera import in_view
from xihenet.effects import Requirement
from xihenet.phone import CameraMotion, motion_between
from xihenet.records import ArrayF64, Intrinsics

STILL = CameraMotion(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class SurveyedFrame:
    """One frame of the path, at `time_s` of the session.

    `in_view` names the estimation positions that the camera sees, `motion` is the camera's while it takes the frame,
    `state` are digests of the scene, by which renders are used again, and `roughness` is the smoothest by material
    name; None where it is not known.
    """

    frame: int
    time_s: float
    in_view: tuple[str, ...]
    motion: CameraMotion
    state: SceneState
    roughness: Mapping[str, float | None]

    def as_json(self) -> dict[str, Any]:
        return asdict(self) | {"motion": {name: vector.tolist() for name, vector in vars(self.motion).items()}}

    @classmethod
    def from_json(cls, row: Mapping[str, Any]) -> SurveyedFrame:
        motion = CameraMotion(**{name: np.array(vector, float).reshape(3) for name, vector in row["motion"].items()})
        read = {"in_view": tuple(row["in_view"]), "motion": motion, "state": SceneState(**row["state"])}
        return cls(**{**row, **read})


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

    def as_json(self) -> dict[str, Any]:
        """For `from_json`, to the last bit."""
        return asdict(self) | {"frames": [one.as_json() for one in self.frames.values()]}

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> SceneSurvey:
        frames = map(SurveyedFrame.from_json, content["frames"])
        faults = tuple(Fault(**fault) for fault in content["faults"])
        required = {name: Requirement(**requirement) for name, requirement in content["required"].items()}
        return cls({one.frame: one for one in frames}, faults, required, content["light_changes"])


@dataclass(frozen=True, eq=False)
class _CameraView:
    """What the scene's camera is at one frame: which, its intrinsics and pose (4, 4) in metres, and the time."""

    camera: bpy.types.Object
    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    time_s: float


def survey_path(scene: bpy.types.Scene, plan: PrevisPlan) -> SceneSurvey:
    """Step through the frames of `plan` once; `scene` stays as it is.

    UserError for a frame without a phone's camera, or with numbers that Cycles leaves out.
    """
    transport = TransportSurveyor(plan.frames, [probe.position_m.tolist() for probe in plan.probes])
    states, room = StateSurvey(scene), RoomSurvey(scene)
    views: dict[int, _CameraView] = {}
    in_scene = range(scene.frame_start, scene.frame_end + 1)
    visited = {frame + step for frame in plan.frames for step in (-1, 0, 1) if frame + step in in_scene}
    faults = list(image_faults(scene.world))
    settings = RenderSettings(plan.size, samples=1)
    with open_inspection(scene) as inspection, working_scene(scene, "Xihe Survey", settings) as working:
        for frame in sorted(visited):
            working.frame_set(frame)
            is_on_path = frame in plan.frames
            # Beside the path the camera only tells how it moves: no phone's is one that was switched to.
            with contextlib.nullcontext() if is_on_path else contextlib.suppress(UserError):
                views[frame] = _CameraView(working.camera, *phone_camera(working), session_time_s(working))
            if is_on_path:
                faults += faults_at_frame(working.view_layers[0].depsgraph, is_first=frame == plan.frames[0])
                inspection.look_at(frame, transport.look_at, states.look_at, room.look_at)
        surveyed = transport.ended(inspection, has_motion_blur=scene.render.use_motion_blur)
    required = required_by_survey(scene, surveyed)
    cameras_m = np.stack([views[frame].world_from_camera[:3, 3] for frame in plan.frames])
    faults += place_faults(scene, {probe.name: probe.position_m for probe in plan.probes}, cameras_m)
    frames = {
        frame: SurveyedFrame(
            frame,
            views[frame].time_s,
            _in_view(plan.probes, views[frame]),
            _camera_motion(frame, views),
            states.states[frame],
            room.roughness[frame],
        )
        for frame in plan.frames
    }
    return SceneSurvey(frames, tuple(dict.fromkeys(faults)), required, room.light_changes)


def _in_view(probes: Sequence[Probe], view: _CameraView) -> tuple[str, ...]:
    positions_m = np.array([probe.position_m for probe in probes]).reshape(-1, 3)
    seen = in_view(positions_m, view.intrinsics, view.world_from_camera)
    return tuple(probe.name for probe, is_seen in zip(probes, seen, strict=True) if is_seen)


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
