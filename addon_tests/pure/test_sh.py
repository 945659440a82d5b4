"""Spherical harmonics: against SciPy, against plain integration, and by what must not change when the room turns."""

import numpy as np
import pytest
import scipy.special

from addon_tests.pure.sh_samples import (
    CONSTANT,
    F64,
    LATTICE,
    Lattice,
    cap,
    cloud_of,
    distant_light,
    random_directions,
    random_light,
    windowed,
)
from xihenet.colour import srgb_to_linear
from xihenet.panorama import evaluate_panorama, panorama_directions, solid_angles
from xihenet.records import UnitSphereCloud
from xihenet.sh import basis, cosine_lobe, dering, dering_with_strength, irradiance, project_anchors, rotate


def scipy_basis(directions: F64, order: int) -> F64:
    """The same basis from SciPy's complex one, whose sign (-1)^m is taken back."""
    polar = np.arccos(np.clip(directions[:, 2], -1, 1))
    azimuth = np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for band in range(order + 1):
        for m in range(-band, band + 1):
            if hasattr(scipy.special, "sph_harm_y"):
                value = scipy.special.sph_harm_y(band, abs(m), polar, azimuth)
            else:
                value = scipy.special.sph_harm(abs(m), band, azimuth, polar)
            part = value.real if m >= 0 else value.imag
            columns.append((-1) ** m * part * (np.sqrt(2) if m else 1))
    return np.stack(columns, axis=1)


def test_basis_equals_scipy_to_order_10_poles_and_seam_included():
    special = np.concatenate([np.eye(3), -np.eye(3), [[-1, 1e-12, 0], [-1, -1e-12, 0], [1e-9, 0, 1], [0, 1e-9, -1]]])
    directions = np.concatenate([random_directions(2000), special])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(basis(directions, 10), scipy_basis(directions, 10), rtol=0, atol=1e-7)
    # SciPy goes through an arc cosine, which loses half the digits at the poles; away from them both agree fully.
    away = directions[np.abs(directions[:, 2]) < 0.999]
    np.testing.assert_allclose(basis(away, 10), scipy_basis(away, 10), rtol=0, atol=2e-13)


@pytest.mark.parametrize("length", [5e-324, 1e-300, 1e-20, 7.0, 1e200, 1e308])
def test_the_length_of_a_direction_does_not_matter(length):
    axis = np.array([[0.0, -1.0, 0.0]])
    np.testing.assert_array_equal(basis(axis * length, 4), basis(axis, 4))
    if 1e-300 <= length <= 1e200:
        directions = random_directions(20)
        np.testing.assert_allclose(basis(directions * length, 4), basis(directions, 4), atol=1e-14)


def test_directions_of_another_shape_are_refused_and_none_are_legal():
    with pytest.raises(ValueError, match=r"\(P, 3\), got \(3,\)"):
        basis(np.ones(3))
    assert basis(np.empty((0, 3)), 3).shape == (0, 16)


@pytest.mark.parametrize("n_anchors", [1, 2, 5, 64, 1280])
@pytest.mark.parametrize("coverage", [0.0, 0.05, 0.3, 0.8, 1.0])
@pytest.mark.parametrize("order", [0, 2, 4])
def test_constant_light_stays_constant_at_any_coverage(n_anchors, coverage, order):
    lattice = Lattice(n_anchors)
    srgb = np.array([0.1, 0.735, 1.0], np.float32)
    is_set = cap(lattice, coverage)
    cloud = UnitSphereCloud(np.where(is_set[:, None], srgb, 0), is_set.astype(np.float32), is_set)
    expected = np.zeros(((order + 1) ** 2, 3))
    expected[0] = CONSTANT * srgb_to_linear(srgb.astype(float))
    np.testing.assert_allclose(project_anchors(cloud, lattice, order), expected, rtol=0, atol=1e-12)


def test_more_coverage_brings_the_fit_nearer():
    radiance = np.repeat((LATTICE.directions @ [0.48, 0.6, 0.64] > 0.3)[:, None] * 0.8 + 0.1, 3, axis=1)
    truth = project_anchors(cloud_of(radiance, np.ones(1280, bool)), LATTICE)
    errors = [
        np.sqrt(np.mean((project_anchors(cloud_of(radiance, cap(LATTICE, share)), LATTICE) - truth) ** 2))
        for share in (0.05, 0.4, 0.7, 0.95, 1.0)
    ]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == 0


