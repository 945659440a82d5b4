"""What is out of view follows a change of the light, and nothing but that."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addon_tests.pure.made import UPRIGHT, about_z, pose_of
from xihenet import estimators
from xihenet.backend import LocalBackend, NoAnswer
from xihenet.buffers import merge
from xihenet.camera import pixel_rays
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.controller import ControllerSettings, XiheController
from xihenet.light_change import LightFollowing, _cannot_agree, follow_coarser, follow_light, light_change
from xihenet.metrics import shc_rmse
from xihenet.records import Intrinsics, RgbdFrame, UnitSphereCloud
from xihenet.trigger import TriggerSettings

N = 400
FOLLOWING = LightFollowing()
seeds = st.integers(0, 2**32 - 1)


def cloud(radiance, is_set):
    """As a phone keeps it: 8 bits, clipped."""
    codes = np.rint(255 * linear_to_srgb(radiance)) / 255
    return UnitSphereCloud(codes * is_set[:, None], 2.0 * is_set, is_set)


def room(seed, darkest=0.03, brightest=0.12):
    """Radiance of N anchors, which of them were seen at first, and which later; some at both times."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(N)
    return rng.uniform(darkest, brightest, (N, 3)), order < 0.7 * N, order > rng.uniform(0.2, 0.6) * N


@settings(max_examples=40, deadline=None)
@given(seed=seeds, brightest=st.sampled_from([0.002, 0.1, 1.0, 50.0]))
def test_where_the_light_is_the_same_nothing_is_touched(seed, brightest):
    radiance, first, later = room(seed, 0.0, brightest)
    old = cloud(radiance, first)
    assert follow_light(old, cloud(radiance, later), FOLLOWING) is old


@settings(max_examples=20, deadline=None)
@given(seed=seeds, factor=st.sampled_from([0.0, 0.2, 1.0, 3.0]))
def test_a_finer_cloud_follows_anchor_by_anchor(seed, factor):
    radiance, first, later = room(seed)
    changes = first & later
    before = cloud(radiance, first)
    after = cloud(np.where(changes[:, None], factor * radiance, radiance), first)
    beside = np.random.default_rng(seed).integers(0, N, 5 * N)
    fine = cloud(2 * radiance[beside], np.random.default_rng(seed).random(5 * N) < 0.6)
    followed = follow_coarser(fine, before, after, beside)
    same = fine.is_set & ~changes[beside]
    assert np.array_equal(followed.srgb[same], fine.srgb[same]) and np.array_equal(followed.is_set, fine.is_set)
    expected = factor * srgb_to_linear(fine.srgb.astype(float))
    told = fine.is_set & changes[beside]
    assert srgb_to_linear(followed.srgb[told].astype(float)) == pytest.approx(expected[told], rel=0.1, abs=0.004)


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_noise_is_no_change_of_the_light(seed):
    radiance, first, later = room(seed, 0.0, 0.5)
    noisy = radiance * np.random.default_rng(seed + 1).lognormal(0, 0.4, (N, 3))
    old = cloud(radiance, first)
    assert follow_light(old, cloud(noisy, later), FOLLOWING) is old


@settings(max_examples=40, deadline=None)
@given(seed=seeds, share=st.floats(0, 0.4), light=st.sampled_from([0.0, 0.01, 0.5, 9.0]))
def test_something_that_moves_into_view_is_no_change_of_the_light(seed, share, light):
    radiance, first, later = room(seed)
    moved = radiance.copy()
    again = np.flatnonzero(first & later)
    moved[again[: int(share * len(again))]] = light
    old = cloud(radiance, first)
    assert follow_light(old, cloud(moved, later), FOLLOWING) is old


