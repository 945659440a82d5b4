"""The same room elsewhere, turned, or scaled with its lights has the same light, end to end through Cycles."""

import numpy as np
import pytest
from moved_rooms import (
    ALL_THREE,
    ESTIMATORS,
    IN_METRES,
    NOISE,
    NOT_TURNED,
    TOLERANCE,
    YAWS,
    apart,
    see,
    turned_by_hand,
)


@pytest.fixture(scope="module")
def known():
    """The room as it is."""
    return see()


def assert_same(seen, known, tolerance):
    for name, error in seen.apart_from(known).items():
        assert error <= tolerance[name], f"{name}: {error:.4f}"


@pytest.mark.parametrize("placing", NOT_TURNED, ids=str)
def test_a_room_elsewhere_or_in_other_units_has_the_same_light(known, placing):
    assert_same(see(placing), known, NOISE)


@pytest.mark.parametrize("placing", [*YAWS, *ALL_THREE], ids=str)
def test_a_turned_room_has_the_turned_light(known, placing):
    seen = see(placing)
    assert_same(seen, known, TOLERANCE)
    # Against the same anchors nothing but noise is left.
    for name in ESTIMATORS:
        by_hand = turned_by_hand(known, placing.yaw_deg, name)
        assert apart(placing.turned_back(seen.lights[name]), by_hand) <= NOISE[name]


@pytest.mark.parametrize("placing", IN_METRES, ids=str)
def test_a_room_that_is_really_1000_times_as_large_has_the_same_light(known, placing):
    assert_same(see(placing, estimators=["projection"]), known, TOLERANCE)


def test_sun_and_sky_come_the_same_way_into_a_room_that_is_moved_turned_and_scaled():
    known = see(estimators=["projection"], is_open=True)
    for placing in (IN_METRES[1], ALL_THREE[1]):
        assert_same(see(placing, estimators=["projection"], is_open=True), known, TOLERANCE)


def test_the_bounds_are_those_of_noise(known):
    """Another seed stays within them, and takes more than a tenth of them."""
    others = [see(seed=seed).apart_from(known) for seed in (1, 2)]
    for name, bound in NOISE.items():
        worst = max(other[name] for other in others)
        assert bound / 10 < worst < bound / 1.5, f"{name}: {worst:.4f}"


def test_the_anchors_take_the_rest_of_what_a_yaw_may_change(known):
    for name in ESTIMATORS:
        errors = [apart(turned_by_hand(known, yaw, name), known.lights[name]) for yaw in np.linspace(1, 359, 12)]
        assert TOLERANCE[name] / 10 < max(errors) < TOLERANCE[name]


def test_a_light_that_is_not_turned_back_is_told_apart(known):
    lights = see(YAWS[3]).lights
    for name in ("projection", "truth"):
        assert apart(lights[name], known.lights[name]) > 4 * TOLERANCE[name]
    # Its light is that of any room more than of this one: a wrong yaw changes it by 0.24, its anchors alone by 0.15.
    assert apart(lights["lattice"], known.lights["lattice"]) > 1.2 * TOLERANCE["lattice"]
