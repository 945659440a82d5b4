"""Each effect on plane depth against its own model."""

import numpy as np
import pytest

from xihenet.camera import valid_plane_depth
from xihenet.phone.depth import (
    DistanceNoise,
    EdgeBleeding,
    Quantisation,
    RangeLimits,
    add_noise,
    bleed_edges,
    cut_range,
    grained_noise,
    noise_sigma_m,
    quantise,
    window_span_m,
)

NASTY = np.array([[0, -1, np.nan], [np.inf, -np.inf, 1e10], [1.0, 2.0, 5.0]], np.float32)
INVALID = ~valid_plane_depth(NASTY)


def noise(**changes):
    white = {"sigma_m": 0.0, "growth": 0.0, "growth_from_m": 0.0, "growth_power": 1.0, "grain_px": 0.0, "shift_px": 0.0}
    return DistanceNoise(source="test", **(white | changes))


KINECT_V1 = noise(sigma_m=0.0012, growth=0.0019, growth_from_m=0.4, growth_power=2.0)
AZURE = noise(sigma_m=0.0005, growth=0.001, growth_from_m=0.5)
LIDAR = noise(sigma_m=0.01, grain_px=10.7)
LIMITS = RangeLimits(source="test", nearest_m=0.5, farthest_m=5.0)
BLEEDING = EdgeBleeding(source="test", radius_px=2, span_m=0.1)
STEPS = Quantisation(source="test", step_m=0.05)


def wall(distance_m, size=(192, 256)):
    return np.full(size, distance_m, np.float32)


def messy(seed, size=(13, 17)):
    """Near and far surfaces with every kind of invalid pixel."""
    rng = np.random.default_rng(seed)
    z = np.where(rng.random(size) < 0.5, rng.uniform(0.5, 1, size), rng.uniform(3, 6, size)).astype(np.float32)
    hit = rng.random(size) < 0.2
    z[hit] = rng.choice([0, np.nan, np.inf, 1e10, -1], hit.sum())
    return z


@pytest.mark.parametrize(
    "effect",
    [
        lambda z: add_noise(z, noise(), np.random.default_rng(0)),
        lambda z: quantise(z, Quantisation(source="test", step_m=0)),
        lambda z: bleed_edges(z, EdgeBleeding(source="test", radius_px=0, span_m=0)),
        lambda z: bleed_edges(z, EdgeBleeding(source="test", radius_px=2, span_m=99)),
    ],
)
def test_an_effect_that_is_off_gives_the_very_array(effect):
    z = messy(1)
    assert effect(z) is z


EFFECTS_ON = [
    lambda z: cut_range(z, LIMITS),
    lambda z: add_noise(z, LIDAR, np.random.default_rng(0)),
    lambda z: add_noise(z, noise(sigma_m=0.02, shift_px=0.5), np.random.default_rng(0)),
    lambda z: quantise(z, STEPS),
    lambda z: bleed_edges(z, BLEEDING),
]


@pytest.mark.parametrize("effect", EFFECTS_ON)
def test_invalid_pixels_keep_their_bytes(effect):
    out = effect(NASTY)
    assert out.dtype == np.float32
    assert out[INVALID].tobytes() == NASTY[INVALID].tobytes()


@pytest.mark.parametrize("effect", EFFECTS_ON[1:])
@pytest.mark.parametrize("seed", range(5))
def test_only_the_range_makes_invalid_pixels(effect, seed):
    z = messy(seed)
    np.testing.assert_array_equal(valid_plane_depth(effect(z)), valid_plane_depth(z))


@pytest.mark.parametrize("effect", EFFECTS_ON)
@pytest.mark.parametrize("size", [(1, 1), (1, 5), (4, 1), (2, 2)])
def test_tiny_pictures_are_legal(effect, size):
    out = effect(wall(2.0, size))
    assert out.shape == size and np.isfinite(out).all()
    assert np.abs(out - 2).max() < 0.2


def test_the_range_is_cut_at_both_ends_and_nowhere_else():
    z = np.array([[0.49, 0.5, 3.0, 5.0, 5.01]], np.float32)
    np.testing.assert_array_equal(cut_range(z, LIMITS), np.array([[0, 0.5, 3.0, 5.0, 0]], np.float32))


@pytest.mark.parametrize(("settings", "formula"), [
    (KINECT_V1, lambda z: 0.0012 + 0.0019 * (z - 0.4) ** 2),
    (AZURE, lambda z: 0.0005 + 0.001 * max(z - 0.5, 0)),
    (LIDAR, lambda z: 0.01),
])  # fmt: skip
@pytest.mark.parametrize("distance_m", [0.5, 1.0, 2.5, 4.5])
def test_noise_has_the_published_sigma_at_each_distance(settings, formula, distance_m):
    assert noise_sigma_m(wall(distance_m, (1, 1)), settings)[0, 0] == pytest.approx(formula(distance_m), rel=1e-6)
    rng = np.random.default_rng(7)
    errors = np.stack([add_noise(wall(distance_m), settings, rng) for _ in range(12)]) - distance_m
    # 49,152 pixels share some 430 grains of 10.7 pixels in a picture, so the LiDAR's sampling error is larger.
    tolerance = 0.05 if settings is LIDAR else 0.01
    assert errors.std() == pytest.approx(formula(distance_m), rel=tolerance)
    assert abs(errors.mean()) < 0.05 * formula(distance_m)


