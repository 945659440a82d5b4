"""The size of a picture from anywhere: what is refused before a pixel is unpacked, and what is taken of the rest.

A file of a megabyte may hold a picture of gigabytes, so the size in its header is judged first. A large frame is
thinned: 1280 anchors see no difference beyond some two points to each pixel of a phone's screen, and every point costs
180 bytes on its way through the chain. Rejected: averaging plane depth, which invents surfaces between near and far.
"""

from __future__ import annotations

import math

import numpy as np

from xihenet.records import ArrayInt

MOST_PIXELS = 50_000_000
"""Of a picture that is read; the largest single sensors of phones, but for those that bin pixels, stay below."""

LONGEST_SIDE = 65_535
MOST_POINTS = 2**21
"""Pixels of a frame: full HD stays whole, anything larger is thinned to so many."""


class TooLarge(ValueError):
    """More pixels than are read."""


def check_size(height: int, width: int) -> None:
    """TooLarge, with the limit, for a picture that is not to be unpacked."""
    if height * width > MOST_PIXELS or max(height, width) > LONGEST_SIDE:
        raise TooLarge(
            f"{width}x{height} pixels are too many: save it smaller, with at most "
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
