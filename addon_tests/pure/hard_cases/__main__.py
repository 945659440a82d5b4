"""The table of the hard cases: `python -m addon_tests.pure.hard_cases [STAGE...]`. Exit 1 if one is not right."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Sequence
from typing import TextIO

from addon_tests.pure.hard_cases.catalogue import CASES
from addon_tests.pure.hard_cases.hard_case import HardCase, tried

WIDTHS = (14, 66, 40, 44, 3)
HEAD = ("stage", "case", "what must come out", "what came", "ok")


def main(stages: list[str]) -> int:
    """Print the cases of `stages`, of all where none is named; how many are wrong."""
    return print_cases([case for case in CASES if not stages or case.stage in stages])


def print_cases(cases: Sequence[HardCase], out: TextIO | None = None) -> int:
    """Print a table of `cases` and what comes of them to `out`, or stdout; how many are wrong."""
    print_row(HEAD, out)
    print_row(["-" * width for width in WIDTHS], out)
    n_wrong = 0
    for case in cases:
        outcome = tried(case, case.ask)
        is_ok = "yes" if outcome.is_ok else "NO"
        print_row((case.stage, case.name, case.must.says, outcome.came, is_ok), out)
        n_wrong += not outcome.is_ok
    print(f"\n{len(cases)} cases, {n_wrong} wrong", file=out)
    return n_wrong


def print_row(cells: Sequence[str], out: TextIO | None = None) -> None:
    """Cells that are too long are shortened, so that a row is a line."""
    fitted = (textwrap.shorten(cell, width, placeholder="...") for cell, width in zip(cells, WIDTHS, strict=True))
    print(
        " | ".join(cell.ljust(width) for cell, width in zip(fitted, WIDTHS, strict=True)).rstrip(), file=out, flush=True
    )


if __name__ == "__main__":
    sys.exit(min(main(sys.argv[1:]), 1))
