"""`xihe effects`: which effects the scene requires, and why."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import EFFECT, FRAMES, NETWORK, PHONES, SCENE, adder, frame_range, settings_from
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking


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
    from xihe_blender.previs import required_effects
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend
    from xihenet.effects import Effect, effects_as_json

    def show(text: str) -> None:
        if not options.json:
            print(text, file=stdout, flush=True)

    def show_plan(effects: dict[str, Effect]) -> None:
        header = "" if options.plan_only else f"\n\n{required_effects.COST_HEADER}"
        show(required_effects.format_effects(effects) + header)

    if not options.budget > 0:
        raise UserError("--budget: expected a number of seconds above 0")
    settings = settings_from(options, PrevisSettings, effect_choices=parsed_overrides(options.overrides))
    job = required_effects.effects_of_run(
        open_blend(options.scene),
        settings,
        is_measured=not options.plan_only,
        budget_s=options.budget,
        on_planned=show_plan,
        on_cost=lambda name, cost: show(required_effects.format_cost(name, cost)),
    )
    effects = run_blocking(job, when_news(progress_line(stderr)))
    if options.json:
        print(json.dumps(effects_as_json(effects, with_cost=True), indent=1), file=stdout)
    elif not options.plan_only:
        late = [name for name, effect in effects.items() if effect.cost is None and effect.is_switchable]
        lines = [f"\n{name}: not measured within the budget of {options.budget:g} s" for name in late]
        show("".join(lines) + required_effects.COST_LEGEND)
