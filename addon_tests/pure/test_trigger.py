"""When the trigger fires, and what it says about it."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from addon_tests.pure.made import random_cloud, without_surfaces
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.records import AnchorSurfaces, TriggerDecision, UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.trigger import RULES, LastSeen, Policy, Rule, TriggerSettings, colour_change, decide_trigger

N = 320
LATTICE = AnchorLattice(N)


def cloud(is_set, colour=0.5):
    is_set = np.broadcast_to(is_set, N).copy()
    srgb = np.where(is_set[:, None], np.float32(colour), 0).astype(np.float32) * np.ones(3, np.float32)
    return UnitSphereCloud(srgb, np.where(is_set, 2.0, 0.0), is_set)


HALF = LATTICE.directions[:, 2] > 0


def test_a_newly_seen_bright_thing_is_coverage_and_not_a_change_from_black():
    before, after = cloud(HALF, 1.0), cloud(True, 1.0)
    decision = decide_trigger(before, after, LATTICE, TriggerSettings())
    assert decision.fire and decision.reason == "coverage"
    assert decision.change == pytest.approx(1 - HALF.mean()) and decision.threshold == 0.05
    assert decision.n_changed_anchors == N - HALF.sum()


@pytest.mark.parametrize("policy", ["reference", "split"])
def test_each_policy_equals_a_loop_over_the_anchors_it_asks(policy):
    """The paper's asks all, unset ones being black; ours those set on both sides."""
    rng, window = np.random.default_rng(8), LATTICE.neighbours(4)
    for _ in range(20):
        before, after = random_cloud(rng, N), random_cloud(rng, N)
        asked = before.is_set & after.is_set if policy == "split" else np.ones(N, bool)
        pooled = [
            np.mean([((after.srgb[k] - before.srgb[k]) ** 2).mean() for k in window[anchor] if asked[k]])
            for anchor in np.flatnonzero(asked)
        ]
        decision = decide_trigger(before, after, LATTICE, TriggerSettings(0.3, policy=policy, coverage_theta=1.0))
        assert decision.change == pytest.approx(max(pooled), rel=1e-5)
        assert decision.n_changed_anchors == sum(value > 0.3 for value in pooled)


def test_a_few_noisy_anchors_can_be_set_aside():
    after = cloud(True).srgb.copy()
    after[[10, 150, 300]] = 1.0
    noisy = UnitSphereCloud(after, cloud(True).distance_m, np.ones(N, bool))
    eager, patient = TriggerSettings(theta=0.02), TriggerSettings(theta=0.02, ignored_share=0.1)
    assert decide_trigger(cloud(True), noisy, LATTICE, eager).reason == "colour"
    assert not decide_trigger(cloud(True), noisy, LATTICE, patient).fire
    assert decide_trigger(cloud(True), cloud(True, 0.7), LATTICE, patient).reason == "colour"