@settings(max_examples=40, deadline=None)
@given(seed=seeds, factor=st.tuples(*[st.sampled_from([0.2, 0.25, 0.5, 2.0, 5.0])] * 3))
def test_what_is_out_of_view_follows_a_lamp_by_its_factor_and_its_colour(seed, factor):
    radiance, first, later = room(seed)
    old, new = cloud(radiance, first), cloud(radiance * factor, later)
    followed, stale = follow_light(old, new, FOLLOWING), first & ~later
    ratio = srgb_to_linear(followed.srgb[stale]) / srgb_to_linear(old.srgb[stale])
    np.testing.assert_allclose(ratio / factor, 1, atol=0.05)
    np.testing.assert_array_equal(followed.srgb[~stale], old.srgb[~stale])
    np.testing.assert_array_equal(followed.distance_m, old.distance_m)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, factor=st.sampled_from([0.25, 4.0]))
def test_a_lamp_that_goes_there_and_back_leaves_what_is_out_of_view_as_it_was(seed, factor):
    radiance, first, later = room(seed)
    changed = cloud(radiance * factor, later)
    known = merge(follow_light(cloud(radiance, first), changed, FOLLOWING), changed)
    last = np.arange(N) % 2 == 0
    back = follow_light(known, cloud(radiance, last), FOLLOWING)
    stale = back.is_set & ~last
    np.testing.assert_allclose(srgb_to_linear(back.srgb[stale]) / radiance[stale], 1, atol=0.25)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, exposure=st.sampled_from([0.5, 0.8, 2.0, 4.0]))
def test_the_exposure_has_no_say(seed, exposure):
    radiance, first, later = room(seed, 0.05, 0.12)
    once = light_change(cloud(radiance, first), cloud(radiance * 0.5, later), FOLLOWING)
    exposed = light_change(cloud(exposure * radiance, first), cloud(exposure * radiance * 0.5, later), FOLLOWING)
    np.testing.assert_allclose(exposed, once, rtol=0.1)


nasty_colours = st.sampled_from([0.0, 1 / 255, 0.01, 0.1, 0.5, 0.98, 1.0])


@settings(max_examples=100, deadline=None)
@given(data=st.data(), n=st.integers(1, 12))
def test_any_two_clouds_give_a_legal_one(data, n):
    def drawn():
        is_set = np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
        srgb = np.array(data.draw(st.lists(st.tuples(*[nasty_colours] * 3), min_size=n, max_size=n)))
        return UnitSphereCloud(srgb * is_set[:, None], 1.0 * is_set, is_set)

    old, new = drawn(), drawn()
    followed = follow_light(old, new, FOLLOWING)
    np.testing.assert_array_equal(followed.is_set, old.is_set)
    np.testing.assert_array_equal(followed.srgb[new.is_set], old.srgb[new.is_set])
    if not (old.is_set & new.is_set).any():
        assert followed is old


@pytest.mark.parametrize(
    "wrong",
    [{"smallest_stops": 0}, {"smallest_stops": np.inf}, {"smallest_stops": np.nan}, {"agreeing_share": 0},
     {"agreeing_share": 1.1}, {"smallest_share": np.nan}],
)  # fmt: skip
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=f"LightFollowing.{next(iter(wrong))}"):
        LightFollowing(**wrong)


CAMERA = Intrinsics(48, 36, 24.0, 24.0, 24.0, 18.0)
POSITION = (0.0, 1.0, 0.0)


def looking(yaw, light, number):
    """The phone at the origin, turned by `yaw` about +Z, in a striped sphere of 3 m that is lit by `light`."""
    pose, rays = pose_of(about_z(yaw) @ UPRIGHT), pixel_rays(CAMERA)
    plane_depth_m = 3 / np.linalg.norm(rays, axis=-1)
    world = (rays * plane_depth_m[..., None]) @ pose[:3, :3].T
    albedo = 0.3 + 0.1 * np.sin(2 * world[..., :1] + world[..., 1:2]) * np.ones(3)
    codes = np.rint(255 * linear_to_srgb(albedo * light)).astype(np.uint8)
    return RgbdFrame(codes, plane_depth_m, CAMERA, pose, frame=number)


