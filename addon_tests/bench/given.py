"""What a benchmark without options is given on its command line; its docstring is what --help says."""

from __future__ import annotations

import argparse
from pathlib import Path


def paths(doc: str | None, metavar: str, n: int | str = "+") -> list[Path]:
    """`n` as argparse has it: how many."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", metavar=metavar, nargs=n, type=Path)
    given: list[Path] = parser.parse_args().paths
    return given
