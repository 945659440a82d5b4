"""Paired values: differences and correlations, exact where the answer is known, and as sure of it as they may be."""

import numpy as np
import pytest
from scipy import stats

from xihenet.paired import T_975, paired_difference, rank_correlation, rank_correlation_interval, t_975


def generator(seed=0):
    return np.random.default_rng(seed)


def test_a_constant_difference_is_known_exactly():
    base = generator(1).uniform(size=12)
    found = paired_difference(base + 0.5, base, list(range(12)), generator())
    assert found.mean == pytest.approx(0.5) and found.low == pytest.approx(0.5) and found.high == pytest.approx(0.5)
    assert found.is_clear and found.share_lower == 0


def test_exchanging_the_two_mirrors_the_answer():
    a, b = generator(2).normal(size=(2, 9))
    groups = list("aabbccdde")
    there, back = (paired_difference(*pair, groups, generator()) for pair in ((a, b), (b, a)))
    assert back.mean == -there.mean and back.share_lower == 1 - there.share_lower
    assert (back.low, back.high) == (pytest.approx(-there.high), pytest.approx(-there.low))


def test_equal_values_are_lower_on_neither_side():
    found = paired_difference([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 4.0, 3.0], "abcd", generator())
    assert found.share_lower == found.share_higher == 0.25


def test_a_shift_of_a_whole_pair_changes_nothing():
    a, b = generator(3).normal(size=(2, 8))
    shift, groups = 100 * generator(4).normal(size=8), list(range(8))
    plain, shifted = (paired_difference(a + s, b + s, groups, generator()) for s in (0, shift))
    assert shifted.mean == pytest.approx(plain.mean) and shifted.low == pytest.approx(plain.low)


def test_more_seeds_of_the_same_scenes_make_nothing_surer():
    a, b = generator(5).normal(size=(2, 6))
    once = paired_difference(a, b, range(6), generator())
    often = paired_difference(np.tile(a, 50), np.tile(b, 50), list(range(6)) * 50, generator())
    assert (often.low, often.high) == (pytest.approx(once.low), pytest.approx(once.high))
    assert often.n_groups == 6 and often.n_pairs == 300


@pytest.mark.parametrize("n_groups", [7, 20])
def test_the_interval_holds_the_truth_about_as_often_as_it_says(n_groups):
    rng, n_trials = generator(6), 300
    held = 0
    for _ in range(n_trials):
        found = paired_difference(rng.normal(0.3, 1.0, n_groups), np.zeros(n_groups), range(n_groups), rng)
        held += found.low <= 0.3 <= found.high
    assert 0.9 <= held / n_trials <= 0.99


def test_one_scene_alone_is_told_apart():
    a, b = generator(7).normal(size=(2, 10))
    found = paired_difference(a, b, ["room"] * 10, generator())
    assert found.n_groups == 1 and found.low < found.mean < found.high


@pytest.mark.parametrize("n_groups", [2, 3, 5, 6, 7])
def test_nothing_is_clear_on_so_few_groups_that_no_interval_could_be_one_of_95_percent(n_groups):
    ones = np.ones(3 * n_groups)
    over_scenes = paired_difference(ones, 0 * ones, [k // 3 for k in range(3 * n_groups)], generator())
    over_seeds = paired_difference(ones[:n_groups], 0 * ones[:n_groups], ["room"] * n_groups, generator())
    assert over_scenes.is_clear == over_seeds.is_clear == (n_groups >= 6)
    assert over_scenes.low == over_scenes.high == over_seeds.low == over_seeds.high == 1


def test_a_single_pair_has_no_interval_and_is_never_clear():
    found = paired_difference([1.0], [0.0], ["room"], generator())
    assert (found.mean, found.low, found.high) == (1.0, None, None) and not found.is_clear


@pytest.mark.parametrize(
    ("first", "second", "groups"), [([], [], []), ([1.0], [1.0, 2.0], ["a"]), ([np.nan, 1.0], [1.0, 1.0], "ab")]
)
def test_what_is_no_pair_is_refused(first, second, groups):
    with pytest.raises(ValueError, match="expected"):
        paired_difference(first, second, groups, generator())


def test_students_t_is_that_of_scipy():
    degrees = range(1, 200)
    assert [t_975(d) for d in degrees] == pytest.approx([stats.t.ppf(0.975, d) for d in degrees], rel=1.2e-3)
    assert t_975(1000) == pytest.approx(stats.t.ppf(0.975, 1000), rel=3e-9)
    assert len(T_975) == 15


def test_the_correlation_of_ranks_is_that_of_scipy_ties_included():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 40))
    for one, other in ((a, b), (a, np.exp(a)), (a, -(a**3)), (np.round(a), np.round(b))):
        assert rank_correlation(one, other) == pytest.approx(stats.spearmanr(one, other).statistic)


def test_a_correlation_without_an_order_is_undefined():
    for a in ([], [1.0], [2.0, 2.0, 2.0]):
        values = np.array(a)
        assert np.isnan(rank_correlation(values, np.arange(len(a))))
        assert np.isnan(rank_correlation_interval(values, np.arange(len(a)), np.random.default_rng(0))).all()


@pytest.mark.parametrize("n", [2, 7])
def test_a_correlation_of_few_pairs_has_no_interval(n):
    """Of places that lie in order every draw says 1, though the correlation of all places is lower."""
    assert np.isnan(rank_correlation_interval(np.arange(n), np.arange(n), np.random.default_rng(0))).all()


def test_the_interval_holds_the_correlation_and_narrows_with_more_pairs():
    rng, widths = np.random.default_rng(5), []
    for n in (20, 500):
        a = rng.normal(size=n)
        b = a + rng.normal(size=n)
        low, high = rank_correlation_interval(a, b, np.random.default_rng(0))
        assert low < rank_correlation(a, b) < high
        widths.append(high - low)
    assert widths[1] < widths[0] / 3
