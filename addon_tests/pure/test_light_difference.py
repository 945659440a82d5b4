"""How different the lights of two clouds are, and what the trigger's policy makes of it."""

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud
from xihenet.buffers import merge
from xihenet.colour import linear_to_srgb
from xihenet.light_difference import DARK_LIGHT, DIRECTION_WEIGHT, light_difference
from xihenet.records import UnitSphereCloud
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, decide_trigger

N = 320
LATTICE = AnchorLattice(N)
ALL = np.ones(N, bool)
LOWER = LATTICE.directions[:, 2] < 0
BY_LIGHT = TriggerSettings(policy="light")


def cloud(radiance, is_set=ALL, tint=(1, 1, 1)):
    """Of linear light, one for all anchors or one each."""
    srgb = linear_to_srgb(np.broadcast_to(np.asarray(radiance, np.float64).reshape(-1, 1), (N, 3)) * tint)
    return UnitSphereCloud(np.where(is_set[:, None], srgb, 0), np.where(is_set, 2.0, 0.0), is_set)


def test_it_is_what_the_coefficients_say_one_by_one():
    rng = np.random.default_rng(4)
    for _ in range(20):
        first, second = random_cloud(rng, N), random_cloud(rng, N)
        a, b = project_anchors(first, LATTICE), project_anchors(second, LATTICE)
        shares = []
        for c in range(3):
            off, size = 0.0, 0.0
            for k in range(9):
                weight = 1.0 if k == 0 else DIRECTION_WEIGHT**2
                off += weight * (a[k, c] - b[k, c]) ** 2 / 9
                size += weight * (a[k, c] ** 2 + b[k, c] ** 2) / 18
            shares.append(off**0.5 / (size**0.5 + DARK_LIGHT))
        assert light_difference(first, second, LATTICE) == pytest.approx(max(shares))


@pytest.mark.parametrize("level", [0.0, 0.02, 0.5, 1.0])
def test_more_of_the_same_light_changes_little(level):
    assert light_difference(cloud(level, LOWER), cloud(level), LATTICE) < 0.2 * BY_LIGHT.light_theta


def test_a_bright_thing_that_comes_into_view_counts_by_its_solid_angle():
    found, from_above = [], np.argsort(-LATTICE.directions[:, 2])
    for n_bright in (4, 16, 64):
        radiance = np.full(N, 0.1)
        radiance[from_above[:n_bright]] = 1.0
        found.append(light_difference(cloud(0.1, LOWER), cloud(radiance), LATTICE))
    assert found[0] < BY_LIGHT.light_theta < found[2] and np.all(np.diff(found) > 0)


def test_a_lamp_in_the_dark_asks_when_it_can_be_seen():
    assert light_difference(cloud(0.0), cloud(0.005), LATTICE) < BY_LIGHT.light_theta
    assert light_difference(cloud(0.0), cloud(0.1), LATTICE) > BY_LIGHT.light_theta


@pytest.mark.parametrize("turned", ["first", "second"])
def test_colour_that_turned_nan_says_nothing(turned):
    first, second = cloud(0.3), cloud(0.4)
    expected = light_difference(first, second, LATTICE)
    colours = first.srgb if turned == "first" else second.srgb
    colours.flags.writeable = True
    colours[:40] = np.nan
    assert light_difference(first, second, LATTICE) == pytest.approx(expected, rel=0.15)


def test_nothing_seen_differs_by_nothing_and_sizes_must_agree():
    assert light_difference(cloud(0.3), UnitSphereCloud.empty(N), LATTICE) == 0
    assert light_difference(UnitSphereCloud.empty(N), cloud(0.3), LATTICE) == 0
    with pytest.raises(ValueError, match="320"):
        light_difference(cloud(0.3), UnitSphereCloud.empty(12), LATTICE)


def test_the_policy_holds_all_that_is_known_now_against_the_last_estimate():
    rng = np.random.default_rng(6)
    for _ in range(20):
        before, since = random_cloud(rng, N), random_cloud(rng, N)
        decision = decide_trigger(before, since, LATTICE, BY_LIGHT)
        assert decision.change == light_difference(before, merge(before, since), LATTICE)
        assert decision.fire == (decision.change > BY_LIGHT.light_theta)


def test_the_policy_fires_above_its_threshold_alone():
    decision = decide_trigger(cloud(0.1), cloud(0.8), LATTICE, BY_LIGHT)
    assert (decision.fire, decision.reason, decision.threshold) == (True, "light", 0.75)
    above = TriggerSettings(policy="light", theta=0.0, coverage_theta=0.0, light_theta=decision.change)
    assert decide_trigger(cloud(0.1), cloud(0.8), LATTICE, above).reason == "none"
    assert decide_trigger(None, cloud(0.6), LATTICE, above).reason == "first"
