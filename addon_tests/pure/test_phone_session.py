"""What has a memory or a clock: exposure, ambient light sensor, frame rate and network."""

import numpy as np
import pytest

from addon_tests.pure.made import frame_of
from xihenet.camera import encode_exposed
from xihenet.colour import LUMINANCE, srgb_to_linear
from xihenet.phone.exposure import AutoExposure, FrameRate, delivered_frames, expose, follow_exposure, step_exposure
from xihenet.phone.light_sensor import (
    LightSensor,
    ambient_of_reading,
    colour_of_temperature,
    colour_temperature_k,
    follow_light,
    read_light,
)
from xihenet.phone.network import LINKS, REFERENCE_PAYLOAD_BYTES, Link, arrival_frames, first_frame_after

AUTO = AutoExposure(source="test", time_constant_s=0.5, darkest_stops=3, brightest_stops=2)
SENSOR = LightSensor(
    source="test", time_constant_s=0.1, gain_error=0.1, noise=0.02, intensity_step=0.0, temperature_step_k=50,
    lowest_k=2000, highest_k=10000,
)  # fmt: skip
TIMES_S = np.arange(30) / 30


def seen(srgb_u8, exposure=1.0):
    return frame_of(np.ones(srgb_u8.shape[:2]), srgb_u8=srgb_u8, exposure=exposure)


def test_exposure_goes_63_percent_of_the_way_in_one_time_constant():
    later = step_exposure(1.0, 2.0, 0.5, reference=1.0, settings=AUTO)
    assert np.log2(later) == pytest.approx(1 - np.exp(-1))


def test_two_short_steps_are_one_long_step():
    half = step_exposure(1.0, 3.0, 0.1, reference=1.0, settings=AUTO)
    assert step_exposure(half, 3.0, 0.1, reference=1.0, settings=AUTO) == pytest.approx(
        step_exposure(1.0, 3.0, 0.2, reference=1.0, settings=AUTO)
    )


def test_exposure_stays_within_its_clamps():
    exposures = follow_exposure([0, 100, 200, 300], [1, 1e-6, 1e6, 1e6], reference=1.0, settings=AUTO)
    np.testing.assert_allclose(exposures, [1, 1, 2.0**-3, 2.0**2], rtol=1e-9)


def test_exposure_lags_and_never_looks_ahead():
    metered = np.where(np.arange(30) < 10, 1.0, 0.25)
    exposures = follow_exposure(TIMES_S, metered, reference=1.0, settings=AUTO)
    assert (exposures[:11] == 1).all() and exposures[11] < 1
    assert (np.diff(exposures[10:]) < 0).all() and exposures[-1] > 0.25
    shorter = follow_exposure(TIMES_S[:20], metered[:20], reference=1.0, settings=AUTO)
    np.testing.assert_array_equal(shorter, exposures[:20])


def test_no_time_constant_follows_at_once_one_frame_late():
    at_once = AutoExposure(source="test", time_constant_s=0, darkest_stops=9, brightest_stops=9)
    exposures = follow_exposure([0, 1, 2], [1, 3, 5], reference=1.0, settings=at_once)
    np.testing.assert_allclose(exposures, [1, 1, 3])


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf])
def test_an_exposure_that_is_no_positive_number_is_refused(wrong):
    with pytest.raises(ValueError, match="expected positive exposures"):
        step_exposure(1.0, wrong, 0.1, reference=1.0, settings=AUTO)


def test_time_must_go_on():
    with pytest.raises(ValueError, match="expected time to go on"):
        follow_exposure([1, 0], [1, 1], reference=1.0, settings=AUTO)
    with pytest.raises(ValueError, match="as many times as meterings"):
        follow_exposure([1, 0], [1], reference=1.0, settings=AUTO)


def test_exposing_from_radiance_is_the_frames_own_encoding():
    radiance = np.random.default_rng(0).uniform(0, 3, (5, 6, 3)).astype(np.float32)
    exposed = expose(seen(encode_exposed(radiance, 0.5), 0.5), 0.2, radiance)
    assert exposed.exposure == 0.2
    np.testing.assert_array_equal(exposed.srgb_u8, encode_exposed(radiance, 0.2))


def test_exposing_from_bytes_scales_light_and_keeps_what_was_clipped():
    every_byte = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
    exposed = expose(seen(every_byte), 0.5)
    expected = srgb_to_linear(every_byte / 255.0) * 0.5
    assert np.abs(srgb_to_linear(exposed.srgb_u8 / 255.0) - expected).max() < 0.003
    assert exposed.srgb_u8[0, 255, 0] == 188


