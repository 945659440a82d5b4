"""`xihe effects`: which effects the scene requires, and why."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import frame_range
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.cli.shared_options import NETWORK, OVERRIDE, PHONE
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed."""
    parser.add_argument("scene", type=Path, metavar="SCENE.blend", help="scene with an animated camera")
    parser.add_argument(
        "--frames", type=frame_range, metavar="A:B[:S]", help="frames of the path; default: the scene's range and step"
    )
    parser.add_argument("--effect", **OVERRIDE)
    parser.add_argument("--phone", **PHONE)
    parser.add_argument("--network", **NETWORK)
    parser.add_argument(
        "--plan-only", action="store_true", help="only list the effects; render nothing, so without costs and changes"
    )
    parser.add_argument(
        "--budget", type=float, default=60, metavar="SECONDS", help="time for measuring costs; default: 60"
    )
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else on stdout")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Print the plan, measure if asked to, and print each cost as it is known; or JSON in the end."""
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.required_effects import (
        COST_HEADER,
        COST_LEGEND,
        effects_of_run,
        format_cost,
        format_effects,
    )
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend
    from xihenet.effects import Effect, effects_as_json

    def show(text: str) -> None:
        if not options.json:
            print(text, file=stdout, flush=True)

    def show_plan(effects: dict[str, Effect]) -> None:
        show(format_effects(effects) + ("" if options.plan_only else f"\n\n{COST_HEADER}"))

    if not options.budget > 0:
        raise UserError("--budget: expected a number of seconds above 0")
    settings = PrevisSettings(
        frames=options.frames,
        phone=options.phone,
        network=options.network,
        effect_choices=parsed_overrides(options.overrides),
    )
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
        late = [name for name, effect in effects.items() if effect.cost is None and effect.is_switchable]
        show(
            "".join(f"\n{name}: not measured within the budget of {options.budget:g} s" for name in late) + COST_LEGEND
        )
