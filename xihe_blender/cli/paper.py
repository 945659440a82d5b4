"""`xihe paper`: what it takes and prints."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli.arguments import adder, files
from xihe_blender.cli.progress import EXIT_IN_PART, progress_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    quick = "few frames of each room: 20 minutes instead of 8 hours, on two cores"
    add("--out DIR", "folder of the results; a stopped run in it is resumed", Path, required=True)
    add("--quick", quick, action="store_true")
    add("--only NAME", "one study; may be repeated; default: all", action="append", default=[])
    add("--scenes SCENE.blend", "your own rooms instead of ours, with animated cameras", Path, nargs="+", default=[])
    add("--seed N", "the same seed gives the same numbers, times aside", int, default=0)
    add("--document FILE.md", "write the page of the documentation as well", Path)


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> int:
    """Do it; 1 where a study could not be measured."""
    from xihe_blender.jobs import run_blocking
    from xihe_blender.lab.paper.run import PaperSettings, evaluate_paper

    settings = PaperSettings(
        options.quick, tuple(options.only), tuple(files(options.scenes)), options.seed, options.document
    )
    results = run_blocking(evaluate_paper(options.out, settings, options.command_line), progress_line(stderr))
    for one in results:
        print(f"{one.name}: {one.failed_because or f'{len(one.rows)} figures'}", file=stdout)
    print(options.out / "report.html", file=stdout)
    return EXIT_IN_PART if any(one.failed_because for one in results) else 0
