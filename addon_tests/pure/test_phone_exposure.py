"""Exposure that follows the light, what is exposed anew, and which frames a phone delivers."""

import numpy as np
import pytest

from addon_tests.pure.made import frame_of
from xihenet.camera import encode_exposed
from xihenet.colour import srgb_to_linear
from xihenet.phone.exposure import AutoExposure, FrameRate, delivered_frames, expose, follow_exposure

AUTO = AutoExposure(source="test", time_constant_s=0.5, darkest_stops=3, brightest_stops=2)
TIMES_S = np.arange(30) / 30


def seen(srgb_u8, exposure=1.0):
    return frame_of(np.ones(srgb_u8.shape[:2]), srgb_u8=srgb_u8, exposure=exposure)


@pytest.mark.parametrize("n", [0.5, 1, 2])
def test_exposure_goes_63_percent_of_the_way_in_each_time_constant(n):
    later = follow_exposure([0, 0, 0.5 * n], [1, 2, 2], reference=1.0, settings=AUTO)[-1]
    assert np.log2(later) == pytest.approx(1 - np.exp(-n))


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
        follow_exposure([0, 0.1], [1.0, wrong], reference=1.0, settings=AUTO)


def test_time_must_go_on():
    with pytest.raises(ValueError, match="expected times that never decrease"):
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
