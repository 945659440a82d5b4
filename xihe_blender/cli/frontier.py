"""`xihe frontier`: what it takes and prints."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import adder, files
from xihe_blender.cli.progress import progress_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    quick = "fewer settings, one frame: 2 minutes instead of 15 in a room of little noise, longer in others"
    add("scenes SCENE.blend", "scenes with animated cameras", Path, nargs="+")
    add("--out DIR", "folder of the results; a stopped run in it is resumed", Path, required=True)
    add("--quick", quick, action="store_true")
    add("--seed N", "the same seed gives the same numbers", int, default=0)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.jobs import run_blocking
    from xihe_blender.lab.frontier.records import FrontierSettings
    from xihe_blender.lab.frontier.study import frontier

    settings = FrontierSettings(options.quick, options.seed)
    job = frontier(files(options.scenes), options.out, settings, options.command_line)
    for answer in run_blocking(job, progress_line(stderr)).answers:
        print(f"{answer.scene}: {answer.question} {answer.answer}", file=stdout)
    print(options.out / "report.html", file=stdout)
