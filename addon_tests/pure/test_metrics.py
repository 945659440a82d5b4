"""The errors: known answers, invariances, and the input on which published metric code breaks."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from xihenet.metrics import (
    angular_error,
    angular_error_deg,
    image_rmse,
    psnr,
    share_above_white,
    shc_rmse,
    si_rmse,
    ssim,
)
from xihenet.sh import project_panorama

Metric = Callable[..., float | None]
Image = NDArray[np.float64]

IMAGE_METRICS: list[Metric] = [image_rmse, si_rmse, angular_error_deg, psnr, ssim]
EVERY_METRIC = pytest.mark.parametrize("metric", IMAGE_METRICS, ids=lambda metric: metric.__name__)
DISPLAY_METRIC = pytest.mark.parametrize("metric", [psnr, ssim], ids=lambda metric: metric.__name__)
FULL = np.ones((12, 15), bool)


def images(seed: int = 0, size: tuple[int, int] = (12, 15)) -> tuple[Image, Image]:
    """Two different random pictures in [0, 1]."""
    a, b = np.random.default_rng(seed).random((2, *size, 3))
    return a, b


def blob(size: tuple[int, int] = (12, 15)) -> Image:
    """An alpha with a soft edge: 1 inside, 0 outside."""
    row, column = np.indices(size)
    return np.clip(5.5 - np.hypot(row - size[0] / 2, column - size[1] / 2), 0, 1)


def test_shc_rmse_has_known_answers():
    assert shc_rmse(np.zeros((9, 3)), np.full((9, 3), -0.5)) == 0.5
    one_off = np.zeros((9, 3))
    one_off[4, 1] = 1
    assert shc_rmse(one_off, np.zeros((9, 3))) == pytest.approx(1 / math.sqrt(27))
    assert shc_rmse(one_off, one_off) == 0


@EVERY_METRIC
def test_equal_images_score_exactly_perfect(metric):
    perfect = {"psnr": None, "ssim": 1.0}.get(metric.__name__, 0.0)
    for seed, mask in ((1, FULL), (2, blob())):
        image = images(seed)[0]
        assert metric(image, image.copy(), mask) == perfect
        assert metric(image.astype(np.float32), image.astype(np.float32), mask) == perfect


@EVERY_METRIC
def test_what_lies_outside_the_mask_has_no_influence(metric):
    a, b = images()
    mask = blob()
    expected = metric(a, b, mask)
    for outside in (np.nan, np.inf, -7.0, 1e30):
        spoiled_a, spoiled_b = a.copy(), b.copy()
        spoiled_a[mask == 0] = outside
        spoiled_b[mask == 0] = -outside
        assert metric(spoiled_a, spoiled_b, mask) == expected


@EVERY_METRIC
def test_a_bool_mask_and_weights_of_0_and_1_agree(metric):
    a, b = images()
    mask = blob() > 0.5
    assert metric(a, b, mask) == metric(a, b, mask.astype(np.float32))


@EVERY_METRIC
def test_half_the_weight_everywhere_changes_nothing(metric):
    a, b = images()
    assert metric(a, b, blob() / 2) == pytest.approx(metric(a, b, blob()), rel=1e-12)


@EVERY_METRIC
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_pixels_inside_the_mask_that_are_not_finite_are_refused_with_their_number(metric, value):
    a, b = images()
    a[5, 6, 1] = a[5, 6, 2] = a[6, 6, 0] = value
    with pytest.raises(ValueError, match=r"prediction: .* 2 pixels"):
        metric(a, b, blob())
    with pytest.raises(ValueError, match=r"truth: .* 2 pixels"):
        metric(b, a, blob())


@EVERY_METRIC
def test_shapes_that_differ_are_refused(metric):
    a, b = images()
    for prediction, truth, mask in (
        (a[1:], b, FULL),
        (a, b, FULL[:, 1:]),
        (a[..., :2], b[..., :2], FULL),
        (a[0], b[0], FULL[0]),
    ):
        with pytest.raises(ValueError, match="expected"):
            metric(prediction, truth, mask)


@EVERY_METRIC
@pytest.mark.parametrize("weight", [-0.1, 1.1, np.nan, np.inf])
def test_weights_outside_0_to_1_are_refused(metric, weight):
    a, b = images()
    mask = blob()
    mask[0, 0] = weight
    with pytest.raises(ValueError, match="mask"):
        metric(a, b, mask)


def test_image_rmse_is_the_weighted_root_mean_square():
    truth = np.zeros((1, 3, 3))
    prediction = np.array([[[3.0, 3, 3], [0, 0, 4], [9, 9, 9]]])
    expected = math.sqrt((3 * 9 * 1.0 + 16 * 0.5) / (3 * 1.5))
    assert image_rmse(prediction, truth, [[1, 0.5, 0]]) == pytest.approx(expected, rel=1e-14)


def test_si_rmse_is_the_smallest_rmse_over_all_factors():
    a, b = images()
    factors = np.linspace(0, 2, 20001)
    best = min(float(np.sqrt(np.mean((f * a - b) ** 2))) for f in factors)
    assert si_rmse(a, b, FULL) == pytest.approx(best, rel=1e-7)
    assert si_rmse(a, b, FULL) <= best


@pytest.mark.parametrize(
    ("colour", "degrees"),
    [((2, 0, 0), 0), ((0, 1, 0), 90), ((1, 1, 0), 45), ((-1, 0, 0), 180), ((1, 1e-9, 0), math.degrees(1e-9))],
)
def test_angles_between_known_colours(colour, degrees):
    red = np.array([[[0.5, 0, 0]]])
    assert angular_error_deg(np.array([[colour]]), red, [[True]]) == pytest.approx(degrees, rel=1e-12)


def test_black_pixels_are_counted_and_not_hidden():
    prediction = np.array([[[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0.0]]])
    truth = np.array([[[1, 0, 0], [1, 0, 0], [0, 0, 0], [0, 0, 0], [0, 1, 0], [9, 9, 9.0]]])
    error = angular_error(prediction, truth, [[1, 1, 1, 1, 1, 0]])
    assert (error.n_pixels, error.n_black_prediction, error.n_black_truth) == (5, 2, 2)
    assert error.mean_deg == pytest.approx(90)


def test_the_mean_angle_is_weighted():
    prediction = np.array([[[1, 0, 0], [0, 1, 0.0]]])
    truth = np.array([[[1, 0, 0], [1, 0, 0.0]]])
    assert angular_error_deg(prediction, truth, [[0.75, 0.25]]) == pytest.approx(22.5)


@DISPLAY_METRIC
@pytest.mark.parametrize("value", [-0.01, 1.01, 40.0])
def test_linear_colour_handed_to_a_display_metric_is_refused(metric, value):
    a, b = images()
    a[5, 6] = value
    with pytest.raises(ValueError, match=r"\[0, 1\], got 1 pixels"):
        metric(a, b, blob())


def ssim_by_loops(a: Image, b: Image, mask: Image) -> float:
    """SSIM pixel by pixel and window by window, as it is defined."""
    luma = np.array([0.2126, 0.7152, 0.0722])
    x, y = a @ luma, b @ luma
    total = 0.0
    for row, column in np.argwhere(mask > 0):
        weight, values_x, values_y = [], [], []
        for i in range(max(row - 5, 0), min(row + 6, len(x))):
            for j in range(max(column - 5, 0), min(column + 6, x.shape[1])):
                weight.append(mask[i, j] * math.exp(-((i - row) ** 2 + (j - column) ** 2) / (2 * 1.5**2)))
                values_x.append(x[i, j])
                values_y.append(y[i, j])
        w, vx, vy = np.array(weight) / sum(weight), np.array(values_x), np.array(values_y)
        mx, my = w @ vx, w @ vy
        sxx, syy, sxy = w @ (vx - mx) ** 2, w @ (vy - my) ** 2, w @ ((vx - mx) * (vy - my))
        local = (2 * mx * my + 1e-4) * (2 * sxy + 9e-4) / ((mx**2 + my**2 + 1e-4) * (sxx + syy + 9e-4))
        total += local * mask[row, column]
    return total / mask.sum()


@pytest.mark.parametrize("seed", [0, 1])
def test_ssim_equals_a_plain_loop_at_borders_and_mask_edges(seed):
    a, b = images(seed)
    b = np.clip(0.7 * a + 0.3 * b, 0, 1)
    scattered = np.clip(np.random.default_rng(seed + 10).random(FULL.shape) - 0.7, 0, 1)
    for mask in (FULL.astype(float), blob(), scattered):
        assert ssim(a, b, mask) == pytest.approx(ssim_by_loops(a, b, mask), rel=1e-10)


def test_the_share_above_white_is_that_of_the_panorama():
    panorama = 10 ** np.random.default_rng(1).uniform(-2, 1, (32, 64, 3))
    clipped, whole = (project_panorama(light) for light in (np.minimum(panorama, 1.0), panorama))
    edges = np.sin(np.linspace(np.pi / 2, -np.pi / 2, 33))
    texel = (edges[:-1] - edges[1:])[:, None, None]
    expected = 1 - (np.minimum(panorama, 1.0) * texel).sum() / (panorama * texel).sum()
    assert share_above_white(clipped, whole) == pytest.approx(expected, rel=1e-9)


def test_without_light_there_is_no_share_above_white():
    assert share_above_white(np.zeros((9, 3)), np.zeros((9, 3))) is None


@pytest.mark.parametrize(
    ("ldr", "hdr", "says"),
    [
        (np.zeros((9, 3)), np.zeros((4, 3)), "two equal shapes"),
        (np.zeros(9), np.zeros(9), "two equal shapes"),
        (np.full((9, 3), np.nan), np.ones((9, 3)), "finite coefficients"),
    ],
)
def test_what_is_no_light_has_no_share_above_white(ldr, hdr, says):
    with pytest.raises(ValueError, match=says):
        share_above_white(ldr, hdr)
