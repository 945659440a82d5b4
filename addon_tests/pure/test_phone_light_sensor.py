"""The ambient light sensor: its colour temperatures, its errors, and that it lags."""

import numpy as np
import pytest

from xihenet.colour import LUMINANCE
from xihenet.phone.light_sensor import (
    LightSensor,
    ambient_of_reading,
    colour_of_temperature,
    colour_temperature_k,
    follow_light,
    read_light,
)

SENSOR = LightSensor(
    source="test", time_constant_s=0.1, gain_error=0.1, noise=0.02, intensity_step=0.0, temperature_step_k=50,
    lowest_k=2000, highest_k=10000,
)  # fmt: skip
TIMES_S = np.arange(30) / 30


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
