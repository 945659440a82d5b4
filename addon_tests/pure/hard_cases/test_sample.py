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


def lost_by_angles(given: tuple[int, np.ndarray]) -> float:
    """Naive: nearest in azimuth and polar angle, as if the sphere were a map."""
    n, directions = given
    polar, azimuth = np.arccos(1 - 2 * np.arange(n) / (n - 1)), np.arange(n) * np.pi * (3 - np.sqrt(5)) % (2 * np.pi)
    theta = np.arccos(directions[:, 2] / np.linalg.norm(directions, axis=1))
    phi = np.arctan2(directions[:, 1], directions[:, 0]) % (2 * np.pi)
    anchors = [int(np.argmin((polar - t) ** 2 + (azimuth - p) ** 2)) for t, p in zip(theta, phi, strict=True)]
    return lost(directions, np.array(anchors), AnchorLattice(n))


def lost_by_the_table(given: tuple[int, np.ndarray]) -> float:
    """Naive: the paper's grid, which answers for the centres of its cells."""
    n, directions = given
    return lost(directions, AnchorLattice(n).nearest(directions, "table", (64, 32)), AnchorLattice(n))


def rings(polar: float) -> np.ndarray:
    """Around both poles, at this angle from them."""
    azimuth = np.linspace(-np.pi, np.pi, 41)
    ring = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.full(41, np.cos(polar))], 1)
    return np.concatenate([ring, ring * [1, 1, -1]])


def seam(n: int = 200) -> np.ndarray:
    """Azimuth pi from both sides, at all heights."""
    z = np.linspace(-0.99, 0.99, n)
    return np.stack([-np.sqrt(1 - z * z), np.where(np.arange(n) % 2, 1e-12, -1e-12), z], axis=1)


def cell_borders() -> np.ndarray:
    """Where four cells of the paper's grid meet."""
    azimuth, polar = np.meshgrid(np.arange(0, 65, 4) * 2 * np.pi / 64 - np.pi, np.arange(1, 32, 2) * np.pi / 32)
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1).reshape(
        -1, 3
    )


def between_anchors(n: int = 1280) -> np.ndarray:
    """Half-way between each 4th anchor and its neighbour, where float32 cannot tell the two apart."""
    lattice = AnchorLattice(n)
    return (lattice.directions[::4] + lattice.directions[lattice.neighbours(2)[::4, 1]]) / 2


BEST = at_most(1e-7)
DIRECTIONS = {
    "both poles": (1280, np.array([[0, 0, 1.0], [0, 0, -1.0], [0.0, -0.0, 7.0]]), lost_by_angles),
    "rings a thousandth of a radian around the poles": (1280, rings(1e-3), lost_by_angles),
    "rings a tenth of a radian around the poles": (1280, rings(0.1), lost_by_angles),
    "azimuth pi from both sides": (1280, seam(), lost_by_angles),
    "the corners of the paper's cells": (1280, cell_borders(), lost_by_the_table),
    "half-way between two anchors": (1280, between_anchors(), lost_by_the_table),
    "half-way between two anchors, in float32": (1280, between_anchors().astype(np.float32), lost_by_the_table),
    "2 anchors": (2, random_directions(400), lost_by_angles),
    "3 anchors": (3, random_directions(400), lost_by_angles),
    "512 anchors": (512, random_directions(400), lost_by_the_table),
    "512 anchors, in float32": (512, random_directions(400).astype(np.float32), lost_by_the_table),
    "65,535 anchors": (65_535, random_directions(200), lost_by_the_table),
    "65,535 anchors, in float32": (65_535, random_directions(200).astype(np.float32), lost_by_the_table),
}
CASES = [
    *(
        row(f"the anchor is the nearest one for {name}", (n, directions), lost_exactly, BEST, naive)
        for name, (n, directions, naive) in DIRECTIONS.items()
    ),
    row(
        "a single anchor points up where the lattices formula divides by 0",
        1,
        lambda n: AnchorLattice(n).directions,
        equal(np.array([[0.0, 0.0, 1.0]])),
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
