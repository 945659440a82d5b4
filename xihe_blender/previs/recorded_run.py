"""A run on what a phone recorded: its frames stand where rendered captures would.

The chain, the lights on the timeline and the lit .blend are those of any run. The phone is the one that recorded, so
none is simulated; exposure and trigger are the session's, as `xihe replay` has them, and so is the light. There is no
light probe and no ground truth: nobody can render the room that the phone was in.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import phone_camera
from xihe_blender.errors import UserError
from xihe_blender.footage.import_capture import capture_of, captured_frames, read_captured, steadied_frames
from xihe_blender.io.outputs import RunOutputs, write_json, write_picture
from xihe_blender.io.run_results import RecordingResult
from xihe_blender.jobs import Job
from xihe_blender.previs.plan import PrevisPlan, planned_frames
from xihe_blender.previs.prepare import PreparedRun, prepare_run
from xihe_blender.previs.run_chain import is_whole
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, names_seen
from xihe_blender.scene.phone_capture import IS_CAPTURED, remembered_capture
from xihenet.captures.capture import Capture, CapturedFrame
from xihenet.captures.replay import REPLAY_TRIGGER
from xihenet.estimators import Estimator
from xihenet.io.recording import save_frame

MOVED_M, TURNED = 0.01, 0.02
"""By so much (of the latter in radians) the scene's camera may be off the phone's."""


@dataclass(frozen=True, eq=False)
class RecordedSession:
    """The recording of a scene, and a run's settings on it.

    `frames` are those of the path that `capture` has, by number; `settings` the user's, with the recording's own
    size, frames, exposure and trigger, and a phone that adds no errors; `said` what results say of it.
    """

    capture: Capture
    frames: Mapping[int, CapturedFrame]
    settings: PrevisSettings
    said: RecordingResult

    @property
    def digest(self) -> str:
        """Of all but the pixels: another recording has another."""
        parts = hashlib.blake2b(digest_size=16)
        for one in self.frames.values():
            k = one.camera.intrinsics
            parts.update(repr((one.number, one.time_s, k.width, k.height, k.fx, k.fy, k.cx, k.cy)).encode())
            parts.update(one.camera.world_from_camera.tobytes())
        return parts.hexdigest()

    def check_camera(self, scene: bpy.types.Scene, plan: PrevisPlan) -> None:
        """UserError where the scene's camera is not where the phone was: light and pictures would not fit."""
        chosen = sorted({plan.frames[0], plan.frames[len(plan.frames) // 2], plan.frames[-1]})
        with working_scene(scene, "Xihe Plan", RenderSettings(plan.size, samples=1)) as working:
            for frame in chosen:
                working.frame_set(frame)
                _, pose = phone_camera(working)
                own = self.frames[frame].camera.world_from_camera
                off_m = float(np.linalg.norm(pose[:3, 3] - own[:3, 3]))
                if off_m > MOVED_M or np.abs(pose[:3, :3] - own[:3, :3]).max() > TURNED:
                    raise UserError(
                        f"at frame {frame} camera {scene.camera.name!r} is not where the phone was ({off_m:.2f} m off, "
                        "or turned): choose the imported camera, undo its move, or import the recording again"
                    )


def recorded_session(scene: bpy.types.Scene, settings: PrevisSettings) -> RecordedSession | None:
    """The recording that `scene` shows, for a run by `settings`; None for a scene whose captures are rendered.

    UserError where it cannot be read, has no frame of the path, or cannot give what is asked for.
    """
    remembered, capture = remembered_capture(scene), capture_of(scene)
    if remembered is None or capture is None:
        return None
    if "truth" in (settings.estimator, *settings.others):
        raise UserError("the light of `truth` is rendered, which a recording cannot be: choose another estimator")
    known = captured_frames(capture)
    frames = {number: known[number] for number in planned_frames(scene, settings.frames) if number in known}
    if not frames:
        raise UserError(f"the recording has none of these frames: choose among {min(known)} to {max(known)}")
    first = read_captured(next(iter(frames.values())))
    settings = replace(
        settings,
        frames=tuple(frames),
        size=(first.intrinsics.width, first.intrinsics.height),
        exposure=capture.reference_exposure or first.exposure,
        trigger=settings.trigger or capture.trigger or REPLAY_TRIGGER,
        phone="perfect",
    )
    said = RecordingResult(
        name=remembered.path.name,
        format=capture.format_name,
        source=capture.source,
        said=IS_CAPTURED,
        notes=capture.notes,
    )
    return RecordedSession(capture, frames, settings, said)


def prepare_recorded(
    scene: bpy.types.Scene,
    plan: PrevisPlan,
    survey: SceneSurvey,
    outputs: RunOutputs,
    recorded: RecordedSession,
    loaded: Sequence[Estimator],
) -> Job[PreparedRun]:
    """A job: as `prepare_run`, with the captures in place."""
    survey = seen_by_phone(survey, survey.followed(plan), recorded.frames)
    run = yield from prepare_run(scene, plan, survey, outputs, recorded.settings, loaded, has_truth=False)
    yield from _keep_captures(run, recorded)
    return run


def seen_by_phone(survey: SceneSurvey, plan: PrevisPlan, frames: Mapping[int, CapturedFrame]) -> SceneSurvey:
    """`survey` with the recording's times, and the positions that its cameras see.

    Those that none of them sees are in view in all frames, as in `xihe replay`, or they would have no light.
    """
    seen: dict[int, set[str]] = {}
    for number, one in frames.items():
        places_m = {probe.name: probe.at(number) for probe in plan.probes}
        seen[number] = set(names_seen(places_m, one.camera.intrinsics, one.camera.world_from_camera))
    never = {probe.name for probe in plan.probes}.difference(*seen.values())
    return replace(
        survey,
        frames={
            number: replace(
                one,
                time_s=frames[number].time_s,
                in_view=tuple(probe.name for probe in plan.probes if probe.name in seen[number] | never),
            )
            for number, one in survey.frames.items()
        },
    )


def _keep_captures(run: PreparedRun, recorded: RecordedSession) -> Job[None]:
    """A job: the recording's frames as the captures of a run, where these are not kept yet.

    Exposure and white balance that drifted unsaid are followed over the whole recording, as `xihe replay` does it.
    """
    numbers = [number for number in run.plan.frames if number in run.needs.captured]
    missing = [n for n in numbers if not is_whole(run.outputs, run.needs, n)]
    frames = recorded.frames
    if missing and not recorded.capture.is_exposure_known:
        yield run.progress("capture", 0.0, "following exposure and white balance")
        frames = steadied_frames(recorded.capture)
    for done, number in enumerate(missing):
        yield run.progress("capture", done / len(missing), f"reading frame {number} of the recording")
        seen = replace(read_captured(frames[number]), frame=number)
        if (seen.intrinsics.width, seen.intrinsics.height) != run.plan.size:
            raise UserError(
                f"frame {number} of the recording has {seen.intrinsics.width}x{seen.intrinsics.height} pixels and the "
                f"first {run.plan.size[0]}x{run.plan.size[1]}: record all with one size"
            )
        run.outputs.capture(number).parent.mkdir(parents=True, exist_ok=True)
        save_frame(run.outputs.capture(number), seen)
        write_picture(run.outputs.picture("captured", number), seen.srgb_u8)
        write_json(run.outputs.times(number), {"render_s": 0.0})
