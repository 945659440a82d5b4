"""Hard cases of the metrics: black, equal, scaled, masked away, broken, and a single pixel."""

from typing import Any

import numpy as np

from addon_tests.hard_case import Must, at_most, each, equal, near, refused, row, that
from xihenet.metrics import angular_error_deg, image_rmse, psnr, shc_rmse, si_rmse, ssim

STAGE = "compare"
MASK = np.ones((8, 8))
RNG = np.random.default_rng(0)
PICTURE = RNG.random((8, 8, 3))
OTHER = RNG.random((8, 8, 3))
BLACK, GREY = np.zeros((8, 8, 3)), np.full((8, 8, 3), 0.5)
UNDEFINED = that("None", lambda came: came is None)
Given = tuple[Any, Any, Any]


def rmse_by_hand(given: Given) -> float:
    prediction, truth, mask = given
    return float(np.sqrt(((prediction - truth) ** 2 * mask[..., None]).sum() / (3 * mask.sum())))


def si_rmse_by_hand(given: Given) -> float:
    """Naive: the residual as a difference of sums, the scale by a division."""
    p, g, _ = given
    alpha = (p * g).sum() / (p * p).sum()
    return float(np.sqrt(((g * g).sum() - alpha * (p * g).sum()) / g.size))


def angle_by_hand(given: Given) -> float:
    """Naive: the arc cosine of the normalised product, NaN counted as no error."""
    p, g, mask = given
    # Hiding it is the mistake that is shown here.
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = (p * g).sum(axis=2) / (np.linalg.norm(p, axis=2) * np.linalg.norm(g, axis=2))
        angle = np.nan_to_num(np.degrees(np.arccos(cosine)))
    return float((angle * mask).sum() / mask.sum())


def psnr_by_hand(given: Given) -> float:
    return float(-10 * np.log10(np.float64(rmse_by_hand(given)) ** 2))


def ssim_by_hand(given: Given) -> float:
    """Naive: over the whole picture, whatever the mask, in float32, without the constants."""
    x, y = (image.mean(axis=2).astype(np.float32) for image in given[:2])
    covariance = ((x - x.mean()) * (y - y.mean())).mean()
    return float(4 * x.mean() * y.mean() * covariance / ((x.mean() ** 2 + y.mean() ** 2) * (x.var() + y.var())))


METRICS = {
    "RMSE": (image_rmse, rmse_by_hand),
    "scale-invariant RMSE": (si_rmse, si_rmse_by_hand),
    "angular error": (angular_error_deg, angle_by_hand),
    "PSNR": (psnr, psnr_by_hand),
    "SSIM": (ssim, ssim_by_hand),
}


def score(metric: str, name: str, prediction: Any, truth: Any, must: Must, naive: Any = None, mask: Any = MASK) -> Any:
    function, by_hand = METRICS[metric]
    sentence = f"the {metric} of {name}" + ("" if " is " in name else " is right")
    return row(sentence, (prediction, truth, mask), lambda given: function(*given), must, naive or by_hand)


def rmse_of_samples(given: Given) -> float:
    return float(np.std(given[0] - given[1], ddof=1))


def rmse_or_1(given: Given) -> float:
    return rmse_by_hand(given) or 1.0


def rmse_in_float32(given: Given) -> float:
    return float(np.sqrt(np.cumsum(given[0].astype(np.float32) ** 2, dtype=np.float32)[-1] / given[0].size))


def angle_of_other_colours(given: Given) -> float:
    return angle_by_hand((given[0] + 1e-3, given[1] * [1, 1, 0.99], given[2]))


DARK_PIXEL, BRIGHT_PIXEL, ONE = np.full((1, 1, 3), 0.25), np.full((1, 1, 3), 0.75), np.ones((1, 1))
YELLOW, YELLOW_DEG = GREY * [1, 1, 0], np.degrees(np.arctan2(1, np.sqrt(2)))
HUE_DEG = np.degrees(1e-9 / 0.5 * np.sqrt(2) / 3)
TEXTURE = 1e-9 * PICTURE
NO_PIXELS, NO_MASK = np.zeros((0, 0, 3)), np.zeros((0, 0))
MILLION, ALL = np.full((1000, 1000, 3), 0.1), np.ones((1000, 1000))
SI, ANGLE = "scale-invariant RMSE", "angular error"

