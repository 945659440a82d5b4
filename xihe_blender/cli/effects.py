"""`xihe effects`: which effects the scene requires, and why."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import frame_range
from xihe_blender.cli.progress import progress_line, when_news
from xihe_blender.cli.shared_options import NETWORK, OVERRIDE, PHONE
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
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else on stdout")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Plan, measure if asked to, and print a table or JSON."""
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.required_effects import effects_of_run, format_effects
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend
    from xihenet.effects import effects_as_json

    settings = PrevisSettings(
        frames=options.frames,
        phone=options.phone,
        network=options.network,
        effect_choices=parsed_overrides(options.overrides),
    )
    job = effects_of_run(open_blend(options.scene), settings, is_measured=not options.plan_only)
    effects = run_blocking(job, when_news(progress_line(stderr)))
    rows = effects_as_json(effects, with_cost=True)
    print(json.dumps(rows, indent=1) if options.json else format_effects(effects), file=stdout)
