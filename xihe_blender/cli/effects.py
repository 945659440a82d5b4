"""`xihe effects`: what the scene calls for, and why."""

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
    parser.add_argument("scene", type=Path, metavar="SCENE.blend")
    parser.add_argument("--frames", type=frame_range, metavar="A:B[:S]", help="default: the scene's range and step")
    parser.add_argument("--effect", **OVERRIDE)
    parser.add_argument("--phone", **PHONE)
    parser.add_argument("--network", **NETWORK)
    parser.add_argument("--plan-only", action="store_true", help="render nothing: no costs, no changes, no captures")
    parser.add_argument("--json", action="store_true", help="JSON on stdout, and nothing else")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Plan, measure if asked to, and print a table or JSON."""
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.effects_report import format_effects, report_effects
    from xihe_blender.scene.blend_file import open_blend

    overrides = parsed_overrides(options.overrides)
    scene = open_blend(options.scene)
    session = {"phone": options.phone, "network": options.network}
    job = report_effects(scene, options.frames, overrides, **session, is_measured=not options.plan_only)
    report = run_blocking(job, when_news(progress_line(stderr)))
    print(json.dumps(report.as_json(), indent=1) if options.json else format_effects(report), file=stdout)
