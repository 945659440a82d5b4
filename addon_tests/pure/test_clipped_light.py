"""Clipped light from noisy pictures: the mean of min(light, 1), whatever the noise, and lamps smaller than a pixel."""

import numpy as np
import pytest

from xihenet.clipped_light import clipped_sh, relative_noise
from xihenet.mirror_ball import ball_directions, neighbours, project_mirror_ball

SIZE, SAMPLES = 64, 8
DIRECTIONS, ON_BALL = ball_directions(SIZE)


def a_room(bright=4.0, dim=0.3):
    """(N, N, 3) true light: a bright upper part, a dim rest."""
    light = np.where(DIRECTIONS[..., 2] > 0.6, bright, dim)
    return np.repeat(light[..., None], 3, axis=-1)


def noisy(light, rng, n=SAMPLES):
    """Samples of `light` by rays that mostly find nothing and sometimes five times as much, as path tracing does."""
    hits = rng.random((n, SIZE, SIZE, 1)) < 0.2
    return [(light * 5 * hit).astype(np.float32) for hit in hits]


def clipped(light):
    return project_mirror_ball(np.minimum(light, 1.0))


NOTHING = [np.zeros((SIZE, SIZE, 3), np.float32)] * SAMPLES


def test_noise_does_not_bias_clipped_light():
    rng = np.random.default_rng(3)
    light = a_room()
    smooth = (light * (1 + 0.2 * rng.normal(size=light.shape) / np.sqrt(SAMPLES))).astype(np.float32)
    runs = [clipped_sh(noisy(light, rng), NOTHING, smooth).mean(axis=0) for _ in range(12)]
    expected = clipped(light)
    assert np.mean(runs, axis=0)[0, 0] == pytest.approx(expected[0, 0], rel=0.01)
    # Clipping the pictures themselves loses more than half of what is below white.
    naive = np.mean([project_mirror_ball(np.minimum(picture, 1.0)) for picture in noisy(light, rng)], axis=0)
    assert naive[0, 0] < 0.6 * expected[0, 0]


def test_without_a_denoiser_the_bias_is_small():
    rng = np.random.default_rng(4)
    light = a_room()
    runs = [clipped_sh(noisy(light, rng), NOTHING, None).mean(axis=0) for _ in range(12)]
    assert np.mean(runs, axis=0)[0, 0] == pytest.approx(clipped(light)[0, 0], rel=0.06)


@pytest.mark.parametrize(("radius_deg", "n_rays", "tolerance"), [(3.0, 160, 0.12), (10.0, 20, 0.05)])
def test_a_lamp_counts_for_its_own_size_however_bright(radius_deg, n_rays, tolerance):
    rng = np.random.default_rng(5)
    cosine = np.cos(np.radians(radius_deg))
    exact = (1 - cosine) * np.sqrt(np.pi)
    fine = ball_directions(SIZE * 16)[0].reshape(SIZE, 16, SIZE, 16, 3)
    lights = []
    for _ in range(n_rays):
        # A ray through a random place of each pixel.
        i, j = rng.integers(16, size=(2, SIZE, SIZE))
        rays = fine[np.arange(SIZE)[:, None], i, np.arange(SIZE)[None], j]
        lamp = np.where(rays @ np.array([0.6, 0, 0.8]) > cosine, 500.0, 0.0)
        lights.append(np.repeat(lamp[..., None], 3, axis=-1).astype(np.float32))
    # What a denoiser makes of it: spread over the pixels around.
    spread = np.mean(lights, axis=0).astype(np.float32)
    found = clipped_sh(lights, lights, spread).mean(axis=0)[0, 0]
    assert found == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize("is_denoised", [False, True])
@pytest.mark.parametrize("sky", [0.05, 0.5, 3.0])
def test_a_large_lamp_or_sky_counts_for_what_it_is_and_white_at_most(sky, is_denoised):
    """Amid it there is nothing else near: it must not pass for white where it is dim."""
    is_met = (np.arange(64) >= 32)[:, None, None] & np.ones((64, 64, 3), bool)
    met = np.where(is_met, np.float32(sky), np.float32(0))
    picture = np.where(is_met, met, np.float32(0.02))
    smooth = picture if is_denoised else None
    expected = project_mirror_ball(np.where(is_met, min(sky, 1), 0.02))
    for light in clipped_sh([picture] * 4, [met] * 4, smooth):
        np.testing.assert_allclose(light, expected, atol=1e-5)


def test_light_that_is_all_below_or_all_above_white_is_exact():
    rng = np.random.default_rng(6)
    for level, expected in ((0.2, 0.2), (50.0, 1.0)):
        light = np.full((SIZE, SIZE, 3), level)
        smooth = light.astype(np.float32)
        found = clipped_sh(noisy(light, rng, SAMPLES), NOTHING, smooth).mean(axis=0)[0, 0]
        assert found == pytest.approx(expected * np.sqrt(4 * np.pi), rel=0.03)


def test_a_single_picture_knows_no_noise():
    rng = np.random.default_rng(7)
    light = a_room()
    one = clipped_sh(noisy(light, rng, 1), NOTHING[:1], light.astype(np.float32))
    assert one.shape == (1, 9, 3) and relative_noise(one, 1e-3) is None