def test_grain_keeps_the_sigma_at_every_pixel():
    rng = np.random.default_rng(5)
    pictures = np.stack([grained_noise((24, 32), 6.0, rng) for _ in range(3000)])
    sigma = pictures.std(axis=0)
    assert abs(sigma - 1).max() < 0.07
    assert abs(pictures.mean(axis=0)).max() < 0.1


def test_grain_makes_neighbours_alike_and_far_pixels_independent():
    rng = np.random.default_rng(6)
    pictures = np.stack([grained_noise((1, 64), 10.0, rng)[0] for _ in range(4000)])
    near = np.mean(pictures[:, 30] * pictures[:, 32])
    far = np.mean(pictures[:, 10] * pictures[:, 50])
    assert near > 0.85
    assert abs(far) < 0.08


@pytest.mark.parametrize("distance_m", [1e-45, 1e-30, 1e-3, 1e5, 1e7, 9.9e8])
def test_noise_makes_no_hole_at_any_distance(distance_m):
    for settings in (KINECT_V1, noise(sigma_m=1.0), noise(sigma_m=0.01, growth=1.0, growth_power=4.0)):
        assert valid_plane_depth(add_noise(wall(distance_m), settings, np.random.default_rng(0))).all()


def test_huge_noise_neither_passes_the_camera_nor_loses_its_depth():
    out = add_noise(wall(0.3), noise(sigma_m=1.0), np.random.default_rng(0))
    assert valid_plane_depth(out).all()
    assert out.min() >= np.float32(0.15)


def test_a_shifted_look_makes_points_between_two_surfaces_but_not_on_a_slope():
    edge = wall(1.0)
    edge[:, 128:] = 3.0
    shifted = add_noise(edge, noise(shift_px=0.25), np.random.default_rng(0))
    between = (shifted > 1.01) & (shifted < 2.99)
    assert between[:, 127:129].mean() > 0.3
    assert not np.delete(between, range(125, 131), axis=1).any()
    slope = np.broadcast_to(np.linspace(1, 2, 256, dtype=np.float32), (192, 256))
    errors = (add_noise(slope, noise(shift_px=0.25), np.random.default_rng(0)) - slope)[:, 5:-5]
    assert errors.std() == pytest.approx(0.25 * (1 / 255), rel=0.02)


def test_quantised_values_are_the_nearest_whole_steps():
    z = np.random.default_rng(2).uniform(0.1, 5, (40, 40)).astype(np.float32)
    out = quantise(z, STEPS)
    assert np.abs(out / 0.05 - np.rint(out / 0.05)).max() < 1e-4
    assert np.abs(out - z).max() <= 0.025 + 1e-6
    np.testing.assert_array_equal(quantise(out, STEPS), out)


def test_what_is_nearer_than_half_a_step_stays_valid():
    assert quantise(wall(0.001, (1, 1)), STEPS)[0, 0] == np.float32(0.05)


def plain_window(z, row, column, radius):
    window = z[max(row - radius, 0) : row + radius + 1, max(column - radius, 0) : column + radius + 1]
    return window[valid_plane_depth(window)]


@pytest.mark.parametrize("radius", [1, 2, 30])
@pytest.mark.parametrize("seed", range(4))
def test_window_spans_are_those_of_a_plain_loop(radius, seed):
    z = messy(seed)
    windows = [[plain_window(z, r, c, radius) for c in range(z.shape[1])] for r in range(z.shape[0])]
    plain = [[np.ptp(w) if w.size else 0 for w in row] for row in windows]
    np.testing.assert_allclose(window_span_m(z, radius), plain, rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_bleeding_is_the_mean_of_valid_neighbours_where_there_is_an_edge(seed):
    z = messy(seed)
    out = bleed_edges(z, BLEEDING)
    for (row, column), value in np.ndenumerate(z):
        window = plain_window(z, row, column, 2)
        is_edge = valid_plane_depth(value) and np.ptp(window) > 0.1
        expected = window.astype(np.float64).mean() if is_edge else value
        np.testing.assert_allclose(out[row, column], expected, rtol=1e-6)


def test_bleeding_leaves_flat_walls_alone_and_scales_with_the_picture():
    edge = wall(1.0, (8, 64))
    edge[:, 32:] = 3.0
    for scale, reach in ((1.0, 2), (0.1, 1), (4.0, 8)):
        touched = np.flatnonzero((bleed_edges(edge, BLEEDING, pixel_scale=scale) != edge)[4])
        assert (touched.min(), touched.max()) == (32 - reach, 31 + reach)
