"""What does one typed argument of `xihe` mean? Text turned into frames, sizes, names and numbers.

For argparse, whose one line to the user is that of the ArgumentTypeError.
"""

from __future__ import annotations

import argparse
import re

MAX_FRAME = 1048574


def frame_range(text: str) -> tuple[int, ...]:
    """Frames of "A:B" or "A:B:S", both ends included, or of "A" alone."""
    match = re.fullmatch(r"(-?\d+)(?::(-?\d+)(?::(\d+))?)?", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a range of frames: give A:B or A:B:S, such as 1:24:2")
    first, last, step = (None if part is None else int(part) for part in match.groups())
    assert first is not None
    if step == 0:
        raise argparse.ArgumentTypeError(f"{text!r} has a step of 0: give 1 or more")
    if max(abs(first), abs(last or 0)) > MAX_FRAME:
        raise argparse.ArgumentTypeError(f"{text!r} goes beyond Blender's last frame, {MAX_FRAME}")
    return tuple(range(first, (first if last is None else last) + 1, step or 1))


def picture_size(text: str) -> tuple[int, int]:
    """(width, height) of "WxH"."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture size: give WxH, such as 256x192")
    return int(match[1]), int(match[2])


def names(text: str) -> tuple[str, ...]:
    """Those of "A,B"; spaces around them and empty ones do not count."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def whole_numbers(text: str) -> tuple[int, ...]:
    """Those of "N,M"."""
    try:
        return tuple(int(number) for number in names(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: give whole numbers with commas between them") from error
