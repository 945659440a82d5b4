"""Panoramas: exact integrals over texels, and the directions that the convention says."""

import numpy as np
import pytest

from addon_tests.pure.sh_samples import AXES, F64
from xihenet.panorama import panorama_directions, project_panorama, solid_angles
from xihenet.sh import basis


def gauss_texel_integrals(height: int, width: int, order: int) -> F64:
    """The basis integrated over each texel by brute force: 24 x 24 Gauss nodes per texel, (H, W, K)."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    integrals = np.empty((height, width, (order + 1) ** 2))
    for row in range(height):
        polar = np.pi * (row + 0.5 + nodes / 2) / height
        for column in range(width):
            turn = 2 * np.pi * ((column + 0.5 + nodes / 2) / width - 0.5)
            theta, alpha = np.meshgrid(polar, turn, indexing="ij")
            toward = np.stack([np.sin(theta) * np.sin(alpha), np.sin(theta) * np.cos(alpha), np.cos(theta)], axis=-1)
            area = np.outer(weights * np.sin(polar) * np.pi / (2 * height), weights * np.pi / width)
            integrals[row, column] = area.ravel() @ basis(toward.reshape(-1, 3), order)
    return integrals


@pytest.mark.parametrize("size", [(1, 1), (1, 2), (2, 3), (3, 4), (4, 8)])
def test_every_texels_integral_equals_brute_force(size):
    expected = gauss_texel_integrals(*size, order=4)
    for row in range(size[0]):
        for column in range(size[1]):
            lamp = np.zeros((*size, 3))
            lamp[row, column] = 1
            np.testing.assert_allclose(project_panorama(lamp, 4)[:, 1], expected[row, column], rtol=0, atol=1e-11)


def test_the_panorama_looks_where_the_convention_says():
    directions = panorama_directions(3, 4000)
    columns = {"-Y": 0, "-X": 1000, "+Y": 2000, "+X": 3000}
    for name, column in columns.items():
        np.testing.assert_allclose(directions[1, column], AXES[name], atol=2e-3)
    assert directions[1, 2000 + 10, 0] > 0
    tall = panorama_directions(999, 2)
    np.testing.assert_allclose(tall[0, 0], AXES["+Z"], atol=2e-3)
    np.testing.assert_allclose(tall[-1, 0], AXES["-Z"], atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1, atol=1e-15)
    np.testing.assert_allclose(panorama_directions(1, 1)[0, 0], AXES["+Y"], atol=1e-15)


def test_projection_is_linear_and_takes_float32():
    a, b = np.random.default_rng(5).normal(size=(2, 8, 16, 3))
    np.testing.assert_allclose(project_panorama(2 * a - b), 2 * project_panorama(a) - project_panorama(b), atol=1e-13)
    single = a.astype(np.float32)
    np.testing.assert_array_equal(project_panorama(single), project_panorama(single.astype(float)))


def test_bad_panoramas_are_refused():
    image = np.ones((4, 8, 3))
    image[1, 1, 0] = image[2, 2] = np.nan
    image[0, 0, 2] = np.inf
    with pytest.raises(ValueError, match="got 3 pixels with NaN or infinity"):
        project_panorama(image)
    for shape in ((4, 8), (4, 8, 4), (0, 8, 3), (4, 0, 3)):
        with pytest.raises(ValueError, match="panorama: expected"):
            project_panorama(np.ones(shape))
    for function in (panorama_directions, solid_angles):
        with pytest.raises(ValueError, match="at least one texel"):
            function(0, 4)
    with pytest.raises(ValueError, match="order of at least 0"):
        project_panorama(np.ones((2, 2, 3)), -1)
