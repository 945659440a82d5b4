"""`xihe package`: the Blender extension as a zip, from a checkout; needs no Blender."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from xihe_blender.errors import UserError
from xihe_blender.packaging.extension import build_extension, default_wheels_folder
from xihenet.formats import format_bytes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What can be typed."""
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="DIR", help="folder for xihe-<version>.zip")
    add(
        "--wheels",
        type=Path,
        metavar="DIR",
        help="folder of wheels made by others; missing ones are downloaded; default: a cache",
    )


def run(options: argparse.Namespace, stdout: Any, stderr: Any) -> None:
    """The command: options in, the zip's path and size out."""
    wheels = options.wheels or default_wheels_folder()
    for folder, option in ((options.out, "--out"), (wheels, "--wheels")):
        if folder.exists() and not folder.is_dir():
            raise UserError(f"{folder} is a file: give a folder with {option}")
    path = build_extension(options.out, wheels)
    print(f"{path} ({format_bytes(path.stat().st_size)})", file=stdout)
