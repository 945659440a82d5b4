"""Invariance: how much does a room's light change where the room is moved, turned, or scaled? A table of the docs.

Run it as `python addon_tests/bench/invariance.py` for docs/error_bounds.md; exit 1 if a bound does not hold. Figures
are the largest found of the norm of the difference of nine coefficients over their own norm, the light turned back. The
bounds are those of addon_tests/in_blender/test_invariance.py.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

if __name__ == "__main__":
    ROOT = Path(__file__).resolve().parents[2]
    sys.path[:0] = [str(ROOT), str(ROOT / "addon_tests" / "in_blender")]

from moved_rooms import (
    ALL_THREE,
    ESTIMATORS,
    IN_METRES,
    NOISE,
    NOT_TURNED,
    TOLERANCE,
    Placing,
    SeenLight,
    apart,
    see,
    turned_by_hand,
)

from xihe_blender.io.blender_output import only_our_output

SEEDS, YAWS, YAWS_BY_HAND = range(1, 7), np.linspace(7.7, 340, 8), np.linspace(1, 359, 40)
Row = tuple[str, str, float, float]
"""Light, what was changed, the largest difference found, its bound."""


def rows() -> Iterator[Row]:
    known = see()
    yield from compared("another seed of Cycles", (see(seed=seed) for seed in SEEDS), known, NOISE)
    for placing in NOT_TURNED:
        yield from compared(placing.name, [see(placing)], known, NOISE)
    for name in ESTIMATORS:
        by_hand = max(apart(turned_by_hand(known, yaw, name), known.lights[name]) for yaw in YAWS_BY_HAND)
        yield name, f"poses alone turned, {len(YAWS_BY_HAND)} yaws: only the anchors differ", by_hand, TOLERANCE[name]
    turned = [Placing(yaw_deg=yaw) for yaw in YAWS]
    yield from compared(f"room turned, {len(YAWS)} yaws", map(see, turned), known, TOLERANCE)
    yield from compared("moved, turned and scaled, with its unit", map(see, ALL_THREE), known, TOLERANCE)
    # A learned estimator takes a hall of 4 km for one.
    in_metres = TOLERANCE | {"lattice": np.inf}
    yield from compared("really 1000 times as large", map(see, IN_METRES), known, in_metres)


def compared(what: str, seen: Iterable[SeenLight], known: SeenLight, bounds: dict[str, float]) -> Iterator[Row]:
    """The largest difference of each kind of light over all that was seen."""
    errors = [one.apart_from(known) for one in seen]
    for name, bound in bounds.items():
        yield name, what, max(error[name] for error in errors), bound


def main() -> int:
    print("| light | what was changed | largest found | bound |")
    print("| --- | --- | --- | --- |")
    n_broken = 0
    for name, what, error, bound in rows():
        holds = error <= bound
        said = f"{bound:.2g}" if np.isfinite(bound) else "none"
        print(f"| {name} | {what} | {error:.2g} | {said} |" + ("" if holds else " DOES NOT HOLD"), flush=True)
        n_broken += not holds
    return min(n_broken, 1)


if __name__ == "__main__":
    with only_our_output():
        sys.exit(main())
