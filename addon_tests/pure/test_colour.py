"""The sRGB transfer: known values, round trips, clipping."""

import numpy as np

from xihenet.colour import CLIPPED_FROM, linear_to_srgb, srgb_to_linear

RNG_SEED = 11


def test_a_colour_rounded_to_8_bits_is_clipped_as_it_was():
    colours = np.linspace(0.98, 1, 10_001, dtype=np.float32)
    rounded = np.rint(colours * 255) / np.float32(255)
    assert np.array_equal(rounded >= CLIPPED_FROM, colours >= CLIPPED_FROM)


def test_linear_light_survives_a_round_trip():
    light = np.random.default_rng(RNG_SEED).random(5000) ** 4
    # The standard's two thresholds meet to 1e-7 only; within that gap a value may take the other branch back.
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(light)), light, rtol=0, atol=1e-7)


def test_black_mid_grey_and_white_have_their_published_values():
    np.testing.assert_allclose(srgb_to_linear([0.0, 0.04045, 0.5, 1.0]), [0, 0.0031308, 0.21404114, 1], atol=1e-7)


def test_values_outside_0_to_1_are_clipped_and_nan_stays():
    values = np.array([-np.inf, -0.5, 1.5, np.inf, np.nan])
    for transfer in (srgb_to_linear, linear_to_srgb):
        np.testing.assert_allclose(transfer(values), [0, 0, 1, 1, np.nan], atol=1e-15)


def test_integers_and_shapes_are_accepted_and_the_input_is_left_alone():
    codes = np.array([[0, 1]])
    assert srgb_to_linear(codes).tolist() == [[0.0, 1.0]]
    assert linear_to_srgb(srgb_to_linear(np.float32([0.5]))).dtype == np.float32
    assert linear_to_srgb(np.empty((0, 3))).shape == (0, 3)
    values = np.array([2.0, 0.5])
    srgb_to_linear(values)
    assert values.tolist() == [2.0, 0.5]
