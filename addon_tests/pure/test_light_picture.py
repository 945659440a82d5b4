"""Pictures of light: what the three spheres show under light that is known."""

import numpy as np
import pytest
from scipy.integrate import quad

from addon_tests.pure.made import constant
from addon_tests.pure.sh_samples import random_light
from xihenet import sh
from xihenet.colour import linear_to_srgb
from xihenet.light.light_picture import (
    BACKGROUND,
    SILVER_ROUGHNESS,
    light_picture,
    seen_picture,
    silver_lobe,
    sphere_mask,
    sphere_transfer,
    three_spheres,
)
from xihenet.records import UnitSphereCloud
from xihenet.sphere import AnchorLattice

RADIANCE = np.array([0.2, 0.5, 0.8])
MIRROR, SILVER, DIFFUSE = range(3)
SIZE = 33  # odd, so that one pixel is the very centre


def towards(*direction, strength=1.0):
    """Light that comes mostly from one direction, equal in all channels and positive everywhere."""
    light = constant([1.0, 1.0, 1.0])
    light[1:4] += strength * sh.basis([direction])[0, 1:4, None]
    return light


@pytest.mark.parametrize("size", [1, 2, 3, 16, 33])
def test_constant_light_shows_itself_on_all_three_spheres(size):
    shown = three_spheres(constant(RADIANCE), size)
    on_spheres = shown[:, sphere_mask(size)]
    np.testing.assert_allclose(on_spheres, np.broadcast_to(RADIANCE, on_spheres.shape), rtol=1e-12)
    assert not shown[:, ~sphere_mask(size)].any()


def test_the_mirror_shows_what_is_behind_the_camera_at_its_centre_and_what_is_before_it_at_its_rim():
    light = towards(0, 1, 0)
    shown = three_spheres(light, 401)[MIRROR, 200]
    behind, before = sh.basis([(0, -1, 0), (0, 1, 0)]) @ light
    np.testing.assert_allclose(shown[200], behind, rtol=1e-12)
    np.testing.assert_allclose(shown[[0, 400]], [before, before], rtol=0.01)


def test_half_way_to_the_rim_mirror_and_silver_look_sideways():
    # A normal 45 degrees off the view turns the view by 90 degrees: 2 (k + 0.5) / size - 1 = sqrt(1/2).
    light, size = random_light(seed=1), 501
    column = round((1 + np.sqrt(0.5)) * size / 2 - 0.5)
    for sphere, kept in ((MIRROR, [1, 1, 1]), (SILVER, silver_lobe())):
        shown = three_spheres(light, size)[sphere]
        right, top = sh.basis([(1, 0, 0), (0, 0, 1)]) @ (light * np.repeat(kept, [1, 3, 5])[:, None])
        np.testing.assert_allclose(shown[250, column], right, atol=0.02)
        np.testing.assert_allclose(shown[size - 1 - column, 250], top, atol=0.02)


def test_the_diffuse_sphere_shows_irradiance_over_pi():
    light = random_light(seed=2)
    z, x = np.nonzero(sphere_mask(SIZE))
    x, z = (2 * x + 1) / SIZE - 1, 1 - (2 * z + 1) / SIZE
    normals = np.stack([x, -np.sqrt(1 - x**2 - z**2), z], axis=1)
    shown = three_spheres(light, SIZE)[DIFFUSE, sphere_mask(SIZE)]
    np.testing.assert_allclose(shown, sh.irradiance(light, normals) / np.pi, atol=1e-12)


def test_the_lobe_of_the_silver_sphere_is_the_ggx_lobe_integrated_by_another_method():
    alpha_squared = SILVER_ROUGHNESS**4

    def lobe(angle):
        ndf = alpha_squared / (np.pi * (np.cos(angle / 2) ** 2 * (alpha_squared - 1) + 1) ** 2)
        return ndf * np.cos(angle) * np.sin(angle)

    legendre = (lambda c: 1.0, lambda c: c, lambda c: (3 * c * c - 1) / 2)
    bands = [quad(lambda angle, p=p: lobe(angle) * p(np.cos(angle)), 0, np.pi / 2)[0] for p in legendre]
    np.testing.assert_allclose(silver_lobe(), np.array(bands) / bands[0], rtol=1e-7)


