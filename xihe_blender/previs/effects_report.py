"""What does `xihe effects` print? The plan as a table, with what each effect costs and what leaving it out changes."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import bpy

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.jobs import Job, Progress
from xihe_blender.light_transport.costs import Change, EffectCost, measure_costs
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.light_transport.plan import Effect, EffectPlan, judge_effects, planned
from xihe_blender.previs.phone_capture import PhoneEffect
from xihe_blender.previs.phone_plan import plan_phone_effects
from xihe_blender.previs.plan import planned_frames
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.estimation_positions import estimation_positions
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.formats import format_setting

REASON_WIDTH = 60
DASH = "-"


@dataclass(frozen=True)
class EffectsReport:
    """The plan of a scene.

    Parameters
    ----------
    plan : the effects of light transport
    costs : by effect, empty where they were not measured or nothing switches the effect
    phone : the effects of the phone and the network; empty for a perfect phone that estimates by itself
    """

    plan: EffectPlan
    costs: Mapping[str, EffectCost]
    phone: tuple[PhoneEffect, ...] = ()

    @property
    def effects(self) -> tuple[Effect | PhoneEffect, ...]:
        """All of them, in the order in which results.json has them."""
        return (*self.plan.effects, *self.phone)

    def as_json(self) -> list[dict[str, Any]]:
        """The rows of results.json, each with `cost`: see `EffectCost.as_json`, or None."""
        costs = {name: cost.as_json() for name, cost in self.costs.items()}
        rows = [*self.plan.as_json(), *map(asdict, self.phone)]
        return [{**row, "cost": costs.get(row["name"])} for row in rows]


def report_effects(
    scene: bpy.types.Scene,
    frames: Sequence[int] | None = None,
    overrides: Mapping[str, str] | None = None,
    *,
    phone: str = "perfect",
    network: str | None = None,
    is_measured: bool = True,
) -> Job[EffectsReport]:
    """The plan of a previs run on all virtual objects of `scene`; one without any, or without a camera, has one too.

    Parameters
    ----------
    frames : to judge; None takes the scene's range and step. Costs are measured at the middle one
    overrides : effect: "auto", "on" or "off"; not remembered
    phone, network : as of PrevisSettings; a run of theirs plans their effects from its captures
    is_measured : render what each effect costs and changes, some 150 small renders, and what the phone would capture

    Raises
    ------
    UserError for frames outside the scene's range, a phone without a camera, or overrides that make no sense
    """
    chosen = planned_frames(scene, frames)
    session = PrevisSettings(frames=tuple(chosen), phone=phone, network=network, effect_choices=dict(overrides or {}))
    wanted = overrides_in_force(scene, overrides or {})
    yield Progress(0, 1, "looking at the scene")
    positions = positions_in(scene, chosen[0])
    verdicts = judge_effects(scene, None, positions, frames=chosen)
    plan = planned(verdicts, wanted)
    of_phone = yield from plan_phone_effects(scene, positions, session, is_captured=is_measured)
    if not is_measured:
        return EffectsReport(plan, {}, of_phone)
    costs = yield from measure_costs(scene, verdicts, wanted, positions, chosen[len(chosen) // 2])
    return EffectsReport(plan, costs, of_phone)


def positions_in(scene: bpy.types.Scene, frame: int) -> list[list[float]]:
    """Where the light of the virtual objects is estimated."""
    with working_scene(scene, "Xihe Effects", RenderSettings((4, 4), samples=1)) as working:
        working.frame_set(frame)
        depsgraph = working.view_layers[0].depsgraph
        return [place.tolist() for item in virtual_objects(scene) for place in estimation_positions(item, depsgraph)]


def format_effects(report: EffectsReport) -> str:
    """A line or more per effect: name, state (with * for a user's override), cost, change, reason, settings.

    Cost is the render time that the effect adds. Light and picture are what leaving it out changes, in mean radiance.
    Each has its standard error.
    """
    header = ("effect", "state", "cost", "light", "picture", "why", "set to")
    rows = [header, *(row for effect in report.effects for row in _rows(effect, report.costs.get(effect.name)))]
    shown = [column for column in range(len(header)) if report.costs or header[column] not in header[2:5]]
    widths = {column: max(len(row[column]) for row in rows) for column in shown}
    lines = ["  ".join(row[column].ljust(widths[column]) for column in shown).rstrip() for row in rows]
    return "\n".join([*lines, *(LEGEND if report.costs else ())])


LEGEND = (
    "",
    "cost: render time that the effect adds. light, picture: what leaving it out does to the mean radiance of the",
    "light probe and of the phone's picture. Each with its standard error; what is within two of them may be chance.",
)


def _rows(effect: Effect | PhoneEffect, cost: EffectCost | None) -> list[tuple[str, ...]]:
    """The reason over as many lines as it takes, all else on the first of them."""
    first, *more = textwrap.wrap(effect.reason, REASON_WIDTH)
    state = effect.state + ("*" if effect.origin == "user" else "")
    settings = ", ".join(f"{name} {format_setting(value)}" for name, value in effect.parameters.items())
    costs = (DASH,) * 3
    if cost is not None:
        time = f"{cost.time_share:+.0%} ± {cost.time_standard_error:.0%}"
        costs = (time, _changed(cost.light), _changed(cost.picture))
    return [(effect.name, state, *costs, first, settings), *(("", "", "", "", "", line, "") for line in more)]


def _changed(change: Change | None) -> str:
    return DASH if change is None else f"{change.relative:+.1%} ± {change.standard_error:.1%}"
