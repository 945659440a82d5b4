"""`xihe budget`: what an object's error comes from, and what would help most."""

from __future__ import annotations

import argparse
from typing import Any

from xihe_blender.cli import arguments
from xihe_blender.cli.progress import progress_line
from xihe_blender.jobs import run_blocking

MOMENTS = "frames in which errors are measured, evenly over those with the object in view; default: 4"
SEEDS = "how often all is rendered and measured, each time with another seed, which tells what is certain; default: 3"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    arguments.add_scene(add, "folder of the budget; what is rendered is kept in it and resumed")
    arguments.add_capture(add)
    add("--objects A,B", arguments.OBJECTS, arguments.names)
    add("--moments N", MOMENTS, int, dest="n_moments", default=4)
    add("--seeds N", SEEDS, int, dest="n_seeds", default=3)
    add("--samples N", "samples of every capture, and pictures of every light probe, whatever the noise", int)
    add("--metering NAME", "highlights, as phones do, or key; default: the phone's own")
    add("--network NAME", arguments.NETWORK)
    add("--effect NAME=on|off|auto", arguments.EFFECT, dest="overrides", action="append", default=[])


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.light_transport.overrides import parsed_overrides
    from xihe_blender.previs.error_budget import error_budget
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.blend_file import open_blend

    settings = arguments.settings_from(options, PrevisSettings, effect_choices=parsed_overrides(options.overrides))
    job = error_budget(
        open_blend(options.scene), options.out, settings, n_moments=options.n_moments, n_seeds=options.n_seeds,
        blend_file=options.scene, command=options.command_line,
    )  # fmt: skip
    results = run_blocking(job, progress_line(stderr))
    for item in results.objects:
        print(item.advice, file=stdout)
    print(options.out / "report.html", file=stdout)
