"""The front of error against cost: held against the definition, pair by pair."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from xihenet.pareto import dominators, front_share, on_front

# Few values, so that ties are common; infinity is legal.
values = st.sampled_from([0.0, 1e-300, 0.5, 1.0, 2.0, 3.0, np.inf])
choices = st.lists(st.tuples(values, values), max_size=12).map(lambda rows: np.array(rows).reshape(-1, 2))


def dominates(a, b):
    return bool((a <= b).all() and (a < b).any())


def front_by_pairs(rows):
    return [not any(dominates(other, row) for other in rows) for row in rows]


@given(choices)
def test_the_front_is_what_no_other_choice_dominates(rows):
    assert on_front(rows[:, 0], rows[:, 1]).tolist() == front_by_pairs(rows)


@given(choices)
def test_a_dominated_choice_is_told_one_of_the_front_to_take_instead(rows):
    is_on_front, instead = on_front(*rows.T), dominators(*rows.T)
    assert is_on_front[instead].all()
    for choice, better in enumerate(instead):
        assert better == choice if is_on_front[choice] else dominates(rows[better], rows[choice])


@given(choices.filter(len), st.integers(1, 4))
@settings(max_examples=50)
def test_measurements_without_scatter_do_not_flicker(rows, n_rounds):
    rows = np.minimum(rows, 9.0)
    squares, costs = np.tile(rows[:, 0] ** 2, (2, 1)), np.tile(rows[:, 1], (n_rounds, 1))
    share = front_share(squares, costs, np.random.default_rng(1), n_resamples=5)
    assert share.tolist() == on_front(np.sqrt(squares[0]), costs[0]).astype(float).tolist()


def test_a_choice_that_is_as_good_as_another_up_to_chance_flickers():
    rng = np.random.default_rng(8)
    uneven, even = np.array([1.0, 1.0, 9.0]) * rng.uniform(0.9, 1.1, (15, 3)), np.full((4, 3), 0.25)
    for square_errors, costs in ((even, uneven), (uneven, even)):
        share = front_share(square_errors, costs, rng)
        assert 0.02 < share[0] < 0.98 and 0.02 < share[1] < 0.98
        assert share[2] == 0


def test_what_disturbs_a_round_disturbs_all_choices_and_no_front():
    load = np.random.default_rng(3).uniform(1, 10, (9, 1))
    share = front_share([[4.0, 1.0, 4.0]], load * [1.0, 2.0, 1.01], np.random.default_rng(4))
    assert share.tolist() == [1.0, 1.0, 0.0]


@pytest.mark.parametrize("rows", [([1.0], [1.0, 2.0]), ([[1.0]], [[1.0]]), ([float("nan")], [1.0])])
def test_what_is_no_error_and_cost_per_choice_is_refused(rows):
    with pytest.raises(ValueError, match="front: expected"):
        on_front(*rows)


@pytest.mark.parametrize("shapes", [((0, 2), (1, 2)), ((1, 2), (0, 2)), ((1, 2), (1, 3)), ((2,), (1, 2))])
def test_nothing_measured_has_no_front_share(shapes):
    with pytest.raises(ValueError, match="front_share: expected"):
        front_share(np.zeros(shapes[0]), np.zeros(shapes[1]), np.random.default_rng(0))
