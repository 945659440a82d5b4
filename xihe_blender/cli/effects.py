"""`xihe effects`: which effects the scene requires, and why."""

from __future__ import annotations

import argparse
import json
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import EFFECT, FRAMES, NETWORK, PHONES, SCENE, adder, frame_range, settings_from
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihenet.effects import Change, Effect, EffectCost, effects_as_json
from xihenet.formats import format_setting
from xihenet.phone import PHONE_EFFECTS

REASON_WIDTH = 60
COST_HEADER = f"{'effect':<20}  {'cost':<12}  {'light':<16}  picture"
COST_LEGEND = """
The column "cost" is the render time that the effect adds. The columns "light" and "picture" are how much the mean
radiance of the light probe and of the phone's picture changes when the effect is left out. Each figure has its
standard error after it: a figure within two standard errors of zero may be chance. A dash stands for what was
not measured, or is black."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("scene SCENE.blend", SCENE, Path)
    add("--frames A:B[:S]", FRAMES, frame_range)
    add("--effect NAME=on|off|auto", EFFECT, dest="overrides", action="append", default=[])
    add("--phone NAME|FILE.toml", PHONES, default="perfect")
    add("--network NAME", NETWORK)
    plan_only = "only list the effects; render nothing, so without costs and changes"
    add("--plan-only", plan_only, action="store_true")
    add("--budget SECONDS", "time for measuring costs; default: 60", float, default=60)
    add("--json", "print JSON and nothing else on stdout", action="store_true")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Print the plan, measure if asked to, and print each cost as it is known; or JSON in the end."""
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.required_effects import effects_of_run
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

    def show(text: str) -> None:
        if not options.json:
            print(text, file=stdout, flush=True)

    def show_plan(effects: dict[str, Effect]) -> None:
        header = "" if options.plan_only else f"\n\n{COST_HEADER}"
        show(format_effects(effects) + header)

    if not options.budget > 0:
        raise UserError("--budget: expected a number of seconds above 0")
    settings = settings_from(options, PrevisSettings, effect_choices=parsed_overrides(options.overrides))
    job = effects_of_run(
        open_blend(options.scene),
        settings,
        is_measured=not options.plan_only,
        budget_s=options.budget,
        on_planned=show_plan,
        on_cost=lambda name, cost: show(format_cost(name, cost)),
    )
    effects = run_blocking(job, when_news(progress_line(stderr)))
    if options.json:
        print(json.dumps(effects_as_json(effects, with_cost=True), indent=1), file=stdout)
    elif not options.plan_only:
        measurable = [name for name, effect in effects.items() if effect.is_switchable and name not in PHONE_EFFECTS]
        late = [name for name in measurable if effects[name].cost is None]
        lines = [f"\n{name}: not measured within {options.budget:g} s, give a larger --budget" for name in late]
        show("".join(lines) + COST_LEGEND)


def format_effects(effects: Mapping[str, Effect]) -> str:
    """A line or more per effect: name, state (with * for a user's override), reason, settings."""
    rows = [("effect", "state", "why", "set to"), *(row for effect in effects.values() for row in _rows(effect))]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    padded = ([cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows)
    return "\n".join("  ".join(row).rstrip() for row in padded)


def _rows(effect: Effect) -> list[tuple[str, ...]]:
    """The reason over as many lines as it takes, all else on the first of them."""
    first, *more = textwrap.wrap(effect.reason, REASON_WIDTH)
    state = effect.state + ("*" if effect.origin == "user" else "")
    settings = ", ".join(f"{name} {format_setting(value)}" for name, value in effect.parameters.items())
    return [(effect.name, state, first, settings), *(("", "", line, "") for line in more)]


def format_cost(name: str, cost: EffectCost) -> str:
    """One row under COST_HEADER; COST_LEGEND says what it means."""
    time = f"{cost.time_share:+.0%} ± {cost.time_standard_error:.0%}"
    return f"{name:<20}  {time:<12}  {_format_change(cost.light):<16}  {_format_change(cost.picture)}"


def _format_change(change: Change | None) -> str:
    return "-" if change is None else f"{change.relative:+.1%} ± {change.standard_error:.1%}"