def test_channels_do_not_mix_and_distances_do_not_matter():
    rng = np.random.default_rng(8)
    radiance, is_set = rng.random((1280, 3)), rng.random(1280) < 0.4
    cloud = cloud_of(radiance, is_set)
    swapped = project_anchors(cloud_of(radiance[:, ::-1], is_set), LATTICE)
    np.testing.assert_allclose(swapped[:, ::-1], project_anchors(cloud, LATTICE), atol=1e-14)
    far = UnitSphereCloud(cloud.srgb, cloud.distance_m * 40, is_set)
    np.testing.assert_array_equal(project_anchors(far, LATTICE), project_anchors(cloud, LATTICE))


def test_higher_bands_are_trusted_less_in_a_small_view():
    power = np.zeros(9)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        is_set = cap(LATTICE, 0.1, tuple(rng.normal(size=3)))
        power += (project_anchors(cloud_of(rng.random((1280, 3)), is_set), LATTICE) ** 2).sum(axis=1)
    # White noise: a ratio of 0.2 with a penalty of l^2, 1.0 with l, 4.7 with the same for both bands.
    assert power[4:].mean() < 0.5 * power[1:4].mean()


def test_the_cosine_lobe_is_the_integral_of_the_clamped_cosine():
    nodes, weights = np.polynomial.legendre.leggauss(64)
    z, weights = (nodes + 1) / 2, weights / 2
    for band in range(13):
        integral = 2 * np.pi * np.sum(weights * z * scipy.special.eval_legendre(band, z))
        assert cosine_lobe(12)[band] == pytest.approx(integral, abs=1e-14)
    with pytest.raises(ValueError, match="at least 0"):
        cosine_lobe(-1)


def test_irradiance_equals_the_integral_over_the_hemisphere():
    light = random_light(4, seed=7)
    radiance = evaluate_panorama(light, 300, 600).reshape(-1, 3)
    weights = solid_angles(300, 600).reshape(-1)
    towards = panorama_directions(300, 600).reshape(-1, 3)
    for normal in random_directions(4, seed=8):
        expected = (np.clip(towards @ normal, 0, None) * weights) @ radiance
        np.testing.assert_allclose(irradiance(light, [normal])[0], expected, atol=5e-4)


def test_irradiance_refuses_bad_coefficients_and_takes_no_normals():
    assert irradiance(random_light(), np.empty((0, 3))).shape == (0, 3)
    for bad in (np.ones((9, 4)), np.ones((8, 3)), np.ones(9), np.ones((0, 3))):
        with pytest.raises(ValueError, match="expected shape"):
            irradiance(bad, [[0, 0, 1]])
    with pytest.raises(ValueError, match="27 NaN or infinite"):
        irradiance(np.full((9, 3), np.nan), [[0, 0, 1]])


def test_a_matrix_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"finite \(3, 3\) matrix, got shape \(4, 4\)"):
        rotate(random_light(), np.eye(4))


def ringing_lights() -> list[F64]:
    """Lights whose irradiance is negative somewhere: distant lights, also coloured, and strong random ones."""
    lights = [distant_light(direction) for direction in random_directions(4, seed=20)]
    lights += [distant_light(d, order=4) * [1.0, 0.2, 3.0] for d in random_directions(2, seed=21)]
    for seed in range(6):
        light = random_light(2 + seed % 3, seed=30 + seed)
        light[0] = np.abs(light[0]) + 0.5
        lights.append(light)
    return lights


@pytest.mark.parametrize("light", ringing_lights())
def test_dering_lights_every_normal_with_the_smallest_window(light):
    normals = random_directions(20000, seed=40)
    assert irradiance(light, normals).min() < 0
    result, strength = dering_with_strength(light)
    received = irradiance(result, normals)
    assert received.min() >= -1e-3 * received.max()
    assert 0 < strength < 1
    np.testing.assert_allclose(result, windowed(light, 1 - strength), atol=1e-14)
    assert irradiance(windowed(light, 1 - strength + 0.01), normals).min() < 0
    np.testing.assert_array_equal(dering(result), result)
