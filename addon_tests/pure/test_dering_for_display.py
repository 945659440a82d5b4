"""Light that is looked at: nowhere negative, by the smallest window, whichever way the room is turned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as nps

from addon_tests.fuzz import some_examples
from addon_tests.pure.made import random_rotation
from addon_tests.pure.sh_samples import F64, distant_light, random_directions, random_light, windowed
from xihenet.sh import basis, dering_for_display, irradiance, rotate

CONSTANT = np.eye(9)[:, [0, 0, 0]]
LIGHT = nps.arrays(np.float64, (9, 3), elements=st.floats(-1e9, 1e9))
DIRECTIONS = random_directions(20000, seed=41)


def bright(light: F64) -> F64:
    """The same with a mean that is not negative."""
    light[0] = np.abs(light[0])
    return light


RINGING = [
    *(bright(random_light(order, seed)) for order, seed in [(1, 0), (2, 1), (2, 2), (3, 3), (4, 4)]),
    distant_light((1, -2, 0.5)) * [1.0, 0.5, 0.25],
]


def radiance(light: F64) -> F64:
    return basis(DIRECTIONS, round(np.sqrt(len(light))) - 1) @ light


@pytest.mark.parametrize("light", RINGING)
def test_it_is_nowhere_negative_and_each_channel_has_the_smallest_window(light):
    shown = dering_for_display(light)
    assert (radiance(light).min(axis=0) < 0).all()
    assert (radiance(shown).min(axis=0) >= -1e-3 * radiance(shown).max(axis=0)).all()
    for channel in range(3):
        kept = shown[1, channel] / light[1, channel]
        np.testing.assert_allclose(shown[:, channel], windowed(light, kept)[:, channel], atol=1e-14)
        assert radiance(windowed(light, kept + 0.01))[:, channel].min() < 0
    np.testing.assert_array_equal(dering_for_display(shown), shown)


@some_examples()
@given(light=LIGHT)
def test_whatever_the_light_nothing_is_negative_and_no_surface_is_lit_negatively(light):
    shown, tolerance = dering_for_display(light), 2e-3 * max(np.abs(light).max(), 1e-300)
    assert radiance(shown).min() >= -tolerance and irradiance(shown, DIRECTIONS[:500]).min() >= -tolerance
    np.testing.assert_array_equal(shown[0], np.where(light[0] >= 0, light[0], 0))
    assert (np.abs(shown) <= np.abs(light)).all()


@pytest.mark.parametrize("light", RINGING)
@pytest.mark.parametrize("seed", range(3))
def test_a_turned_room_gives_the_turned_light(light, seed):
    turn = random_rotation(seed)
    difference = dering_for_display(rotate(light, turn)) - rotate(dering_for_display(light), turn)
    # What is left is the grid of directions that is checked.
    assert np.abs(difference).max() < 5e-3 * np.abs(light).max()


@pytest.mark.parametrize("light", [np.zeros((9, 3)), CONSTANT, CONSTANT + 0.05 * random_light()])
def test_light_that_is_nowhere_negative_stays_to_the_bit(light):
    assert radiance(light).min() >= 0
    np.testing.assert_array_equal(dering_for_display(light), light)


def test_a_dark_channel_that_rings_takes_nothing_off_the_others():
    light = np.zeros((9, 3))
    light[0], light[3] = [1.0, 1.0, 0.01], [0.3, 0.1, 0.02]
    shown = dering_for_display(light)
    np.testing.assert_array_equal(shown[:, :2], light[:, :2])
    assert 0 < shown[3, 2] < light[3, 2]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_light_that_is_no_number_is_refused(value):
    with pytest.raises(ValueError, match="expected finite coefficients"):
        dering_for_display(np.full((9, 3), value))
