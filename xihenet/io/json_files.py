"""JSON that anyone may have written, read with one kind of error.

Python's reader raises a RecursionError for brackets within brackets, and gives whole numbers of any length, which
overflow wherever they become floats. Here whatever is wrong is a ValueError, and a whole number that no float can hold
is infinity, as it is when it is written with an exponent; whoever takes a number asks whether it is finite.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

LONGEST_WHOLE_NUMBER = 308  # Characters, sign included. Longer ones are read as floats, perhaps infinite.


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
    except ValueError as error:
        raise ValueError(f"{path}: expected JSON, and could not read it ({error})") from None


def _whole_number(digits: str) -> float:
    return int(digits) if len(digits) <= LONGEST_WHOLE_NUMBER else float(digits)
