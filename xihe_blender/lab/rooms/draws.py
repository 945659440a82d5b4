"""Draws of numbers and of things from a generator. Their order makes the same seed give the same room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from xihe_blender.lab.rooms.outline import Point, Rect

Rng = np.random.Generator
One = TypeVar("One")


def span(rng: Rng, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def log_span(rng: Rng, low: float, high: float) -> float:
    """As often between 1 and 2 as between 2 and 4."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def one_of(rng: Rng, options: Sequence[One]) -> One:
    return options[int(rng.integers(len(options)))]


def draw_point(rng: Rng, area: Rect) -> Point:
    return span(rng, area.x0, area.x1), span(rng, area.y0, area.y1)


def piece_seed(rng: Rng) -> int:
    """A seed for what is drawn when the piece is built."""
    return int(rng.integers(2**31))
