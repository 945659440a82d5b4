"""Light between estimates: it follows the room, is never applied twice, and neither drifts nor decays."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from addon_tests.pure.test_light_change import POSITION, looking
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.camera import sensed_ambient
from xihenet.colour import LUMINANCE, linear_to_srgb
from xihenet.controller import ControllerSettings, XiheController
from xihenet.light.carried_light import BLEND_S, MOST_GAIN, CarriedLight, blended
from xihenet.metrics import shc_rmse
from xihenet.phone import LINKS, EstimatesUnderWay
from xihenet.records import AnchorSurfaces, KeyLight, LightEstimate, ObjectLight, UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings

N = 128
DIRECTIONS = AnchorLattice(N).directions
RARELY = TriggerSettings(theta=0.9, coverage_theta=0.9)
"""After the first estimate this never fires: all that follows is carried."""

RED_DOWN = np.array([0.5, 0.8, 1.2])


def room(seed=0):
    return np.random.default_rng(seed).uniform(0.05, 0.4, (N, 3))


def picture(radiance, light=1.0, *, noise=0.0, rng=None):
    """What a frame shows of `radiance` under `light`, in 8 bits."""
    shown = radiance * light * (1 + noise * rng.normal(size=radiance.shape) if noise else 1)
    codes = np.rint(255 * linear_to_srgb(np.clip(shown, 0, 1))) / 255
    return UnitSphereCloud(codes, np.full(N, 2.0), np.ones(N, bool))


def estimate_of(number=0.3, **more):
    return LightEstimate(np.full((9, 3), float(number)), 1.0, 0.5, "none", **more)


def gains_under(lights, *, noise=0.0, seed=0):
    """Of an estimate of the first frame, after each of the others."""
    rng, radiance = np.random.default_rng(seed), room(seed)
    shown = [picture(radiance, light, noise=noise, rng=rng) for light in lights]
    light = CarriedLight(estimate_of(seen=shown[0]))
    for before, now in pairwise(shown):
        light = light.after(now, before, DIRECTIONS)
        yield light.gain


@pytest.mark.parametrize("seed", range(3))
def test_under_constant_light_the_gain_is_1_to_the_last_bit_whatever_the_noise(seed):
    assert all((gain == 1).all() for gain in gains_under([1.0] * 300, noise=0.1, seed=seed))


@pytest.mark.parametrize("light", [0.5 * np.ones(3), 1.8 * np.ones(3), RED_DOWN])
def test_the_light_follows_a_lamp_in_intensity_and_colour_and_comes_back(light):
    *_, before, _, _, down, back = gains_under([np.ones(3)] * 4 + [light] * 3 + [np.ones(3)], noise=0.03)
    np.testing.assert_array_equal(before, 1)
    np.testing.assert_allclose(down, np.broadcast_to(light, 3), rtol=0.03)
    np.testing.assert_allclose(back, 1, rtol=0.03)


@pytest.mark.slow
def test_10_000_frames_of_a_lamp_that_is_switched_400_times_do_not_drift():
    lights = np.where(np.arange(10_000) // 25 % 2, 0.4, 1.0)
    shown = {}
    for light in (0.4, 1.0):
        shown[light] = [picture(room(), light, noise=0.03, rng=np.random.default_rng(i)) for i in range(7)]
    carried, before, gains = CarriedLight(estimate_of(seen=shown[1.0][0])), None, []
    for i, light in enumerate(lights):
        now = shown[light][i % 7]
        carried, before = carried.after(now, before, DIRECTIONS), now
        gains.append(carried.gain)
    np.testing.assert_allclose(gains, lights[:, None] * np.ones(3), rtol=0.03)
    np.testing.assert_allclose(gains[-100:], gains[100:200], rtol=0.02)


def test_it_is_the_estimate_that_is_carried_and_not_what_was_shown_before():
    key = KeyLight(np.array([0.0, 0, 1]), np.ones(3), 0.1, True)
    estimate = estimate_of(1, key=key, others={"x": np.ones((9, 3))}, other_keys={"x": key}, expected_error=0.1)
    carried = CarriedLight(estimate, RED_DOWN)
    for shown in (carried.light, carried.light):
        np.testing.assert_array_equal(shown.sh_radiance, np.tile(RED_DOWN, (9, 1)))
        np.testing.assert_array_equal(shown.others["x"], shown.sh_radiance)
        np.testing.assert_array_equal([shown.key.irradiance, shown.other_keys["x"].irradiance], [RED_DOWN, RED_DOWN])
        assert shown.expected_error == pytest.approx(0.1 * LUMINANCE @ RED_DOWN)
    assert CarriedLight(estimate).light is estimate


def test_a_channel_that_stays_does_not_keep_the_others_from_being_carried():
    gain, seen = np.array([1.0, 0.5, 2.0]), picture(room())
    carried = CarriedLight(estimate_of(seen=seen), gain)
    np.testing.assert_array_equal(carried.light.sh_radiance, carried.estimate.sh_radiance * gain)
    dimmed = picture(room(), 0.5 * gain)
    np.testing.assert_allclose(carried.after(dimmed, None, DIRECTIONS).gain, 0.5 * gain, rtol=0.03)


def test_an_estimate_of_the_dark_is_not_blown_up():
    *_, gain = gains_under([0.05, 3.0, 3.0])
    assert (gain <= MOST_GAIN).all()


def test_after_its_position_moved_a_light_stays_as_it_is():
    shown, darker = picture(room()), picture(room(), 0.5)
    light = CarriedLight(estimate_of(seen=shown)).after(darker, shown, DIRECTIONS).moved()
    np.testing.assert_array_equal(light.after(shown, None, DIRECTIONS).gain, light.gain)


def test_where_little_is_seen_again_only_a_switched_lamp_counts():
    elsewhere = [picture(room(seed=5), light) for light in (1.0, 0.95, 0.4)]
    far = [replace(one, distance_m=one.distance_m * 2) for one in elsewhere]
    light = CarriedLight(estimate_of(seen=picture(room())))
    slowly = light.after(far[0], None, DIRECTIONS).after(far[1], far[0], DIRECTIONS)
    np.testing.assert_array_equal(slowly.gain, 1)
    np.testing.assert_allclose(slowly.after(far[2], far[1], DIRECTIONS).gain, 0.4 / 0.95, rtol=0.03)


def test_surfaces_that_are_seen_under_another_angle_are_not_asked():
    def seen(light, is_turned):
        surfaces = AnchorSurfaces(np.zeros(N), np.ones(N), np.where(is_turned[:, None], [1, 0, 0], [0, 0, 1]))
        return replace(picture(room(), np.where(is_turned, 1, light)[:, None]), surfaces=surfaces)

    base, now = seen(1.0, np.zeros(N, bool)), seen(0.5, np.arange(N) % 3 > 0)
    np.testing.assert_allclose(CarriedLight(estimate_of(seen=base)).after(now, None, DIRECTIONS).gain, 0.5, rtol=0.03)


@pytest.mark.parametrize(("colour", "nearness"), [(1.0, 1.0), (0.0, 1.0), (0.4, 1.1), (0.4, 0.9)])
@pytest.mark.parametrize(("one_in", "gain"), [(3, 0.5), (5, 1.0)])
def test_surfaces_that_are_clipped_or_dark_and_other_surfaces_are_not_asked_nor_a_fifth_alone(
    colour, nearness, one_in, gain
):
    is_odd = np.arange(N) % one_in > 0
    base, now = (
        replace(one, srgb=np.where(is_odd[:, None], np.float32(colour), one.srgb))
        for one in (picture(room()), picture(room(), 0.5))
    )
    now = replace(now, distance_m=now.distance_m * np.where(is_odd, np.float32(nearness), 1))
    np.testing.assert_allclose(CarriedLight(estimate_of(seen=base)).after(now, None, DIRECTIONS).gain, gain, rtol=0.03)


# ------------------------------------------------------------------------------------------------------------ sessions


def session(between="carried", trigger=RARELY, **more):
    chain = ControllerSettings(trigger, following=None, between_estimates=between, **more)
    controller = XiheController(LocalBackend(estimators.load("projection", 512)), chain)
    controller.add_position("Ball", POSITION)
    return controller


def walk(controller, lights, yaws):
    """The light in use after each frame."""
    for i, (light, yaw) in enumerate(zip(lights, yaws, strict=True)):
        controller.step(looking(yaw, light, i), active=["Ball"])
        yield controller.light("Ball")


def test_between_estimates_carried_light_is_nearer_to_the_room_than_kept_light():
    lights = 2 ** -np.linspace(0, 1.5, 16)
    yaws = 0.05 * np.sin(np.arange(16))
    kept, on = (list(walk(session(between), lights, yaws)) for between in ("kept", "carried"))
    truth = list(walk(session("kept", TriggerSettings(theta=0, coverage_theta=0)), lights, yaws))
    errors = [[shc_rmse(a.sh_radiance, b.sh_radiance) for a, b in zip(one, truth, strict=True)] for one in (kept, on)]
    np.testing.assert_array_equal(kept[-1].sh_radiance, kept[0].sh_radiance)
    assert max(errors[1]) < 0.1 * max(errors[0])


def test_a_phone_that_looks_around_sees_another_mean_but_the_same_light():
    controller, yaws = session(), 0.8 * np.sin(np.arange(60) / 8)
    shown = np.array([light.sh_radiance for light in walk(controller, np.ones(60), yaws)])
    sensed = [sensed_ambient(looking(yaw, 1.0, i).srgb_u8, 1.0)[0] for i, yaw in enumerate(yaws)]
    assert max(sensed) / min(sensed) > 1.02
    np.testing.assert_array_equal(shown, np.broadcast_to(shown[0], shown.shape))


def test_a_position_out_of_view_costs_nothing_and_goes_on_where_it_is_seen_again():
    controller = session()
    controller.step(looking(0.0, 1.0, 0), active=["Ball"])
    before = controller.light("Ball")
    for i in range(1, 5):
        assert controller.step(looking(0.0, 0.5, i), active=[]) == {} and controller.out_of_view_ms == {}
        np.testing.assert_array_equal(controller.light("Ball").sh_radiance, before.sh_radiance)
    report = controller.step(looking(0.0, 0.5, 5), active=["Ball"])["Ball"]
    assert report.estimate is None
    np.testing.assert_allclose(controller.light("Ball").sh_radiance, 0.5 * before.sh_radiance, rtol=0.02)


def test_where_positions_learn_out_of_view_their_light_goes_on():
    controller = session(learns_out_of_view=True)
    controller.step(looking(0.0, 1.0, 0), active=["Ball"])
    controller.step(looking(0.0, 0.5, 1), active=[])
    np.testing.assert_allclose(controller.gain("Ball"), 0.5, rtol=0.02)


def test_kept_light_is_the_same_to_the_last_bit_as_that_of_each_estimate():
    trigger = TriggerSettings(theta=0.001, ignored_share=0.25)
    lights, yaws = 2 ** np.sin(np.arange(12)), np.zeros(12)
    controller, last = session("kept", trigger), None
    for i, (light, yaw) in enumerate(zip(lights, yaws, strict=True)):
        estimate = controller.step(looking(yaw, light, i), active=["Ball"])["Ball"].estimate
        last = last if estimate is None else estimate
        assert (controller.gain("Ball") == 1).all()
        np.testing.assert_array_equal(controller.light("Ball").sh_radiance, last.sh_radiance)


def test_in_the_frame_of_an_estimate_nothing_is_carried():
    controller = session(trigger=TriggerSettings(theta=0, coverage_theta=0))
    for i, light in enumerate((1.0, 0.3, 0.7)):
        estimate = controller.step(looking(0.0, light, i), active=["Ball"])["Ball"].estimate
        np.testing.assert_array_equal(controller.light("Ball").sh_radiance, estimate.sh_radiance)


@pytest.mark.parametrize(
    "wrong", [{"between_estimates": "faded"}, *({"reference_exposure": factor} for factor in (0, -1, np.nan, np.inf))]
)
def test_a_session_that_makes_no_sense_is_refused_before_its_first_frame(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ControllerSettings(**wrong)


# -------------------------------------------------------------------------------------------------------- late answers


@pytest.mark.parametrize("seed", range(5))
def test_shares_add_up_to_1_begin_at_0_and_end_at_the_youngest_alone(seed):
    under_way, blend_s = EstimatesUnderWay(LINKS["lte"], seed), 0.2
    for i in range(10):
        under_way.ask("Ball", estimate_of(i), frame=i, asked_s=i / 10, payload_bytes=0)
    assert under_way.shares("Ball", 0.0, blend_s) == []
    times, shown = np.arange(0.2, 4, 1e-3), []
    for t in times:
        shares = under_way.shares("Ball", t, blend_s)
        assert sum(share for share, _ in shares) == pytest.approx(1) and min(share for share, _ in shares) > 0
        shown.append(sum(share * one.estimate.sh_radiance[0, 0] for share, one in shares))
    # Ten estimates differ by 1 each; two or three may be on their way in at once.
    assert np.abs(np.diff(shown)).max() < 0.05
    assert under_way.shares("Ball", 3.9, blend_s) == [(1.0, under_way.in_use("Ball", 3.9))]


def test_an_estimate_that_arrives_in_its_own_frame_is_there_at_once():
    under_way = EstimatesUnderWay(None, 0)
    for i in range(3):
        under_way.ask("Ball", estimate_of(i), frame=i, asked_s=i / 10, payload_bytes=0)
    ((share, one),) = under_way.shares("Ball", 0.2, 0.2)
    assert share == 1 and one.frame == 2


def test_a_blend_of_the_same_light_is_that_light():
    key = KeyLight(np.array([0.0, 0, 1]), np.full(3, 0.2), 0.1, True)
    light = ObjectLight(np.random.default_rng(0).uniform(0.5, 1, (9, 3)), key)
    both = blended([(0.3, light), (0.7, light)])
    np.testing.assert_allclose(both.sh, light.sh)
    np.testing.assert_allclose(both.key.irradiance, key.irradiance)
    assert blended([(1.0, light)]) is light


def test_a_late_estimate_of_a_dimming_lamp_comes_in_without_a_jump():
    """The lamp dims all the time, and each estimate is of a frame some 80 ms ago."""
    lights, trigger = 2 ** -np.linspace(0, 2, 60), TriggerSettings(theta=0.001, ignored_share=0.25)
    controller, under_way, kept, on = session(trigger=trigger), EstimatesUnderWay(LINKS["lte"], 0), [], []
    going_on, before = {}, None
    for i, light in enumerate(lights):
        report = controller.step(looking(0.0, light, i), active=["Ball"])["Ball"]
        now, directions = controller.seen("Ball"), controller.lattice.directions
        going_on, before = {frame: one.after(now, before, directions) for frame, one in going_on.items()}, now
        if report.estimate is not None:
            under_way.ask("Ball", report.estimate, frame=i, asked_s=i / 30, payload_bytes=4249)
            going_on[i] = CarriedLight(report.estimate)
        last = under_way.in_use("Ball", i / 30)
        if last is not None:
            shares = under_way.shares("Ball", i / 30, BLEND_S)
            parts = [(share, ObjectLight(going_on[one.frame].light.sh_radiance)) for share, one in shares]
            kept.append(last.estimate.sh_radiance[0, 0] / light)
            on.append(blended(parts).sh[0, 0] / light)
    kept, on = np.array(kept) / np.mean(on), np.array(on) / np.mean(on)
    assert len(on) > 50
    assert np.abs(on - 1).max() < 0.05 < 0.1 < np.abs(kept - 1).max()