def walk(lights, following, **parts):
    """Reports of a session that looks around, one frame per light."""
    chain = ControllerSettings(TriggerSettings(theta=0.02, ignored_share=0.25), following=following, **parts)
    controller = XiheController(LocalBackend(estimators.load("projection", N)), chain)
    controller.add_position("Ball", POSITION)
    yaws = 0.25 * np.sin(np.arange(len(lights)))
    return [
        controller.step(looking(yaw, light, i))["Ball"] for i, (yaw, light) in enumerate(zip(yaws, lights, strict=True))
    ]


def test_a_walk_under_the_same_light_is_the_same_to_the_last_bit():
    on, off = (walk([1.0] * 12, following) for following in (FOLLOWING, None))
    assert sum(report.decision.fire for report in on) > 1
    for a, b in zip(on, off, strict=True):
        assert a.decision == b.decision and a.n_followed_anchors == 0
        if a.estimate is not None:
            np.testing.assert_array_equal(a.estimate.sh_radiance, b.estimate.sh_radiance)


@pytest.mark.parametrize("light", [0.25, 2.0])
def test_after_a_lamp_has_changed_the_estimate_is_nearer_to_the_light_for_following(light):
    before = 1.0
    on, off = (walk([before] * 6 + [light], following)[-1] for following in (FOLLOWING, None))
    truth = walk([light] * 7, None)
    known = next(report.estimate for report in reversed(truth) if report.estimate is not None)
    errors = [shc_rmse(report.estimate.sh_radiance, known.sh_radiance) for report in (on, off)]
    assert on.n_followed_anchors > 0 == off.n_followed_anchors
    assert errors[0] < 0.5 * errors[1]


def test_the_finer_sphere_of_a_session_follows_as_well_and_is_handed_out_for_reflections_alone():
    lights = [1.0] * 6 + [0.25]
    on, off = (walk(lights, following, has_reflections=True)[-1].estimate for following in (FOLLOWING, None))
    shown = [srgb_to_linear(one.reflected.srgb.astype(float)).mean(axis=1) for one in (on, off)]
    np.testing.assert_array_equal(on.reflected.is_set, off.reflected.is_set)
    stale = on.reflected.is_set & (shown[0] != shown[1])
    assert stale.sum() > 50 and np.median(shown[0][stale] / shown[1][stale]) == pytest.approx(0.25, rel=0.1)
    assert walk(lights, FOLLOWING, has_key_light=True)[-1].estimate.reflected is None


class Silent(LocalBackend):
    """Answers while it is not `lost`."""

    lost = False

    def __init__(self):
        super().__init__(estimators.load("projection", N))
        self.estimate_with_error = self._answer

    def _answer(self, cloud, context=None):
        if self.lost:
            raise NoAnswer("the server does not answer")
        return self.estimator.estimate_with_error(cloud, context)


def after_a_lost_server(n_unanswered):
    """The first estimate after a lamp went down, which had no answer for so many frames of one view."""
    chain = ControllerSettings(TriggerSettings(theta=0.02, ignored_share=0.25), has_reflections=True)
    controller = XiheController(backend := Silent(), chain)
    controller.add_position("Ball", POSITION)
    for i in range(6):
        controller.step(looking(0.25 * np.sin(i), 1.0, i))
    for i in range(n_unanswered + 1):
        backend.lost = i < n_unanswered
        report = controller.step(looking(0.25 * np.sin(6), 0.5, 6 + i))["Ball"]
        assert report.decision.fire and report.estimate.is_valid != backend.lost
    return report.estimate


def test_what_is_out_of_view_follows_a_lamp_once_however_often_the_server_is_asked():
    once, late = (after_a_lost_server(n) for n in (0, 4))
    np.testing.assert_array_equal(late.sh_radiance, once.sh_radiance)
    np.testing.assert_array_equal(late.reflected.srgb, once.reflected.srgb)


