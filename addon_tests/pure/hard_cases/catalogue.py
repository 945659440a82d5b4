"""All hard cases, in the order of the chain."""

from __future__ import annotations

from addon_tests.pure.hard_cases import (
    colour,
    compare,
    encode,
    estimate,
    harmonics,
    least_squares,
    merge,
    sample,
    trigger,
    unproject,
)
from addon_tests.pure.hard_cases.hard_case import HardCase

_FILES = (unproject, colour, sample, merge, trigger, encode, harmonics, least_squares, estimate, compare)
CASES: list[HardCase] = [case for file in _FILES for case in file.CASES]