@pytest.mark.parametrize(
    "wrong",
    [
        {"policy": "best"},
        {"coverage_theta": -1},
        {"view_angle_deg": 181},
        {"view_angle_deg": np.nan},
        {"same_distance": 0},
        {"agreeing_share": 1.1},
        {"light_theta": np.nan},
        *({"n_neighbours": n} for n in (0, 2.5, np.nan, np.inf)),
    ],
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TriggerSettings(**wrong)


ROOM_M = 2.0
"""Every surface of the room that follows is so far from the position."""
NEAR, FAR = np.array([0.0, -1.5, 0.2]), np.array([1.2, -0.9, 0.2])
"""Two places of the phone: from all surfaces they lie more than 5 degrees apart."""
WALK = TriggerSettings(theta=0.007, ignored_share=0.25, coverage_theta=1.0)


def seen_from(camera_m, srgb, distance_m=ROOM_M):
    """The whole room around the position, of colours (N, 3) or (3,), as a camera there sees it."""
    distance = np.broadcast_to(np.float32(distance_m), N)
    to_camera = camera_m - LATTICE.directions * distance[:, None]
    lengths = np.linalg.norm(to_camera, axis=1)
    zeros = np.zeros(N, np.float32)
    surfaces = AnchorSurfaces(zeros, lengths, to_camera / lengths[:, None])
    return UnitSphereCloud(np.broadcast_to(srgb, (N, 3)), distance, np.ones(N, bool), surfaces=surfaces)


def textured(seed=0):
    return np.random.default_rng(seed).uniform(0.25, 0.6, (N, 3)).astype(np.float32)


def with_reflections(srgb, seed, share=0.4):
    """A glossy table in the lowest `share` of the sphere, whose colour depends on where it is seen from."""
    table = LATTICE.directions[:, 2] < 2 * share - 1
    reflected = np.random.default_rng(seed).uniform(0.0, 1.0, (N, 3)).astype(np.float32)
    return np.where(table[:, None], reflected, srgb)


def lit_by(factor, srgb):
    return linear_to_srgb(np.minimum(srgb_to_linear(srgb.astype(np.float64)) * factor, 1.0))


@pytest.mark.parametrize("seed", range(5))
def test_reflections_that_moved_with_the_phone_are_no_change_of_the_light(seed):
    before = seen_from(NEAR, with_reflections(textured(), seed))
    after = seen_from(FAR, with_reflections(textured(), 100 + seed))
    assert decide_trigger(before, after, LATTICE, WALK).reason == "none"
    assert decide_trigger(without_surfaces(before), without_surfaces(after), LATTICE, WALK).reason == "colour"


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("factor", [0.25, 4.0, (0.2, 0.35, 0.9)])
def test_a_lamp_that_changes_while_the_phone_walks_is_noticed(seed, factor):
    before = seen_from(NEAR, with_reflections(textured(seed), seed, share=0.08))
    after = seen_from(FAR, with_reflections(lit_by(factor, textured(seed)), 100 + seed, share=0.08))
    assert decide_trigger(before, after, LATTICE, WALK).reason == "colour"


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("factor", [0.25, 0.5, 3.0])
def test_a_lamp_that_changes_at_once_is_noticed_over_a_table_that_reflects(seed, factor):
    mirrored, before = (with_reflections(textured(seed), k) for k in (seed, 100 + seed))
    first, now = seen_from(NEAR, mirrored), seen_from(FAR, lit_by(factor, before))
    assert decide_trigger(first, now, LATTICE, WALK).reason == "none"
    dimmed = LastSeen(seen_from(FAR, before), now)
    assert decide_trigger(first, now, LATTICE, WALK, last_seen=dimmed).reason == "colour"


@pytest.mark.parametrize("seed", range(5))
def test_a_table_that_mirrors_something_else_at_once_is_no_lamp(seed):
    first, before, now = (seen_from(FAR, with_reflections(textured(), k)) for k in (seed, 100 + seed, 200 + seed))
    first = seen_from(NEAR, first.srgb)
    assert decide_trigger(first, now, LATTICE, WALK, last_seen=LastSeen(before, now)).reason == "none"


@pytest.mark.parametrize("seed", range(5))
def test_a_phone_that_stands_still_asks_every_surface(seed):
    before, after = (seen_from(NEAR, with_reflections(textured(), k)) for k in (seed, 100 + seed))
    decision = decide_trigger(before, after, LATTICE, WALK)
    assert decision.reason == "colour"
    assert decision == decide_trigger(without_surfaces(before), without_surfaces(after), LATTICE, WALK)


def test_another_point_of_a_cell_is_no_move_of_the_phone():
    before, after = seen_from(NEAR, textured(0)), seen_from(NEAR + 0.004, textured(1), 1.05 * ROOM_M)
    assert decide_trigger(before, after, LATTICE, WALK).reason == "colour"


def test_another_surface_behind_an_edge_is_not_asked():
    behind = np.where(LATTICE.directions[:, 0] > 0, 3 * ROOM_M, ROOM_M)
    colour = np.where(LATTICE.directions[:, :1] > 0, np.float32(1.0), textured())
    before, after = seen_from(NEAR, textured()), seen_from(FAR, colour, behind)
    assert decide_trigger(before, after, LATTICE, WALK).reason == "none"
    assert decide_trigger(without_surfaces(before), without_surfaces(after), LATTICE, WALK).reason == "colour"


def test_what_is_seen_from_another_angle_is_asked_where_it_is_the_same_surface_and_all_else_as_ever():
    rng, window, ones = np.random.default_rng(3), LATTICE.neighbours(4), np.ones(N, np.float32)
    is_turned, nearness = rng.random(N) < 0.5, rng.choice([0.5, 0.97, 1.0, 1.01, 1.5], N)
    colours = textured(0), textured(1)
    clouds = [
        UnitSphereCloud(srgb, ROOM_M * scale, ones > 0, surfaces=AnchorSurfaces(0 * ones, 1e4 * ones, np.eye(3)[axis]))
        for srgb, scale, axis in zip(colours, (ones, nearness), (0 * is_turned, 1 * is_turned), strict=True)
    ]
    asked, change = ~is_turned | (np.abs(nearness - 1) <= 0.02), ((colours[1] - colours[0]) ** 2).mean(axis=1)
    pooled = [np.mean([change[k] * ~is_turned[k] for k in window[i] if asked[k]]) for i in np.flatnonzero(asked)]
    decision = decide_trigger(*clouds, LATTICE, TriggerSettings(0.02, coverage_theta=1.0))
    assert decision.change == pytest.approx(max(pooled), rel=1e-5)
    assert decision.n_changed_anchors == sum(value > 0.02 for value in pooled) > 10


@pytest.mark.parametrize(
    ("last", "threshold"),
    [(None, 0.01), (("none", False), 0.01), (("coverage", True), 0.01), (("colour", True), 0.015)],
)
def test_right_after_a_fire_for_colour_the_threshold_is_raised_by_its_share(last, threshold):
    eager = TriggerSettings(theta=0.01, hysteresis=0.5, coverage_theta=1.0)
    before = last and TriggerDecision(last[1], last[0], 1.0, 0.01)
    decision = decide_trigger(cloud(True), cloud(True, 0.5 + np.sqrt(0.012)), LATTICE, eager, last=before)
    assert (decision.threshold, decision.fire) == (pytest.approx(threshold), threshold < 0.012)


def test_surfaces_of_which_nothing_is_known_are_asked_as_ever():
    before, after = seen_from(NEAR, textured(0)), seen_from(FAR, textured(1))
    zeros = np.zeros(N, np.float32)
    nothing = AnchorSurfaces(zeros, zeros, np.zeros((N, 3)))
    unknown = UnitSphereCloud(after.srgb, after.distance_m, after.is_set, surfaces=nothing)
    decision = decide_trigger(before, unknown, LATTICE, WALK)
    assert decision == decide_trigger(without_surfaces(before), without_surfaces(after), LATTICE, WALK)


def test_an_angle_of_180_degrees_takes_no_surface_for_seen_from_another_angle():
    before, after = seen_from(NEAR, textured(0)), seen_from(FAR, textured(1))
    ever = TriggerSettings(theta=0.007, ignored_share=0.25, coverage_theta=1.0, view_angle_deg=180.0)
    decision = decide_trigger(before, after, LATTICE, ever)
    assert decision == decide_trigger(without_surfaces(before), without_surfaces(after), LATTICE, ever)


def test_a_theta_of_zero_fires_at_any_change_reflections_included():
    before, after = (seen_from(place, with_reflections(textured(), k)) for k, place in enumerate((NEAR, FAR)))
    assert decide_trigger(before, after, LATTICE, RULES["every-frame"]).reason == "colour"
    assert not decide_trigger(after, after, LATTICE, RULES["every-frame"]).fire
    dimmed = cloud(np.arange(N) > 0, 0.4).srgb + cloud(np.arange(N) < 1, 0.5).srgb
    decision = decide_trigger(cloud(True, 0.4), replace(cloud(True), srgb=dimmed), LATTICE, RULES["every-frame"])
    assert decision.n_changed_anchors == (LATTICE.neighbours(4) == 0).any(axis=1).sum()


@pytest.mark.parametrize("seed", range(5))
def test_the_change_in_colour_is_what_the_decision_says(seed):
    rng = np.random.default_rng(seed)
    before, after = random_cloud(rng, N, 0.9), random_cloud(rng, N, 0.9)
    settings_ = TriggerSettings(theta=1.0, ignored_share=0.25, coverage_theta=1.0)
    assert colour_change(before, after, LATTICE, settings_) == decide_trigger(before, after, LATTICE, settings_).change


def test_every_policy_can_be_chosen_by_name():
    assert {rule.policy for rule in RULES.values()} == {*get_args(Policy)} and {*RULES} == {*get_args(Rule)}


@pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
def test_a_rule_has_one_threshold_whether_there_is_nothing_the_first_or_more_to_compare(rule):
    pairs = ((None, cloud(False)), (None, cloud(True)), (cloud(True), cloud(True)))
    assert {decide_trigger(*clouds, LATTICE, rule).threshold for clouds in pairs} == {rule.threshold}


@pytest.mark.parametrize("rule", RULES)
def test_all_thresholds_of_a_rule_are_scaled_and_nothing_else(rule):
    own = RULES[rule]
    scaled, at_once = own.scaled(64.0), own.scaled(0.0)
    thetas = {name: value for name, value in vars(own).items() if name.endswith("theta")}
    assert {"theta", "coverage_theta", "light_theta"} <= set(thetas)
    for name, theta in thetas.items():
        most = 1 if name == "coverage_theta" else np.inf
        assert getattr(scaled, name) == min(most, 64 * theta) and getattr(at_once, name) == 0
    assert own.scaled(1.0) == own and replace(scaled, **thetas) == own
