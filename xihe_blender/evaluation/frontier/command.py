"""What does `xihe frontier` take and print?"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_frontier(commands: Any) -> None:
    """The sub-command, on the parser of `xihe`."""
    frontier = commands.add_parser("frontier", help="what accuracy costs in time, by every choice that trades them")
    add = frontier.add_argument
    add("scenes", type=Path, nargs="+", metavar="SCENE.blend")
    add("--out", type=Path, required=True, metavar="DIR", help="folder of the results; resumed if it exists")
    add("--quick", action="store_true", help="fewer choices, one frame: some 2 minutes a scene instead of 15")
    add("--seed", type=int, default=0)
    frontier.set_defaults(run=run_frontier)


def run_frontier(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """Measure, and print what the presets cost and where the report is."""
    from xihe_blender.cli import progress_line
    from xihe_blender.evaluation.frontier.study import FrontierSettings, frontier
    from xihe_blender.jobs import run_blocking

    settings = FrontierSettings(options.quick, options.seed)
    job = frontier(options.scenes, options.out, settings, options.command_line)
    content = run_blocking(job, progress_line(stderr))
    for answer in content["answers"]:
        print(f"{answer['scene']}: {answer['question']} {answer['answer']}", file=stdout)
    print(options.out / "report.html", file=stdout)
