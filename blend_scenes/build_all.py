"""Build every scene: `python blend_scenes/build_all.py [--out FOLDER] [NAME...]`, beside the scripts by default.

All in one process: each build starts from an empty file, so none sees what another left.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from staging import build_file

SCENES = (
    "living_room",
    "bedroom_night",
    "cornell_box",
    "light_temperature",
    "light_intensity",
    "walk_around",
    "courtyard",
)


def build_all(folder: Path, names: Sequence[str]) -> list[Path]:
    """Write `<name>.blend` for each name into an existing folder; returns the paths."""
    paths = [folder / f"{name}.blend" for name in names]
    for name, path in zip(names, paths, strict=True):
        build_file(import_module(f"build_{name}").build, path)
    return paths


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="Build the scenes.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SCENES)}; all without any")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder for the .blend files")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(SCENES))
    if unknown:
        parser.error(f"no such scene: {', '.join(unknown)}; there are {', '.join(SCENES)}")
    build_all(arguments.out, arguments.names or SCENES)


if __name__ == "__main__":
    main()