def test_the_noise_that_is_told_is_the_noise():
    rng = np.random.default_rng(8)
    light = a_room()
    smooth = light.astype(np.float32)
    runs = [clipped_sh(noisy(light, rng), NOTHING, smooth) for _ in range(40)]
    told = np.sqrt(np.mean([relative_noise(run, 1e-3) ** 2 for run in runs]))
    means = np.array([run.mean(axis=0) for run in runs])
    real = np.sqrt(((means - means.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()) / np.linalg.norm(means.mean(axis=0))
    assert told == pytest.approx(real, rel=0.2)
    told = relative_noise(runs[0], 1e-3)
    for unit in (1e-250, 1e250):
        assert relative_noise(runs[0] * unit, 1e-3 * unit) == pytest.approx(told)
    sizes = np.abs(runs[0])
    assert relative_noise(-1e250 * sizes, 1e-3) == pytest.approx(relative_noise(sizes, 1e-3))


def test_no_sample_is_refused():
    with pytest.raises(ValueError, match="at least one picture"):
        clipped_sh([], [], None)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", range(3))
@pytest.mark.parametrize("met", [0.0, 2.0])
def test_what_is_not_finite_is_refused_in_whichever_picture_and_under_a_lamp(bad, where, met):
    pictures = [np.full((SIZE, SIZE, 3), value, np.float32) for value in (0.5, met, 0.5)]
    pictures[where][20, 30] = bad
    with pytest.raises(ValueError, match="finite"):
        clipped_sh([pictures[0]], [pictures[1]], pictures[2])


@pytest.mark.parametrize("is_denoised", [False, True])
def test_bars_narrower_than_a_pixel_do_not_pass_for_the_window_behind_them(is_denoised):
    """Half of the rays of each pixel meet the sky, half a dim bar: one mean of both is white, light is half of it."""
    rng = np.random.default_rng(9)
    met = [
        np.where(rng.random((SIZE, SIZE, 1)) < 0.5, 6.0, 0.0).astype(np.float32) * np.ones(3, np.float32)
        for _ in range(8)
    ]
    radiance = [np.where(sky > 0, sky, np.float32(0.1)) for sky in met]
    smooth = np.full((SIZE, SIZE, 3), 3.05, np.float32) if is_denoised else None
    found = clipped_sh(radiance, met, smooth).mean(axis=0)[0, 0]
    assert found == pytest.approx(0.55 * np.sqrt(4 * np.pi), rel=0.02)


def test_a_lamp_that_rays_reach_by_chance_through_fog_is_as_white_as_it_is_and_no_larger():
    rng = np.random.default_rng(6)
    is_lamp = DIRECTIONS[..., 2:] > np.cos(np.radians(50))
    met = [
        (5.0 * (is_lamp & (rng.random(is_lamp.shape) < 0.3)) * np.ones(3)).astype(np.float32) for _ in range(SAMPLES)
    ]
    seen, fog = [0.1 + picture for picture in met], np.ones_like(is_lamp)
    expected = clipped(np.where(is_lamp, 1.6, 0.1) * np.ones(3))
    found = [clipped_sh(seen, met, np.full_like(met[0], 0.1), fog=each).mean(axis=0) for each in (fog, None, ~fog)]
    off = [np.linalg.norm(light - expected) / np.linalg.norm(expected) for light in found]
    assert off[0] < 0.1 and off[1] > 0.5 and np.array_equal(found[1], found[2])
    assert found[0][0, 0] < expected[0, 0]


def plainly_clipped(radiance, emission, smooth):
    """The same for every pixel of every picture, with a median of colours."""

    def mean_around(pictures, is_counted):
        counts = neighbours(np.sum(is_counted, axis=0, dtype=np.float32), 3).sum(axis=0)
        return neighbours(np.sum(pictures, axis=0), 3).sum(axis=0) / np.maximum(counts, 1)

    is_lamp = [met.max(axis=-1, keepdims=True) > 0 for met in emission]
    no_lamp, seen = np.logical_not(is_lamp), np.where(is_lamp, 0, radiance)
    judge = np.median(neighbours(mean_around(seen, no_lamp), 5), axis=0) if smooth is None else smooth
    is_near_lamp, lights = neighbours(np.any(is_lamp, axis=0), 3).any(axis=0), []
    for n in range(len(radiance)):
        others = [k for k in range(len(radiance)) if k != n] or [n]
        without = mean_around(seen[others], no_lamp[others])
        is_white = np.where(is_lamp[n], emission[n], np.where(is_near_lamp, without, judge)) >= 1
        lights.append(project_mirror_ball(np.where(is_white, 1, radiance[n])))
    return lights


@pytest.mark.parametrize("is_denoised", [False, True])
@pytest.mark.parametrize(("size", "n"), [(64, 6), (9, 1), (2, 3)])
def test_the_fast_way_is_the_plain_one(size, n, is_denoised):
    """In quarters of white, whose sums are exact in whatever order; lamps on the rim and around single pixels."""
    rng = np.random.default_rng(10)
    for share in (0, 0.02, 0.5, 1):
        met = rng.integers(7, size=(n, size, size, 3)) * (rng.random((size, size, 1)) < share) / 4
        met = (met * (rng.random((n, size, size, 1)) < 0.7)).astype(np.float32)
        radiance = (met + rng.integers(7, size=met.shape) / 4).astype(np.float32)
        smooth = radiance.mean(axis=0) if is_denoised else None
        np.testing.assert_allclose(
            clipped_sh(radiance, met, smooth), plainly_clipped(radiance, met, smooth), rtol=1e-12
        )
