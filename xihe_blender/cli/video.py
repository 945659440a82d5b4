"""`xihe video`: a run that is done, side by side with its ground truth, to be shown to others."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.cli import arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = arguments.adder(parser)
    add("folder DIR", "folder of a finished run; gets side_by_side.mp4, and a picture of each compared frame", Path)
    add("--method NAME", "what is shown beside the ground truth: ambient, truth or, by default, the run's estimator")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    from xihe_blender.compare.side_by_side import save_side_by_side
    from xihe_blender.io.run_results import read_results

    print(save_side_by_side(read_results(options.folder), options.folder, options.method), file=stdout)