def test_the_same_exposure_gives_the_frame_itself():
    frame = seen(np.zeros((1, 1, 3), np.uint8), 0.3)
    assert expose(frame, 0.3) is frame


def test_daylight_is_white_and_warmer_light_is_redder():
    np.testing.assert_allclose(colour_of_temperature(6504), [1, 1, 1], rtol=1e-9)
    assert colour_temperature_k([1, 1, 1]) == pytest.approx(6504, rel=0.001)
    reds = [colour_of_temperature(k)[0] / colour_of_temperature(k)[2] for k in (2000, 3000, 5000, 8000)]
    assert reds == sorted(reds, reverse=True)


@pytest.mark.parametrize("kelvin", [2000, 2700, 3500, 4000, 5000, 6500, 8000, 10000])
def test_a_colour_temperature_comes_back_from_its_colour(kelvin):
    colour = colour_of_temperature(kelvin)
    assert LUMINANCE @ colour == pytest.approx(1)
    assert colour_temperature_k(colour) == pytest.approx(kelvin, rel=0.045)


@pytest.mark.parametrize("light", [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0, 1, 0], [1e-30, 0, 0], [1e30, 1e30, 0]])
def test_any_light_has_a_finite_reading(light):
    reading = read_light(light, SENSOR, device_rng=np.random.default_rng(0), rng=np.random.default_rng(1))
    assert 2000 <= reading.temperature_k <= 10000
    assert np.isfinite(ambient_of_reading(reading)).all() and (ambient_of_reading(reading) >= 0).all()


def test_readings_of_one_device_have_the_stated_noise_around_its_own_gain():
    readings = [
        read_light([2, 2, 2], SENSOR, device_rng=np.random.default_rng(5), rng=np.random.default_rng([5, i])).intensity
        for i in range(4000)
    ]
    gain = np.mean(readings) / 2
    assert np.std(readings) / np.mean(readings) == pytest.approx(0.02, rel=0.05)
    assert 0.9 <= gain <= 1.1 and abs(gain - 1) > 0.003


def test_gains_of_many_devices_fill_the_stated_band():
    silent = LightSensor(**{**vars(SENSOR), "noise": 0.0})
    gains = np.array([
        read_light([1, 1, 1], silent, device_rng=np.random.default_rng(seed), rng=np.random.default_rng(0)).intensity
        for seed in range(2000)
    ])  # fmt: skip
    assert gains.min() >= 0.9 and gains.max() <= 1.1
    assert gains.std() == pytest.approx(0.1 / np.sqrt(3), rel=0.05)


def test_the_tint_is_lost_and_the_intensity_kept():
    exact = LightSensor(**{**vars(SENSOR), "noise": 0.0, "gain_error": 0.0, "temperature_step_k": 0.0})
    rng = np.random.default_rng(0)
    rebuilt = ambient_of_reading(read_light([0.8, 1.2, 0.8], exact, device_rng=rng, rng=rng))
    assert LUMINANCE @ rebuilt == pytest.approx(LUMINANCE @ np.array([0.8, 1.2, 0.8]))
    assert abs(rebuilt[1] / rebuilt[[0, 2]].mean() - 1) < 0.1


def test_readings_come_in_steps():
    stepped = LightSensor(**{**vars(SENSOR), "intensity_step": 0.1})
    readings = [
        read_light([v, v, v], stepped, device_rng=np.random.default_rng(0), rng=np.random.default_rng(0))
        for v in np.linspace(1, 2, 200)
    ]
    values = np.unique([r.intensity for r in readings])
    np.testing.assert_allclose(values[1:] / values[:-1], 1.1)
    assert all(r.temperature_k % 50 == 0 for r in readings)


def test_the_light_sensor_lags_and_never_looks_ahead():
    light = np.where(TIMES_S[:, None] < 0.5, [1.0, 1, 1], [2.0, 2, 2])
    collected = follow_light(TIMES_S, light, SENSOR)
    assert collected[15, 0] == pytest.approx(2 - np.exp(-(1 / 30) / 0.1))
    np.testing.assert_array_equal(follow_light(TIMES_S[:18], light[:18], SENSOR), collected[:18])
    with pytest.raises(ValueError, match="expected light of shape"):
        follow_light(TIMES_S, light[:3], SENSOR)


