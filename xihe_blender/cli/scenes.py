"""`xihe scenes build`: the example scenes, from their scripts."""

from __future__ import annotations

import argparse
import runpy
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("build",), help="build the .blend files from their scripts")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    script = Path(__file__).resolve().parents[2] / "blend_scenes" / "build_all.py"
    if not script.exists():
        raise UserError(f"{script} is not there: build the scenes from a checkout of the project")
    runpy.run_path(str(script), run_name="__main__")
