"""Effects that a run of this scene would simulate, before there is one, with what each costs; and their table."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import replace

import bpy

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.costs import measure_costs
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.light_transport.plan import required_effects
from xihe_blender.previs.phone_plan import plan_phone_effects
from xihe_blender.previs.plan import planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.effects import Change, Effect, plan_effects
from xihenet.formats import format_setting

REASON_WIDTH = 60
DASH = "-"
LEGEND = (
    "",
    "cost: render time that the effect adds. light, picture: what leaving it out does to the mean radiance of the",
    "light probe and of the phone's picture. Each with its standard error; what is within two of them may be chance.",
)


def effects_of_run(
    scene: bpy.types.Scene, settings: PrevisSettings, *, is_measured: bool = True
) -> Job[dict[str, Effect]]:
    """The effects of a run on all virtual objects of `scene`, in the order in which results.json has them.

    A scene without virtual objects, or without a camera, has them too; a perfect phone that estimates by itself has
    none of its own.

    Parameters
    ----------
    settings : of the run; costs are measured at the middle one of its frames
    is_measured : render what each effect costs and changes, some 150 small renders, and what the phone would capture

    Raises
    ------
    UserError for frames outside the scene's range, a phone without a camera, or choices that make no sense
    """
    frames = planned_frames(scene, settings.frames)
    choices = overrides_in_force(scene, settings.effect_choices)
    yield Progress(0, 1, "looking at the scene")
    positions = positions_in(scene, frames[0])
    required = required_effects(scene, None, positions, frames=frames)
    of_phone = yield from plan_phone_effects(scene, positions, settings, is_captured=is_measured)
    effects = plan_effects(required, choices) | of_phone
    if not is_measured:
        return effects
    costs = yield from measure_costs(scene, required, choices, positions, frames[len(frames) // 2])
    return {name: replace(effect, cost=costs.get(name)) for name, effect in effects.items()}


def positions_in(scene: bpy.types.Scene, frame: int) -> list[list[float]]:
    """Where the light of the virtual objects is estimated."""
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        working.frame_set(frame)
        depsgraph = working.view_layers[0].depsgraph
        return [place.tolist() for item in virtual_objects(scene) for place in estimation_positions(item, depsgraph)]


def format_effects(effects: Mapping[str, Effect]) -> str:
    """A line or more per effect: name, state (with * for a user's override), cost, change, reason, settings.

    Cost is the render time that the effect adds. Light and picture are what leaving it out changes, in mean radiance.
    Each has its standard error; a table in which nothing was measured is without them.
    """
    is_measured = any(effect.cost for effect in effects.values())
    header = ("effect", "state", "cost", "light", "picture", "why", "set to")
    rows = [header, *(row for effect in effects.values() for row in _rows(effect))]
    shown = [column for column in range(len(header)) if is_measured or header[column] not in header[2:5]]
    widths = {column: max(len(row[column]) for row in rows) for column in shown}
    lines = ["  ".join(row[column].ljust(widths[column]) for column in shown).rstrip() for row in rows]
    return "\n".join([*lines, *(LEGEND if is_measured else ())])


def _rows(effect: Effect) -> list[tuple[str, ...]]:
    """The reason over as many lines as it takes, all else on the first of them."""
    first, *more = textwrap.wrap(effect.reason, REASON_WIDTH)
    state = effect.state + ("*" if effect.origin == "user" else "")
    settings = ", ".join(f"{name} {format_setting(value)}" for name, value in effect.parameters.items())
    costs, cost = (DASH,) * 3, effect.cost
    if cost is not None:
        time = f"{cost.time_share:+.0%} ± {cost.time_standard_error:.0%}"
        costs = (time, _format_change(cost.light), _format_change(cost.picture))
    return [(effect.name, state, *costs, first, settings), *(("", "", "", "", "", line, "") for line in more)]


def _format_change(change: Change | None) -> str:
    return DASH if change is None else f"{change.relative:+.1%} ± {change.standard_error:.1%}"
