"""The meter: what it brings to the key, what it protects, and that more light never asks for more exposure."""

import numpy as np
import pytest

from xihenet.camera import encode_exposed
from xihenet.phone.metering import BRIGHTEST_MEAN, BRIGHTEST_SHARE, METERINGS, metered_exposure

EITHER = pytest.mark.parametrize("metering", METERINGS)


def picture(seed):
    """Lit everywhere, over eight decades."""
    return 10 ** np.random.default_rng(seed).uniform(-4, 4, (12, 16, 3))


def room(seed, brightest=1.2):
    """A room whose light spans a few stops, some of it above the white of its key."""
    return np.minimum(0.12 * np.exp(np.random.default_rng(seed).normal(0, 1.0, (48, 64, 3))), brightest)


@EITHER
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("gain", [1e-12, 0.3, 7.0, 1e12])
def test_the_meter_goes_with_the_light(seed, gain, metering):
    twice = metered_exposure([gain * picture(seed)], metering)
    assert twice == pytest.approx(metered_exposure([picture(seed)], metering) / gain, rel=1e-9)


@EITHER
@pytest.mark.parametrize("seed", range(20))
def test_more_light_in_any_pixel_never_asks_for_more_exposure(seed, metering):
    before, rng = picture(seed), np.random.default_rng(seed)
    brighter = before * 10 ** np.where(rng.random((12, 16, 1)) < 0.2, rng.uniform(0, 6, (12, 16, 1)), 0)
    assert metered_exposure([brighter], metering) <= metered_exposure([before], metering) * (1 + 1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_how_far_beyond_white_or_black_light_is_does_not_matter_to_the_key(seed):
    seen = picture(seed)
    exposed = seen @ [0.2126, 0.7152, 0.0722] * metered_exposure([seen], "key")
    beyond = np.where(exposed[..., None] > 1, 1e6 * seen, np.where(exposed[..., None] < 0.005, 1e-6 * seen, seen))
    assert not np.array_equal(beyond, seen)
    assert metered_exposure([beyond], "key") == pytest.approx(metered_exposure([seen], "key"), rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_brightest_pixels_have_the_mean_that_is_allowed_or_less(seed):
    pictures = [room(seed + k, brightest) for k, brightest in enumerate((0.5, 1.5, 3.0))]
    exposure = metered_exposure(pictures)
    for seen in pictures:
        ranked = np.sort(np.minimum(exposure * seen.max(axis=-1), 1.0).ravel())
        assert ranked[-round(BRIGHTEST_SHARE * ranked.size) :].mean() <= BRIGHTEST_MEAN + 1e-9
        assert (encode_exposed(seen, exposure) == 255).any(axis=-1).mean() <= BRIGHTEST_SHARE


def test_the_darkest_exposure_that_any_picture_asks_for_is_taken():
    calm, lamp = room(0, 0.3), room(1, 3.0)
    both = metered_exposure([calm, lamp])
    assert both == pytest.approx(min(metered_exposure([calm]), metered_exposure([lamp])), rel=0.05)


def test_a_dull_picture_is_metered_as_by_its_key():
    dull = room(0, 0.3)
    assert metered_exposure([dull]) == metered_exposure([dull], "key")


def test_a_colour_that_clips_in_one_channel_counts_as_bright():
    seen = np.full((48, 64, 3), 0.05)
    seen[:10] = [0.0, 0.0, 1.0]
    assert metered_exposure([seen]) == pytest.approx(BRIGHTEST_MEAN)


def test_a_lamp_that_is_off_in_one_frame_is_still_protected():
    off, on = np.zeros((48, 64, 3)), room(1, 3.0)
    assert (encode_exposed(on, metered_exposure([off, on])) == 255).any(axis=-1).mean() <= BRIGHTEST_SHARE


def test_another_metering_lists_those_there_are():
    with pytest.raises(ValueError, match="expected one of highlights, key, got 'spot'"):
        metered_exposure([room(0)], "spot")
