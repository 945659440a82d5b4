"""All hard cases, in the order of the chain."""

from __future__ import annotations

from addon_tests.pure.hard_cases import (
    colour,
    compare,
    encode,
    encode_random,
    estimate,
    estimate_kept,
    harmonics,
    harmonics_in_use,
    least_squares,
    merge,
    sample,
    sample_points,
    trigger,
    trigger_input,
    unproject,
)
from addon_tests.pure.hard_cases.hard_case import HardCase

_BY_CHAIN = (
    *(unproject, colour, sample, sample_points, merge, trigger, trigger_input, encode, encode_random),
    *(harmonics, harmonics_in_use, least_squares, estimate, estimate_kept, compare),
)
CASES: list[HardCase] = [case for file in _BY_CHAIN for case in file.CASES]
