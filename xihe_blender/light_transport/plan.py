"""Effects of light transport: what a scene requires of each, and the plan that all renders of a run share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy

from xihe_blender.capture.render import RenderSettings, can_denoise, working_scene
from xihe_blender.jobs import Job, Progress, run_blocking
from xihe_blender.light_transport.enclosure import MAX_BOUNCES
from xihe_blender.light_transport.inspection import open_inspection
from xihe_blender.light_transport.rules import RULES, SceneFacts
from xihe_blender.light_transport.transport_survey import TransportSurvey, TransportSurveyor
from xihenet.effects import Effect, Requirement

BOUNCES = ("diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces")


def required_effects(
    scene: bpy.types.Scene, positions: Sequence[Sequence[float]] = (), *, frames: Sequence[int] | None = None
) -> dict[str, Requirement]:
    """What `scene` requires; see `look_for_effects`."""
    return run_blocking(look_for_effects(scene, positions, frames=frames))


def look_for_effects(
    scene: bpy.types.Scene, positions: Sequence[Sequence[float]] = (), *, frames: Sequence[int] | None = None
) -> Job[dict[str, Requirement]]:
    """A job: what `scene`, room and virtual objects, itself requires, effect by effect; it stays as it is.

    `positions` are as in `TransportSurveyor`; each of `frames` is judged, None takes the scene's range.
    """
    chosen = range(scene.frame_start, scene.frame_end + 1, scene.frame_step) if frames is None else frames
    surveyor = TransportSurveyor(list(chosen), positions)
    with open_inspection(scene) as inspection:
        for frame in chosen:
            yield Progress(0, 1, "looking at the scene")
            inspection.look_at(frame, surveyor.look_at)
        survey = surveyor.ended(inspection, has_motion_blur=scene.render.use_motion_blur)
    return required_by_survey(scene, survey)


def required_by_survey(scene: bpy.types.Scene, survey: TransportSurvey) -> dict[str, Requirement]:
    """The same, where the scene has been surveyed."""
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        facts = SceneFacts(survey, scene, can_denoise(working))
    return {name: rule(facts) for name, rule in RULES.items()}


def cycles_settings(effects: Mapping[str, Effect]) -> tuple[tuple[str, bool | int], ...]:
    """What to set on a working scene: settings of Cycles by name, each kind of bounce by its own limit alone."""
    of_effects = {name: value for effect in RULES for name, value in effects[effect].parameters.items()}
    settings = {name: value if isinstance(value, bool) else int(value) for name, value in of_effects.items()}
    return (*settings.items(), ("max_bounces", min(MAX_BOUNCES, sum(settings[kind] for kind in BOUNCES))))
