"""Cells of the sphere: of equal area, and moved onto each other by every turn."""

import numpy as np
import pytest

from xihenet.estimators.ring_grid import SIZES, TURNS, ring_grid, turns_of_light
from xihenet.sh_basis import basis

RANDOM = np.random.default_rng(0).normal(size=(40_000, 3))
RANDOM /= np.linalg.norm(RANDOM, axis=1, keepdims=True)


@pytest.mark.parametrize("n", SIZES)
def test_each_middle_lies_in_its_own_cell_and_every_turn_brings_middles_onto_middles(n):
    grid = ring_grid(n)
    np.testing.assert_array_equal(grid.cell_of(grid.directions), np.arange(n))
    for turn, before, after in zip(TURNS, grid.turned, grid.turned_back, strict=True):
        np.testing.assert_allclose(grid.directions[before] @ turn.T, grid.directions, atol=1e-12)
        np.testing.assert_array_equal(before[after], np.arange(n))


@pytest.mark.parametrize("n", [80, 320])
def test_cells_have_equal_area(n):
    counts = np.bincount(ring_grid(n).cell_of(RANDOM), minlength=n)
    assert np.abs(counts / len(RANDOM) * n - 1).max() < 5 * np.sqrt(n / len(RANDOM))


def test_finer_cells_lie_within_coarser_ones():
    for fine, coarse in ((320, 80), (80, 24)):
        of_middle = ring_grid(coarse).cell_of(ring_grid(fine).directions)
        np.testing.assert_array_equal(ring_grid(coarse).cell_of(RANDOM), of_middle[ring_grid(fine).cell_of(RANDOM)])


def test_a_turned_light_has_in_each_turned_direction_what_it_had_before():
    light = np.random.default_rng(1).normal(size=(9, 3))
    for turn, of_light in zip(TURNS, turns_of_light(), strict=True):
        np.testing.assert_allclose(basis(RANDOM[:50] @ turn.T) @ (of_light @ light), basis(RANDOM[:50]) @ light)


def test_the_poles_and_the_seam_have_cells_and_other_sizes_have_none():
    assert set(ring_grid(24).cell_of([[0, 0, 1], [0, 0, -1]])) == {0, 16}
    # A hair on the other side of +X, where cells begin: an angle that is 2 pi when rounded.
    assert ring_grid(80).cell_of([[1, -1e-20, 0]]) == ring_grid(80).cell_of([[1, -1e-3, 0]])
    with pytest.raises(ValueError, match="expected 320, 80, 24 cells, got 20"):
        ring_grid(20)
