"""The size of a picture from anywhere: what is refused before a pixel is unpacked, and what is taken of the rest.

A file of a megabyte may hold a picture of gigabytes, so the size in its header is judged first. A large frame is
thinned: 2 megapixels are 1600 points to each of 1280 anchors, and every point costs 180 bytes on its way through the
chain. Rejected: averaging plane depth, which invents surfaces between near and far ones.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from xihenet.records import ArrayInt

MOST_PIXELS = 50_000_000  # Of a picture that is read: the 48 megapixels that phones store are below it
LONGEST_SIDE = 65_535
MOST_POINTS = 2**21  # Pixels of a frame: full HD stays whole, anything larger is thinned to so many
SAME_ASPECT = 0.01  # Ratios of width to height that differ by less show one field: rounding moves 256x144 by 0.4 %


class TooLarge(ValueError):
    """More pixels than are read."""


def check_size(path: Path, height: int, width: int) -> None:
    """TooLarge, with the file and the limit, for a picture that is not to be unpacked."""
    if height * width > MOST_PIXELS or max(height, width) > LONGEST_SIDE:
        raise TooLarge(
            f"{path}: {width}x{height} pixels are too many: save it smaller, with at most "
            f"{MOST_PIXELS // 10**6} megapixels and {LONGEST_SIDE} pixels along a side"
        )


def picked_pixels(height: int, width: int, most: int | None) -> tuple[ArrayInt, ArrayInt]:
    """Rows and columns, evenly spaced, whose crossings are at most about `most` pixels; all of them for None."""
    share = 1.0 if most is None else min(1.0, math.sqrt(most / (height * width)))
    rows, columns = (_evenly_spaced(n, max(1, int(n * share))) for n in (height, width))
    return rows, columns


def _evenly_spaced(n: int, n_picked: int) -> ArrayInt:
    """The pixel below the middle of each of `n_picked` equal parts of a side of `n`."""
    return ((np.arange(n_picked) + 0.5) * n / n_picked).astype(np.intp)


def same_field(width: int, height: int, other_width: int, other_height: int) -> bool:
    """Whether images of two sizes can show the same field of view."""
    return abs(width * other_height / (height * other_width) - 1) < SAME_ASPECT
