"""The satin ball as spherical harmonics: a factor for each band, and errors that see what order 2 cannot hold."""

import numpy as np
import pytest

from xihenet.satin_ball import (
    HALF_ANGLE,
    SatinBall,
    cone_factors,
    mean_square,
    satin_factors,
    satin_of_cones,
    satin_picture,
)
from xihenet.sh import irradiance
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

EVENLY_SPREAD = AnchorLattice(20_000).directions


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_half_of_the_ball_is_matte_and_half_shows_the_mean_of_the_light_within_its_cone(rng):
    light, directions = rng.normal(size=(81, 3)), EVENLY_SPREAD
    radiance, towards = basis(directions, 8) @ light, np.array([[0.36, -0.48, 0.8]])
    in_cone = directions @ towards[0] > np.cos(HALF_ANGLE)
    shown = basis(towards, 8) @ satin_picture(light)
    expected = (irradiance(light, towards)[0] / np.pi + radiance[in_cone].mean(axis=0)) / 2
    np.testing.assert_allclose(shown[0], expected, atol=0.02)


def test_constant_light_is_shown_as_it_is_and_high_bands_fade():
    factors = satin_factors(8)
    assert factors[0] == 1 and (np.abs(factors[5:]) < 0.08).all()
    assert (factors[:5] > 0).all() and (np.diff(factors[:6]) < 0).all()


def test_means_over_cones_tell_what_the_ball_shows(rng):
    light = rng.normal(size=(81, 3))
    cones = light * np.repeat(cone_factors(8), 2 * np.arange(9) + 1)[:, None]
    np.testing.assert_allclose(satin_of_cones(cones), satin_picture(light))


def test_the_mean_square_is_that_over_all_directions(rng):
    picture = rng.normal(size=(25, 3))
    assert mean_square(picture) == pytest.approx(np.mean((basis(EVENLY_SPREAD, 4) @ picture) ** 2), rel=1e-3)


def test_the_true_light_leaves_nothing_but_what_order_2_cannot_hold(rng):
    light = rng.normal(size=(81, 3))
    ball = SatinBall(satin_picture(light))
    np.testing.assert_allclose(ball.light, light[:9])
    assert ball.squared_error(light[:9]) == pytest.approx(mean_square(satin_picture(light)[9:]))
    assert ball.squared_error(light[:9], has_all_orders=True) == pytest.approx(0)


def test_noise_is_no_light_of_a_higher_order(rng):
    picture = np.zeros((81, 3))
    picture[0], picture[9:] = 1, rng.normal(size=(72, 3))
    assert SatinBall(picture, noise_beyond=1.1 * mean_square(picture[9:])).beyond_order_2 == 0


@pytest.mark.parametrize(
    ("picture", "noise", "said"),
    [
        (np.zeros((4, 3)), 0.0, "order 2 or more, got order 1"),
        (np.zeros((9, 3)), -1.0, "noise of 0 or more"),
        (np.full((9, 3), np.nan), 0.0, "finite coefficients"),
    ],
)
def test_what_is_no_ball_is_refused(picture, noise, said):
    with pytest.raises(ValueError, match=said):
        SatinBall(picture, noise)
