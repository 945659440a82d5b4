"""By how much what has been seen since is expected to change the light in force."""

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.expected_change import DARK_LIGHT, L0_VARIANCE, expected_change
from xihenet.records import UnitSphereCloud
from xihenet.sh import L1_VARIANCE, RESIDUAL_NOISE, basis, project_anchors
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, decide_trigger

N = 320
LATTICE = AnchorLattice(N)
ALL = np.ones(N, bool)
LOWER = LATTICE.directions[:, 2] < 0
BY_LIGHT = TriggerSettings(policy="light")


def cloud(radiance, is_set=ALL):
    """Of linear light, one for all anchors or one each."""
    srgb = linear_to_srgb(np.broadcast_to(np.asarray(radiance, np.float64).reshape(-1, 1), (N, 3)))
    return UnitSphereCloud(np.where(is_set[:, None], srgb, 0), np.where(is_set, 2.0, 0.0), is_set)


def size(coefficients):
    return np.sqrt(np.mean(np.square(coefficients)))


def by_stacked_rows(previous, current):
    """The same by one plain least squares: a row for each anchor, and one for each coefficient that stays."""
    light, rows, values = project_anchors(previous, LATTICE), [], []
    for anchor in np.flatnonzero(current.is_set):
        row = basis(LATTICE.directions[anchor : anchor + 1], 2)[0]
        was = srgb_to_linear(previous.srgb[anchor].astype(float)) if previous.is_set[anchor] else row @ light
        rows.append(row * np.sqrt(4 * np.pi / N))
        values.append((srgb_to_linear(current.srgb[anchor].astype(float)) - was) * np.sqrt(4 * np.pi / N))
    variances = [L0_VARIANCE, *[L1_VARIANCE] * 3, *[L1_VARIANCE / 4] * 5]
    rows += list(np.diag(np.sqrt(RESIDUAL_NOISE / np.array(variances))))
    change = np.linalg.lstsq(np.array(rows), np.array(values + [np.zeros(3)] * 9), rcond=None)[0]
    return size(change) / (size(light) + DARK_LIGHT)


def test_it_is_the_plain_least_squares():
    rng = np.random.default_rng(4)
    for _ in range(20):
        previous, current = random_cloud(rng, N), random_cloud(rng, N)
        assert expected_change(previous, current, LATTICE) == pytest.approx(by_stacked_rows(previous, current))


@pytest.mark.parametrize("level", [0.0, 0.02, 0.5, 1.0])
def test_more_of_the_same_light_changes_nothing(level):
    before = cloud(level, LOWER)
    assert expected_change(before, before, LATTICE) == 0
    assert expected_change(before, cloud(level), LATTICE) < 1e-6


@pytest.mark.parametrize("factor", [0.25, 0.5, 1.5, 2.0])
def test_light_that_changes_everywhere_changes_by_its_share(factor):
    light = size(project_anchors(cloud(0.4), LATTICE))
    found = expected_change(cloud(0.4), cloud(0.4 * factor), LATTICE)
    assert found == pytest.approx(abs(factor - 1) * light / (light + DARK_LIGHT), rel=0.01)


def test_a_bright_thing_that_comes_into_view_counts_by_its_solid_angle():
    found, from_above = [], np.argsort(-LATTICE.directions[:, 2])
    for n_bright in (4, 16, 64):
        radiance = np.full(N, 0.2)
        radiance[from_above[:n_bright]] = 1.0
        found.append(expected_change(cloud(0.2, LOWER), cloud(radiance), LATTICE))
    assert found[0] < BY_LIGHT.light_theta < found[2] and np.all(np.diff(found) > 0)


def test_a_lamp_in_the_dark_asks_when_it_can_be_seen():
    assert expected_change(cloud(0.0), cloud(0.005), LATTICE) < BY_LIGHT.light_theta
    assert expected_change(cloud(0.0), cloud(0.05), LATTICE) > BY_LIGHT.light_theta


@pytest.mark.parametrize("turned", ["before", "now"])
def test_colour_that_turned_nan_says_nothing(turned):
    before, now = cloud(0.3), cloud(0.4)
    expected = expected_change(before, now, LATTICE)
    colours = before.srgb if turned == "before" else now.srgb
    colours.flags.writeable = True
    colours[:40] = np.nan
    assert expected_change(before, now, LATTICE) == pytest.approx(expected, rel=0.05)


def test_nothing_seen_is_no_change_and_sizes_must_agree():
    assert expected_change(cloud(0.3), UnitSphereCloud.empty(N), LATTICE) == 0
    with pytest.raises(ValueError, match="320"):
        expected_change(cloud(0.3), UnitSphereCloud.empty(12), LATTICE)


def test_the_policy_fires_above_its_threshold_alone():
    decision = decide_trigger(cloud(0.4), cloud(0.6), LATTICE, BY_LIGHT)
    assert (decision.fire, decision.reason, decision.threshold) == (True, "light", 0.18)
    assert decision.change == expected_change(cloud(0.4), cloud(0.6), LATTICE)
    above = TriggerSettings(policy="light", theta=0.0, coverage_theta=0.0, light_theta=decision.change)
    assert decide_trigger(cloud(0.4), cloud(0.6), LATTICE, above).reason == "none"
    assert decide_trigger(None, cloud(0.6), LATTICE, above).reason == "first"
