"""Effects that a run of this scene would simulate, before there is one, with what each costs.

A run plans those of its phone from its captures; see `simulated_phone`. So the path is captured here as well, with few
samples: distances, edges and angles do not depend on their number, and brightness hardly. What needs no capture (how
the camera moves, which lights change, how long the path is) is known either way, and is all there is to go by where
nothing may be rendered, as in the panel: what only a capture could rule out then stays on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import bpy
import numpy as np

from xihe_blender.capture.phone_surfaces import ask_for_surfaces, surfaces_in
from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import first_layer, open_scanner
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.costs import measure_costs
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.light_transport.plan import look_for_effects
from xihe_blender.previs.plan import PrevisPlan, Probe, captured_size, planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.simulated_phone import (
    CaptureFacts,
    ChosenPhone,
    choose_phone,
    facts_of_capture,
    simulate_phone,
)
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.effects import Effect, EffectCost, plan_effects

N_SAMPLES = 4


def effects_of_run(
    scene: bpy.types.Scene,
    settings: PrevisSettings,
    *,
    is_measured: bool = True,
    budget_s: float = 60.0,
    on_planned: Callable[[dict[str, Effect]], None] | None = None,
    on_cost: Callable[[str, EffectCost], None] | None = None,
) -> Job[dict[str, Effect]]:
    """The effects of a run on all virtual objects of `scene`, in the order in which results.json has them.

    A scene without virtual objects, or without a camera, has them too; a perfect phone that estimates by itself has
    none of its own.

    Parameters
    ----------
    settings : of the run; costs are measured at the middle one of its frames
    is_measured : render what each effect costs and changes, some 150 small renders, and what the phone would capture
    budget_s : for the costs; see `measure_costs`
    on_planned, on_cost : called once with the effects before any cost is known, and with each cost as it is known

    UserError for frames outside the scene's range, a phone without a camera, or choices that make no sense.
    """
    frames = planned_frames(scene, settings.frames)
    choices = overrides_in_force(scene, settings.effect_choices)
    positions = positions_in(scene, frames[0])
    required = yield from look_for_effects(scene, positions, frames=frames)
    of_phone = yield from plan_phone_effects(scene, positions, settings, is_captured=is_measured)
    effects = plan_effects(required, choices) | of_phone
    if on_planned is not None:
        on_planned(effects)
    if not is_measured:
        return effects
    middle = frames[len(frames) // 2]
    costs = yield from measure_costs(scene, required, choices, positions, middle, budget_s=budget_s, on_cost=on_cost)
    return {name: replace(effect, cost=costs.get(name)) for name, effect in effects.items()}


def positions_in(scene: bpy.types.Scene, frame: int) -> list[list[float]]:
    """Where the light of the virtual objects is estimated."""
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        working.frame_set(frame)
        depsgraph = working.view_layers[0].depsgraph
        return [place.tolist() for item in virtual_objects(scene) for place in estimation_positions(item, depsgraph)]


def plan_phone_effects(
    scene: bpy.types.Scene, positions: Sequence[Sequence[float]], settings: PrevisSettings, *, is_captured: bool
) -> Job[dict[str, Effect]]:
    """The effects of phone and network, as `settings` has them; none for a perfect phone that estimates by itself.

    Parameters
    ----------
    positions : (K, 3) world, metres: where light is estimated
    is_captured : render the path, N_SAMPLES per pixel; else an effect that only captures could rule out is on

    UserError for a scene without a camera, frames outside its range, or choices that the phone does not have.
    """
    if not settings.profile.effects and settings.link is None:
        return {}
    size = captured_size(scene, settings)
    probes = tuple(Probe(str(k), "", np.array(position)) for k, position in enumerate(positions))
    plan = PrevisPlan(tuple(planned_frames(scene, settings.frames)), size, (), probes)
    with scene_kept():
        survey = yield from survey_path(scene, plan)
        phone = choose_phone(scene, survey, settings)
        facts: dict[int, CaptureFacts] = {}
        if is_captured and phone.sees:
            facts = yield from _facts(scene, plan, phone, settings.capture(size, N_SAMPLES))
        return dict(simulate_phone(phone, facts, exposure=1.0).effects)


def _facts(
    scene: bpy.types.Scene, plan: PrevisPlan, phone: ChosenPhone, render: RenderSettings
) -> Job[dict[int, CaptureFacts]]:
    """A job: the facts of every frame that a run would capture."""
    needs, survey, metering, facts = phone.needs, phone.survey, phone.settings.metering_in_force, {}
    positions_m = np.array([probe.position_m for probe in plan.probes])
    with open_scanner(scene, render) as scanner:
        if needs.surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])
        for done, frame in enumerate(plan.frames):
            yield Progress(done, len(plan.frames), f"looking at frame {frame} as the phone does")
            if frame in needs.captured:
                scanner.move_to(frame)
                captured, rendered = scanner.acquire_environment_scan(), scanner.rendered
                surfaces = surfaces_in(rendered.passes, survey.frames[frame].roughness) if needs.surfaces else None
                radiance = first_layer(rendered)[0] if needs.radiance else None
                facts[frame] = facts_of_capture(captured, positions_m, metering, surfaces, radiance)
    return facts
