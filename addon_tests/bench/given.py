"""The command line of a benchmark, whose docstring, which --help shows, says what the words mean."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def given(doc: str | None, *paths: str, **options: Any) -> argparse.Namespace:
    """`paths` name files or folders, in order; one that ends in "+" or "*" stands for several.

    `options` have their defaults, whose type reads what is given. False makes a switch, (reader, default) names another
    reader, and a reader alone makes an option that must be given.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in paths:
        parser.add_argument(name.rstrip("+*"), nargs=name[-1] if name[-1] in "+*" else None, type=Path)
    for name, value in options.items():
        if value is False:
            parser.add_argument(f"--{name}", action="store_true")
        elif callable(value):
            parser.add_argument(f"--{name}", type=value, required=True)
        else:
            reader, default = value if isinstance(value, tuple) else (type(value), value)
            parser.add_argument(f"--{name}", type=reader, default=default)
    return parser.parse_args()


def words(text: str) -> list[str]:
    """The words of "A,B"."""
    return text.split(",")
