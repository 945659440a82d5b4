"""Effects of a phone that a run of this scene would simulate, before there is one.

A run plans them from its captures; see `phone_capture`. So the path is captured here as well, with few samples:
distances, edges and angles do not depend on their number, and brightness hardly. What needs no capture (how the camera
moves, which lights change, how long the path is) is known either way, and is all there is to go by where nothing may be
rendered, as in the panel: what only a capture could rule out then stays on.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, surfaces_in
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import first_layer, open_scanner, sized_for
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.phone_capture import (
    CaptureFacts,
    ChosenPhone,
    choose_phone,
    facts_of_capture,
    simulate_phone,
)
from xihe_blender.previs.plan import DEFAULT_SIZE, PrevisPlan, Probe, planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.state import scene_kept
from xihenet.effects import Effect

N_SAMPLES = 4


def plan_phone_effects(
    scene: bpy.types.Scene, positions: Sequence[Sequence[float]], settings: PrevisSettings, *, is_captured: bool
) -> Job[dict[str, Effect]]:
    """The effects of phone and network, as `settings` has them; none for a perfect phone that estimates by itself.

    Parameters
    ----------
    scene : stays as it is
    positions : (K, 3) world, metres: where light is estimated. As in a run, a frame that sees none is not captured
    settings : of the run: phone, network, frames, size, choices
    is_captured : render the path, N_SAMPLES per pixel; else an effect that only captures could rule out is on

    Raises
    ------
    UserError for a scene without a camera, frames outside its range, or choices that the phone does not have
    """
    frames = tuple(planned_frames(scene, settings.frames))
    size = settings.size or sized_for(scene, RenderSettings(DEFAULT_SIZE, samples=1)).size
    probes = tuple(Probe(str(k), "", np.array(position)) for k, position in enumerate(positions))
    plan = PrevisPlan(frames, size, (), probes)
    render = settings.capture(size, N_SAMPLES)
    if not settings.profile.effects and settings.link is None:
        return {}
    with scene_kept():
        survey = survey_path(scene, plan)
        phone = choose_phone(scene, survey, settings)
        facts = (yield from _facts(scene, plan, survey, phone, render)) if is_captured and phone.sees else {}
        return dict(simulate_phone(phone, survey, facts, exposure=1.0).effects)


def _facts(
    scene: bpy.types.Scene, plan: PrevisPlan, survey: SceneSurvey, phone: ChosenPhone, render: RenderSettings
) -> Job[dict[int, CaptureFacts]]:
    """A job: the facts of every frame that a run would capture."""
    needs, facts = phone.needs, {}
    positions_m = np.array([probe.position_m for probe in plan.probes])
    with open_scanner(scene, render) as scanner:
        if needs.surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])
        for done, frame in enumerate(plan.frames):
            yield Progress(done, len(plan.frames), f"looking at frame {frame} as the phone does")
            if frame in needs.delivered and frame in survey.in_view:
                scanner.move_to(frame)
                captured, passes = scanner.acquire_environment_scan(), next(iter(scanner.rendered.layers.values()))
                surfaces = surfaces_in(passes, survey.frames[frame].roughness) if needs.surfaces else None
                radiance = first_layer(scanner.rendered)[0] if needs.radiance else None
                facts[frame] = facts_of_capture(captured, positions_m, phone.metering, surfaces, radiance)
    return facts
