"""Hard cases of sampling: directions without an angle, distances without a square, clouds of none and of millions."""

import numpy as np
import pytest

from addon_tests.hard_case import at_most, equal, refused, row
from addon_tests.pure.sh_samples import random_directions
from xihenet.sphere import AnchorLattice

STAGE = "sample"


def lost(directions: np.ndarray, anchors: np.ndarray, lattice: AnchorLattice) -> float:
    """The largest cosine that a choice of anchors falls below the best one, all in float64."""
    units = directions.astype(float) / np.linalg.norm(directions.astype(float), axis=1, keepdims=True)
    chosen = np.einsum("pi,pi->p", units, lattice.directions[anchors])
    best = np.array([(lattice.directions @ unit).max() for unit in units])
    return float((best - chosen).max())


def lost_exactly(given: tuple[int, np.ndarray]) -> float:
    n, directions = given
    return max(0.0, lost(directions, AnchorLattice(n).nearest(directions), AnchorLattice(n)))


def lost_by_the_table(given: tuple[int, np.ndarray]) -> float:
    """Naive: the paper's grid, which answers for the centres of its cells."""
    n, directions = given
    return lost(directions, AnchorLattice(n).nearest(directions, "table", (64, 32)), AnchorLattice(n))


DIRECTIONS = random_directions(200)
CASES = [
    *(
        row(
            f"each of 65,535 anchors is found in {d.dtype}", (65_535, d), lost_exactly, at_most(1e-7), lost_by_the_table
        )
        for d in (DIRECTIONS, DIRECTIONS.astype(np.float32))
    ),
    row(
        "directions of any length find the same anchor",
        random_directions(50),
        lambda units: max(
            int((AnchorLattice(512).nearest(units * length) != AnchorLattice(512).nearest(units)).sum())
            for length in (1e-300, 1e-30, 1e30, 1e300)
        ),
        equal(0),
    ),
    row("65537 anchors are refused since an index has 16 bits", 65_537, AnchorLattice, refused("expected 1 to 65536")),
    row("no anchor is refused", 0, AnchorLattice, refused("expected 1 to 65536")),
]


@pytest.mark.parametrize("given, ask, must, naive", CASES)
def test_hard_case(given, ask, must, naive, comes_out):
    assert comes_out(given, ask, must, naive)
