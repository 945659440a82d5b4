"""The table of the hard cases: `python -m addon_tests.pure.hard_cases [STAGE...]`. Exit 1 if one is not right."""

from __future__ import annotations

import sys
import textwrap

from addon_tests.pure.hard_cases.catalogue import CASES
from addon_tests.pure.hard_cases.hard_case import tried

WIDTHS = (14, 66, 40, 44, 3)
HEAD = ("stage", "case", "what must come out", "what came", "ok")


def main(stages: list[str]) -> int:
    """Print the cases of `stages`, of all where none is named; how many are wrong."""
    print_row(*HEAD)
    print_row(*("-" * width for width in WIDTHS))
    n_wrong = n_cases = 0
    for case in CASES:
        if not stages or case.stage in stages:
            outcome = tried(case, case.ask)
            print_row(case.stage, case.name, case.must.says, outcome.came, "yes" if outcome.is_ok else "NO")
            n_cases, n_wrong = n_cases + 1, n_wrong + (not outcome.is_ok)
    print(f"\n{n_cases} cases, {n_wrong} wrong")
    return n_wrong


def print_row(*cells: str) -> None:
    """Cells that are too long are shortened, so that a row is a line."""
    fitted = (textwrap.shorten(cell, width, placeholder="...") for cell, width in zip(cells, WIDTHS, strict=True))
    print(" | ".join(cell.ljust(width) for cell, width in zip(fitted, WIDTHS, strict=True)).rstrip())


if __name__ == "__main__":
    sys.exit(min(main(sys.argv[1:]), 1))