PICTURES = [
    *(score(m, "pictures under an empty mask is undefined", PICTURE, OTHER, UNDEFINED, mask=MASK * 0) for m in METRICS),
    *(score(m, "pictures without pixels is undefined", NO_PIXELS, NO_PIXELS, UNDEFINED, mask=NO_MASK) for m in METRICS),
    score("RMSE", "one pixel", DARK_PIXEL, BRIGHT_PIXEL, equal(0.5), rmse_of_samples, ONE),
    score("SSIM", "one pixel is that of its luminance alone", DARK_PIXEL, BRIGHT_PIXEL, near(0.6001, 1e-3), mask=ONE),
    score("SSIM", "equal constant pictures is exactly 1", GREY, GREY, equal(1.0)),
    score("SSIM", "black pictures is exactly 1", BLACK, BLACK, equal(1.0)),
    score(ANGLE, "a picture and its double is 0", PICTURE, PICTURE * 2, at_most(1e-13)),
    score(ANGLE, "hues that differ by 1e-9", GREY, GREY + [1e-9, 0, 0], near(HUE_DEG, 1e-12)),
    score(ANGLE, "a black prediction is undefined and not perfect", BLACK, PICTURE, UNDEFINED),
    score(ANGLE, "a black truth is undefined", PICTURE, BLACK, UNDEFINED),
    score(ANGLE, "opposite colours", GREY, -GREY, equal(180.0), angle_of_other_colours),
    score(ANGLE, "denormal colours", GREY * 1e-320, YELLOW, near(YELLOW_DEG, 0.1)),
    score(ANGLE, "colours of 1e200", GREY * 1e200, YELLOW, near(YELLOW_DEG, 1e-9)),
    score(SI, "an exactly scaled picture is 0", PICTURE * 3, PICTURE, at_most(1e-15)),
    score(SI, "a picture scaled to 1e-200 is 0", PICTURE * 1e-200, PICTURE, at_most(1e-15)),
    score(SI, "a picture scaled to 1e200 is 0", PICTURE * 1e200, PICTURE, at_most(1e-15)),
    score(SI, "a black prediction is the truth's own size", BLACK, GREY, equal(0.5)),
    score(SI, "black pictures is 0", BLACK, BLACK, equal(0.0)),
    score("RMSE", "pictures that differ by 1e200", GREY * 2e200, BLACK, near(1.0e200, 1e186)),
    score("RMSE", "pictures that differ by 1e-200 is not 0", GREY * 2e-200, BLACK, near(1.0e-200, 1e-214), rmse_or_1),
    score(
        "RMSE", "a million pixels of a tenth is a tenth", MILLION, MILLION * 0, near(0.1, 1e-12), rmse_in_float32, ALL
    ),
    score("PSNR", "pictures that differ by 1e-200 is finite", GREY * 2e-200, BLACK, near(4000.0, 1e-6)),
    score("SSIM", "flat pictures with a texture of 1e-9", GREY + TEXTURE, GREY - TEXTURE, near(1.0, 1e-6)),
    score("SSIM", "black and white", BLACK, BLACK + 1, near(1e-4, 1e-6)),
    *(
        score(m, "grey and black under a mask of 5e-324", GREY, BLACK, near(value, 1e-3), mask=MASK * 5e-324)
        for m, value in (("RMSE", 0.5), ("PSNR", 6.0206), ("SSIM", 4e-4))
    ),
]


def shc(given: tuple[Any, Any]) -> float:
    return shc_rmse(*given)


def shc_by_hand(given: tuple[Any, Any]) -> float:
    """Naive: broadcasts whatever comes."""
    return float(np.sqrt(np.mean((given[0] - given[1]) ** 2)))


SH = np.ones((9, 3))
NO_COEFFICIENTS = {
    "coefficients with NaN are refused with their number": ((SH * np.nan, SH), "got 27 NaN or infinite"),
    "coefficients of another order are not stretched": ((SH[:1], SH), "expected two equal shapes"),
    "no coefficients are refused": ((SH[:0], SH[:0]), "not empty"),
}
FAR, NEAR = (SH * 1e200, SH * 0), (SH * 1e-200, SH * 0)
CASES = [
    *PICTURES,
    row("coefficients that differ by 1e200 have that error", FAR, shc, near(1e200, 1e186), shc_by_hand),
    row(
        "coefficients that hardly differ are not equal",
        NEAR,
        shc,
        near(1e-200, 1e-214),
        lambda given: shc_by_hand(given) or 1.0,
    ),
    *(row(name, given, shc, refused(words)) for name, (given, words) in NO_COEFFICIENTS.items()),
]

test_hard_case = each(CASES)
