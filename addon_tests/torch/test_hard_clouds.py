"""The paper's network on the clouds that are hard for any network."""

import numpy as np
import pytest

from addon_tests.pure.hard_cases.hard_clouds import CLOUDS, NOTHING, ONE_WHITE, WHITE_ABOVE, WHITE_LIGHT
from xihenet.estimators import load

HARD = CLOUDS | {"nothing seen": NOTHING, "one white anchor alone": ONE_WHITE, "white above": WHITE_ABOVE}


@pytest.fixture(scope="module")
def network():
    return load("xihenet")


@pytest.mark.parametrize("name", list(HARD))
def test_extreme_clouds_give_light_of_at_most_white(network, name):
    assert np.abs(network.estimate(HARD[name])).max() <= WHITE_LIGHT