@pytest.mark.parametrize("size", [1, 2, 7, 32])
def test_the_transfer_has_a_row_for_each_pixel_of_the_mask_in_row_order(size):
    transfer, light = sphere_transfer(size), random_light(seed=4)
    assert transfer.shape == (3, np.count_nonzero(sphere_mask(size)), 9)
    np.testing.assert_array_equal(three_spheres(light, size)[:, sphere_mask(size)], transfer @ light)
    assert not transfer.flags.writeable


def test_the_mask_is_a_disc_that_fills_the_picture():
    assert sphere_mask(400).mean() == pytest.approx(np.pi / 4, rel=1e-3)
    mask = sphere_mask(31)
    assert mask[15].all() and mask[:, 15].all() and not mask[0, 0]
    np.testing.assert_array_equal(mask, mask[::-1].T)


def test_light_below_zero_is_kept_in_numbers_and_black_in_the_picture():
    light = towards(1, 0, 0, strength=9.0)
    assert three_spheres(light, SIZE).min() < -0.5
    picture = light_picture(light, panorama_height=64)
    panorama = picture[4:68, 4:132]
    assert (panorama[32, 32] == 0).all() and (panorama[32, 96] == 255).all()


@pytest.mark.parametrize(("height", "margin"), [(256, 16), (14, 0), (50, 3)])
def test_the_picture_of_constant_light_is_that_colour_on_the_background_with_equal_margins(height, margin):
    picture = light_picture(constant(RADIANCE), panorama_height=height)
    colour, grey = np.rint(linear_to_srgb(RADIANCE) * 255), round(BACKGROUND * 255)
    size = (2 * height - 2 * margin) // 3
    assert picture.shape == (height + size + 3 * margin, 2 * height + 2 * margin, 3)
    assert picture.dtype == np.uint8
    assert (picture[margin : margin + height, margin : margin + 2 * height] == colour).all()
    below = picture[2 * margin + height :, margin : margin + 2 * height]
    for column in (size // 2, height, 2 * height - 1 - size // 2):
        assert (below[size // 2, column] == colour).all()
    border = np.ones(picture.shape[:2], bool)
    border[margin : border.shape[0] - margin, margin : border.shape[1] - margin] = False
    assert (picture[border] == grey).all()
    if size > 12:
        assert (below[[0, 0, size - 1, size - 1], [0, size - 1, 0, size - 1]] == grey).all(), "beside a sphere"


def test_a_picture_of_what_was_seen_shows_it_in_its_direction_and_grey_elsewhere():
    is_set = AnchorLattice(512).directions[:, 2] > 0
    picture = seen_picture(UnitSphereCloud([0.2, 0.4, 1.0] * is_set[:, None], 2.0 * is_set, is_set), 32)
    assert picture.shape == (32, 64, 3) and picture.dtype == np.uint8
    assert (picture[:14] == [51, 102, 255]).all() and (picture[18:] == round(BACKGROUND * 255)).all()


@pytest.mark.parametrize(
    "light", [np.zeros((4, 3)), np.zeros((9, 4)), np.full((9, 3), np.nan), np.full((9, 3), np.inf)]
)
def test_what_is_no_light_of_order_2_is_refused(light):
    with pytest.raises(ValueError, match="spher"):
        three_spheres(light, 8)
    with pytest.raises(ValueError, match="spher"):
        light_picture(light)


def test_a_picture_without_a_pixel_is_refused():
    with pytest.raises(ValueError, match="at least one pixel"):
        sphere_mask(0)
