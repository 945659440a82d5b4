"""JSON that anyone may have written, read with one kind of error.

Python's reader raises a RecursionError for brackets within brackets, and gives whole numbers of any length, which
overflow wherever they become floats. Here whatever is wrong is a ValueError, and a whole number that no float can hold
is infinity, as it is when it is written with an exponent; `number_in` asks whether a number is finite.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

LONGEST_WHOLE_NUMBER = 308  # Characters, sign included. Longer ones are read as floats, perhaps infinite.
LARGEST_SIDE = 1_000_000  # Pixels. No file has more, and products of two stay numbers that a float can hold.


def parse_json(text: str) -> Any:
    """What `text` says. ValueError if it is no JSON, or is nested deeper than Python can follow."""
    try:
        return json.loads(text, parse_int=_whole_number)
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None


def read_json(path: Path) -> Any:
    """What the file says. OSError if it cannot be read, ValueError that names it if it is no JSON."""
    try:
        return parse_json(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError:
        raise ValueError(f"{path}: expected JSON in UTF-8, which this is not: save it in that encoding") from None
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON, and could not read it ({error})") from None


@contextmanager
def named(source: object) -> Iterator[None]:
    """A ValueError of the block begins with the file, or the part of one, that it is about."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def number_in(values: Mapping[str, Any], name: str, default: float | None = None) -> float:
    """The finite number of that name. ValueError for anything else, and for none without a `default`."""
    if name not in values and default is None:
        raise ValueError(f"{name} is missing")
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name}: expected a number, got {value!r:.80}")
    return float(value)


def side_in(values: Mapping[str, Any], name: str) -> int:
    """A whole number of pixels, at least 1. ValueError else."""
    value = number_in(values, name)
    if not (value.is_integer() and 1 <= value <= LARGEST_SIDE):
        raise ValueError(f"{name}: expected a whole number of pixels, got {value:g}")
    return int(value)


def _whole_number(digits: str) -> float:
    return int(digits) if len(digits) <= LONGEST_WHOLE_NUMBER else float(digits)