def test_what_is_out_of_view_follows_a_lamp_that_changes_while_the_object_is_out_of_view_too():
    """Of frames since the last estimate: the light that they show is used first in the next one."""
    rule = TriggerSettings(theta=0.02, ignored_share=0.25, coverage_theta=0.3)
    lights, known = [], []
    for looked_at in (["Ball"], []):
        chain = ControllerSettings(rule, learns_out_of_view=True)
        controller = XiheController(LocalBackend(estimators.load("projection", N)), chain)
        controller.add_position("Ball", POSITION)
        for number, yaw in enumerate((0.0, 0.3, 0.6, -0.6)):
            controller.step(looking(yaw, 1.0, number), active=["Ball"])
        for number, active in ((4, looked_at), (5, ["Ball"])):
            controller.step(looking(0.1 * number - 0.4, 0.25, number), active=active)
        lights.append(controller.light("Ball").sh_radiance)
        known.append(controller.known("Ball"))
    np.testing.assert_array_equal(known[0].srgb, known[1].srgb)
    assert shc_rmse(*lights) < 1e-3


@pytest.mark.parametrize("out_of_view", [0, 1])
@pytest.mark.parametrize("n_unanswered", [0, 2])
def test_reflections_follow_a_lamp_also_where_they_were_seen_since_the_last_estimate(out_of_view, n_unanswered):
    rule = TriggerSettings(theta=0.02, ignored_share=0.25, coverage_theta=0.3)
    chain = ControllerSettings(rule, has_reflections=True, learns_out_of_view=True)
    controller = XiheController(backend := Silent(), chain)
    controller.add_position("Ball", POSITION)
    for number, yaw in enumerate((0.0, 1.2, 0.6)):
        report = controller.step(looking(yaw, 1.0, number), active=["Ball"])["Ball"]
        assert report.decision.fire == (number == 0)
    for number in range(out_of_view + n_unanswered + 1):
        backend.lost = number < out_of_view + n_unanswered
        active = ["Ball"] if number >= out_of_view else []
        reports = controller.step(looking(0.1, 0.25, number), active=active)
    known, fine = controller.known("Ball"), reports["Ball"].estimate.reflected
    beside = controller.lattice.nearest(controller.fine_lattice.directions)
    shown, expected = (srgb_to_linear(one.astype(float)).mean(axis=1) for one in (fine.srgb, known.srgb[beside]))
    is_known = fine.is_set & known.is_set[beside]
    assert np.median(expected[is_known]) < 0.1  # All of it is dark, but for the rim of the last frame on the finer one.
    assert (shown[is_known] < 0.15).mean() > 0.9


ALL_CHANGED = LightFollowing(smallest_stops=0.25, agreeing_share=0.5, most_unchanged=0.1)


@pytest.mark.parametrize(("unchanged", "is_change"), [(0.0, True), (0.05, True), (0.2, False), (0.4, False)])
def test_where_too_many_surfaces_kept_their_light_it_is_no_change(unchanged, is_change):
    radiance = np.random.default_rng(0).uniform(0.1, 0.4, (N, 3))
    after = np.where(np.arange(N)[:, None] < unchanged * N, radiance, radiance / 4)
    everything = np.ones(N, bool)
    found = light_change(cloud(radiance, everything), cloud(after, everything), ALL_CHANGED)
    assert (found is not None) == is_change


@settings(max_examples=200, deadline=None)
@given(seed=seeds, factor=st.floats(0.1, 8.0), kept=st.floats(0, 0.3), jitter=st.floats(0, 0.5))
@pytest.mark.parametrize("asked", [ALL_CHANGED, FOLLOWING])
def test_asking_encoded_colours_first_gives_no_other_answer(asked, seed, factor, kept, jitter):
    rng = np.random.default_rng(seed)
    radiance = rng.uniform(0.0, 0.6, (N, 3))
    changed = radiance * factor * rng.lognormal(0, jitter, (N, 1))
    after = np.where(rng.random((N, 1)) < kept, radiance, changed)
    old, new = (cloud(light, np.ones(N, bool)) for light in (radiance, after))
    if _cannot_agree(old.srgb, new.srgb, asked):
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("xihenet.light_change._cannot_agree", lambda *_: False)
            assert light_change(old, new, asked) is None
