"""`xihe package`: the Blender extension as a zip, from a checkout; needs no Blender."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError
from xihe_blender.packaging.extension import build_extension
from xihenet.formats import format_bytes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for xihe-<version>.zip")


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    if options.out.exists() and not options.out.is_dir():
        raise UserError(f"{options.out} is a file: give a folder with --out")
    path = build_extension(options.out)
    print(f"{path} ({format_bytes(path.stat().st_size)})", file=stdout)