@pytest.mark.parametrize(("scene_hz", "phone_hz", "share"), [(24, 60, 1), (60, 60, 1), (60, 30, 0.5), (120, 40, 1 / 3)])
def test_a_phone_delivers_its_own_frame_rate(scene_hz, phone_hz, share):
    is_delivered = delivered_frames(
        0.7 + np.arange(1200) / scene_hz, FrameRate(source="test", rate_hz=phone_hz, width_px=1)
    )
    assert is_delivered[0]
    assert is_delivered.mean() == pytest.approx(share, abs=0.002)


@pytest.mark.parametrize("rate_hz", [30, 60])
def test_times_since_1970_lose_no_frame_to_their_rounding(rate_hz):
    times_s = 1.7e9 + np.arange(600) / rate_hz
    assert delivered_frames(times_s, FrameRate(source="test", rate_hz=rate_hz, width_px=1)).all()


def test_without_a_frame_rate_every_frame_is_delivered():
    assert delivered_frames([0, 0, 0], None).all()
    assert delivered_frames([], FrameRate(source="test", rate_hz=1, width_px=1)).shape == (0,)


@pytest.mark.parametrize(("name", "end_to_end_ms"), [("wifi", 20.67), ("home", 37.27), ("lte", 79.17)])
def test_links_have_the_papers_median_end_to_end(name, end_to_end_ms):
    arrivals = arrival_frames(np.zeros(20000), REFERENCE_PAYLOAD_BYTES, LINKS[name], np.random.default_rng(1))
    assert 1e3 * np.median(arrivals) == pytest.approx(end_to_end_ms, rel=0.02)
    assert arrivals.min() >= LINKS[name].processing_s + LINKS[name].floor_s


def test_four_positions_cost_the_papers_128_percent_of_network_time():
    link, n = LINKS["wifi"], np.zeros(20000)
    one, four = (
        np.median(arrival_frames(n, k * 4249, link, np.random.default_rng(2))) - link.processing_s for k in (1, 4)
    )
    assert four / one == pytest.approx(1.28, rel=0.02)


def lossy(loss, n_sends=3):
    return Link(source="test", processing_s=0.01, median_s=0.02, floor_s=0.01, spread=0.2, uplink_bit_per_s=1e7,
                loss=loss, resend_s=0.2, n_sends=n_sends)  # fmt: skip


def test_lost_requests_come_late_or_never_in_the_stated_shares():
    arrivals = arrival_frames(np.zeros(40000), 100, lossy(0.3), np.random.default_rng(3))
    assert np.isinf(arrivals).mean() == pytest.approx(0.3**3, rel=0.1)
    late = (arrivals > 0.2) & (arrivals < 0.4)
    assert late.mean() == pytest.approx(0.3 * 0.7, rel=0.03)


def test_a_link_that_loses_all_delivers_nothing_and_one_that_loses_none_delivers_all():
    assert np.isinf(arrival_frames([0, 1], 100, lossy(1.0), np.random.default_rng(0))).all()
    assert np.isfinite(arrival_frames(np.zeros(999), 100, lossy(0.0), np.random.default_rng(0))).all()


def test_arrivals_are_seeded_and_shift_with_their_triggers():
    triggers = np.array([0.5, 0.1, 3.0])
    first, again = (arrival_frames(triggers, 100, lossy(0.3), np.random.default_rng(4)) for _ in range(2))
    later = arrival_frames(triggers + 10, 100, lossy(0.3), np.random.default_rng(4))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(later, first + 10)


def test_a_phone_that_estimates_itself_waits_for_nothing():
    np.testing.assert_array_equal(arrival_frames([0.0, 2.0], 100, None, np.random.default_rng(0)), [0.0, 2.0])
    assert arrival_frames([], 100, lossy(0.1), np.random.default_rng(0)).shape == (0,)


def test_negative_payloads_are_refused():
    with pytest.raises(ValueError, match="0 or more bytes"):
        arrival_frames([0.0], -1, lossy(0.1), np.random.default_rng(0))


def test_an_estimate_lights_the_first_frame_at_or_after_its_arrival():
    assert first_frame_after([0.0, 0.01, 0.1, 0.11, np.inf], [0.0, 0.1, 0.2]).tolist() == [0, 1, 1, 2, 3]


def test_a_link_faster_than_its_floor_is_refused():
    with pytest.raises(ValueError, match="floor_s: expected at most median_s"):
        Link(**{**vars(lossy(0.1)), "floor_s": 0.5})
    with pytest.raises(ValueError, match="n_sends: expected a whole number"):
        Link(**{**vars(lossy(0.1)), "n_sends": 1.5})
