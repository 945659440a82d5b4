"""Mirror balls: every pixel has the same solid angle, directions are Blender's, light comes out as it went in."""

import numpy as np
import pytest

from addon_tests.pure.sh_samples import CONSTANT, random_light
from xihenet.mirror_ball import RIM, ball_directions, ball_pixels, panorama_of_ball, project_mirror_ball, seen_in_ball
from xihenet.panorama import panorama_directions, project_panorama
from xihenet.sh import basis


def rendered(light, size, cells=8):
    """A mirror ball of SH light as a renderer gives it: the mean over a pixel of what its rays meet."""
    directions, on_ball = ball_directions(size * cells)
    order = int(np.sqrt(len(light))) - 1
    radiance = (basis(directions.reshape(-1, 3), order) @ light).reshape(*on_ball.shape, 3) * on_ball[..., None]
    return radiance.reshape(size, cells, size, cells, 3).mean(axis=(1, 3))


@pytest.mark.slow
@pytest.mark.parametrize(("size", "cells", "tolerance"), [(64, 8, 0.12), (160, 4, 0.04)])
def test_light_of_any_low_order_comes_out_as_it_went_in(size, cells, tolerance):
    light = random_light(4)
    off = project_mirror_ball(rendered(light, size, cells), 4) - light
    assert np.abs(off).max() < tolerance * np.abs(light).max()
    assert np.linalg.norm(off[:9]) < tolerance * np.linalg.norm(light)


@pytest.mark.parametrize("size", [256, 257, 271, 341, 399, 513])
def test_a_finer_picture_tells_more_whether_its_size_is_even_or_odd(size):
    light, directions = random_light(2), ball_directions(size)[0]
    ball, turned = (
        (basis((directions * axes).reshape(-1, 3)) @ light).reshape(size, size, 3) for axes in (1, (1, -1, -1))
    )
    off = project_mirror_ball(ball, turned=turned) - light
    assert np.abs(off).max() < 0.15 / size * np.abs(light).max()


@pytest.mark.parametrize("towards", [(0, 0, 1), (0.5, 0.2, -0.6), (1, 0, 0), (0, -1, 0), (-0.5, 0.5, -0.5)])
def test_a_disc_has_its_solid_angle_wherever_it_stands(towards):
    cosine = np.cos(0.3)
    directions, on_ball = ball_directions(1024)
    inside = (directions @ (np.array(towards) / np.linalg.norm(towards)) > cosine) & on_ball
    disc = inside.reshape(256, 4, 256, 4).mean(axis=(1, 3))
    light = project_mirror_ball(np.repeat(disc[..., None], 3, axis=-1))
    assert light[0, 0] * np.sqrt(4 * np.pi) == pytest.approx(2 * np.pi * (1 - cosine), rel=0.01)


def test_a_picture_looks_up_in_the_middle_and_has_x_on_the_right():
    directions, on_ball = ball_directions(201)
    np.testing.assert_allclose(directions[100, 100], (0, 0, 1), atol=1e-12)
    assert directions[100, 150] @ (1, 0, 0) > 0.8 and directions[50, 100] @ (0, -1, 0) > 0.8
    np.testing.assert_allclose(np.linalg.norm(directions[on_ball], axis=-1), 1.0, atol=1e-12)
    rows, columns = ball_pixels(directions, 201)
    is_inside = directions[..., 2] > -0.9
    np.testing.assert_array_equal(np.stack([rows[is_inside], columns[is_inside]], axis=-1), np.argwhere(is_inside))


def test_a_panorama_of_a_ball_shows_the_same_light():
    light = random_light(2)
    ball = rendered(light, 128)
    expected = basis(panorama_directions(32, 64).reshape(-1, 3)) @ light
    panorama = panorama_of_ball(ball, 32)
    np.testing.assert_allclose(panorama.reshape(-1, 3)[: 64 * 26], expected[: 64 * 26], atol=0.08 * np.abs(light).max())
    np.testing.assert_allclose(project_panorama(panorama), light, atol=0.05 * np.abs(light).max())
    np.testing.assert_array_equal(seen_in_ball(ball, np.array([[0.0, 0.0, 1.0]]))[0], ball[64, 64].astype(np.float32))


def test_pixels_on_the_rim_do_not_count_and_straight_down_is_told_by_those_inside():
    place = np.arange(64) + 0.5 - 32
    is_rim = np.hypot(place[:, None], place) > 32 - RIM + np.sqrt(0.5)
    ball = np.where(is_rim[..., None], 1e6, 0.25) * np.ones(3)
    np.testing.assert_allclose(project_mirror_ball(ball)[0], 0.25 * CONSTANT, rtol=2e-3)
    down = np.array([[0.0, 0.0, -1.0], [1e-9, 0.0, -1.0], [0.0, -1e-14, -1.0]])
    np.testing.assert_array_equal(seen_in_ball(ball, down), 0.25)
    assert panorama_of_ball(ball, 16).max() == 0.25


def test_a_ball_that_is_turned_over_tells_what_lies_on_the_rim():
    light, size = random_light(2), 96
    half_a_turn = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1])[:, None]
    directions = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_allclose(basis(directions) @ light, basis(directions * (1, -1, -1)) @ (light * half_a_turn))
    place = np.arange(size) + 0.5 - size / 2
    is_rim = np.hypot(place[:, None], place) > size / 2 - RIM + np.sqrt(0.5)
    ball, turned = (np.where(is_rim[..., None], 1e6, rendered(c, size)) for c in (light, light * half_a_turn))
    alone, together = (np.linalg.norm(project_mirror_ball(ball, turned=other) - light) for other in (None, turned))
    assert together < 0.25 * alone < 0.01 * np.linalg.norm(light)


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((4, 8, 3)), "shape"),
        (np.zeros((4, 4)), "shape"),
        (np.zeros((0, 0, 3)), "at least one pixel"),
        (np.full((4, 4, 3), np.nan), "16 pixels"),
    ],
)
def test_what_is_no_mirror_ball_is_refused(picture, words):
    with pytest.raises(ValueError, match=words):
        project_mirror_ball(picture)


@pytest.mark.parametrize("size", [1, 2, 3, 5, 16])
def test_constant_light_comes_from_everywhere_however_small_the_ball(size):
    np.testing.assert_allclose(project_mirror_ball(np.ones((size, size, 3)))[1:], 0, atol=1e-3)


@pytest.mark.parametrize(("size", "cells"), [(1, 512), (3, 170), (8, 64), (47, 10)])
def test_a_quarter_of_the_ball_tells_what_the_whole_tells(size, cells):
    """The plain way: every cell of the whole picture, one by one."""
    radiance = np.random.default_rng(size).uniform(0, 4, (size, size, 3))
    cells, on_ball = ball_directions(size * cells)
    seen = cells[on_ball]
    rows, columns = ball_pixels(seen, size)
    weight = 4 * np.pi / len(seen)
    plain = weight * basis(seen, 3).T @ radiance[rows, columns]
    np.testing.assert_allclose(project_mirror_ball(radiance, 3), plain, atol=1e-9)
