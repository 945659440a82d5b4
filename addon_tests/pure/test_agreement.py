"""The comparison of two sets of noisy pictures: how often it is wrong, and what it sees."""

import numpy as np
import pytest

from addon_tests.agreement import agreement


def pictures(seed, mean=1.0, noise=0.5, n_seeds=16, shape=(12, 16)):
    rng = np.random.default_rng(seed)
    return mean + noise * rng.standard_normal((n_seeds, *shape, 3))


def test_equal_pictures_agree_without_a_doubt():
    one = pictures(0)
    found = agreement(one, one.copy())
    assert found.holds and found.mean_errors == 0 and found.relative_difference == 0


def test_chance_alone_rarely_speaks_against_independent_pictures():
    """Each channel's mean is beyond two errors at 5.5 % by Student's t, the blocks at some 4 %."""
    held = [agreement(pictures(k), pictures(1000 + k)) for k in range(300)]
    assert np.mean([found.block_errors > 2 for found in held]) < 0.08
    assert 0.08 < np.mean([found.mean_errors > 2 for found in held]) < 0.22
    assert abs(np.mean([found.block_errors for found in held])) < 0.2


def test_some_percent_missing_everywhere_is_seen():
    assert not agreement(pictures(1), pictures(2, mean=0.94)).holds


def test_what_is_missing_in_one_corner_and_added_in_another_is_seen_by_the_blocks():
    changed = pictures(4)
    changed[:, :3, :4] += 0.3
    changed[:, -3:, -4:] -= 0.3
    found = agreement(pictures(3), changed)
    assert found.mean_errors < 3 < found.block_errors


def test_a_difference_without_noise_is_one():
    black, grey = np.zeros((16, 8, 8, 3)), np.full((16, 8, 8, 3), 0.1)
    assert agreement(black, black).holds
    assert agreement(black, grey).mean_errors > 1e6
    assert agreement(grey, grey * (1 + 1e-9)).holds


@pytest.mark.parametrize("shape", [(16, 8, 8), (3, 8, 8, 3), (16, 8, 8, 4)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(ValueError, match="expected two"):
        agreement(np.zeros(shape), np.zeros(shape))


def test_pictures_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite"):
        agreement(pictures(0), np.full((16, 12, 16, 3), np.nan))
