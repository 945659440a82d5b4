"""Metrics: how wrong is a light, and how wrong does a picture under it look? Numbers that stay finite.

The usual protocol for lighting estimation: spheres (mirror, silver, diffuse) rendered under both lights and compared
inside their alpha by RMSE, scale-invariant RMSE and RGB angular error, plus PSNR and SSIM of the displayed picture and
the RMSE of the coefficients. The textbook one-liners fail on legal input: a black prediction gives NaN and is counted
as 0 degrees wrong, an exactly scaled copy gives NaN or a false angle, equal images give an infinite PSNR. Here all sums
are float64, scale-invariance uses the residual itself and not a difference of large squares, angles come from atan2 and
not from an arc cosine, and what is not defined is None, never NaN or infinity, which JSON cannot hold.

Pictures are (H, W, 3), linear colour that may be negative or above 1; `psnr` and `ssim` take sRGB-encoded colour in
[0, 1] and refuse anything else, because linear light handed to them by mistake would look like a result. `mask` is
(H, W): bool, or weights in [0, 1] such as an alpha channel. Every mean is a mean with these weights, and pixels of
weight 0 have no influence, not even through a window: they may hold NaN. A mask without weight gives None. All raise
ValueError for shapes that differ, a mask outside [0, 1], and with their number for pixels inside the mask that are not
finite.

Beside published figures, by the scripts that made them (StyleLight, Wang et al. 2022, `evaluation/fast_rmse.py`, and
DiffusionLight, Phongthawee et al. 2024, `stylelight/fast_rmse.py` of DiffusionLight-evaluation): RMSE and
scale-invariant RMSE there sum the squares over the channels and divide by pixels, so they are sqrt(3) times ours. Their
angle counts a black pixel of either picture as 0 degrees and anything beyond 90 as 90, so it lies below ours. Their
masks are all pixels of the prediction with an alpha above 0, and their spheres were rendered under panoramas that were
tone-mapped (gamma 2.4, the median at 0.5, not clipped), not under linear light. The table for arrays of spheres in
DiffusionLight-evaluation divides by channels as well, as we do, and drops pixels whose angle is NaN. The normalised
RMSE that DiffusionLight added is not here.

No number here tracks what people prefer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import LUMINANCE
from xihenet.records import ArrayF64

RANGE_TOLERANCE = 1e-4  # Renderers sum alpha and colour in float32 and end up a little above 1.
SSIM_SIGMA = 1.5
SSIM_RADIUS = 5  # 11 x 11, as Wang et al. 2004
SSIM_K1, SSIM_K2 = 0.01, 0.03


@dataclass(frozen=True)
class AngularError:
    """Angle between predicted and true colour, and how many pixels could not be asked.

    A black pixel has no hue. It is left out of the mean and counted, so that a prediction that is black in places
    cannot pass as right there.
    """

    mean_deg: float | None  # weighted mean over the pixels where both colours have a direction; None without any
    n_pixels: int  # with a weight above 0, black ones included
    n_black_prediction: int  # of these, pixels whose prediction is black and whose truth is not
    n_black_truth: int  # of these, pixels whose truth is black, whatever the prediction


def shc_rmse(a: ArrayLike, b: ArrayLike) -> float:
    """Root mean square difference over all coefficients and channels, in their unit.

    Both are of one shape, ((order + 1)^2, 3) or a stack of such. ValueError for different shapes, for none, and for NaN
    or infinity.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape or first.size == 0:
        raise ValueError(f"shc_rmse: expected two equal shapes that are not empty, got {first.shape}, {second.shape}")
    n_bad = np.count_nonzero(~np.isfinite(first)) + np.count_nonzero(~np.isfinite(second))
    if n_bad:
        raise ValueError(f"shc_rmse: expected finite coefficients, got {n_bad} NaN or infinite ones")
    return _root_mean_square(first - second, np.ones(first.shape))


def share_above_white(ldr_sh: ArrayLike, hdr_sh: ArrayLike) -> float | None:
    """The share of the light around a position that lies above white, which no estimator of clipped light can know.

    Both are ((order + 1)^2, 3) radiance coefficients of the same light at one exposure, clipped at white and whole.
    1 - clipped / whole of the mean radiance, L00 summed over the channels, in [0, 1]; None where there is no light.
    ValueError for other shapes, NaN or infinity. L00 is linear in the light, so nothing rings here.
    """
    clipped, whole = np.asarray(ldr_sh, dtype=np.float64), np.asarray(hdr_sh, dtype=np.float64)
    if clipped.shape != whole.shape or clipped.ndim != 2 or not len(clipped) or clipped.shape[1] != 3:
        raise ValueError(
            f"share_above_white: expected two equal shapes ((order + 1)^2, 3), got {clipped.shape}, {whole.shape}"
        )
    if not (np.isfinite(clipped).all() and np.isfinite(whole).all()):
        raise ValueError("share_above_white: expected finite coefficients, got NaN or infinity")
    mean = float(whole[0].sum())
    if mean <= 0:
        return None
    return min(1.0, max(0.0, 1.0 - float(clipped[0].sum()) / mean))


def _checked_weights(mask: ArrayLike, size: tuple[int, ...]) -> ArrayF64:
    weights = np.asarray(mask, dtype=np.float64)
    if weights.shape != size:
        raise ValueError(f"mask: expected shape {size} as the images, got {weights.shape}")
    if weights.size and not (weights.min() >= -RANGE_TOLERANCE and weights.max() <= 1 + RANGE_TOLERANCE):
        raise ValueError("mask: expected bool or weights in [0, 1], got values outside or NaN")
    weights = np.clip(weights, 0.0, 1.0)
    # Means are relative to the weights' sum; beside it the smallest weights would lose their products to underflow.
    return weights / largest if (largest := weights.max(initial=0.0)) > 0 else weights


def _checked_images(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    """Both images as (H, W, 3) float64 with 0 where the weight is 0, and the weights (H, W)."""
    images = [np.asarray(image, dtype=np.float64) for image in (prediction, truth)]
    if images[0].shape != images[1].shape or images[0].ndim != 3 or images[0].shape[2] != 3:
        raise ValueError(f"images: expected two equal shapes (H, W, 3), got {images[0].shape} and {images[1].shape}")
    weights = _checked_weights(mask, images[0].shape[:2])
    inside = [np.where((weights > 0)[..., None], image, 0.0) for image in images]
    for name, image in zip(("prediction", "truth"), inside, strict=True):
        n_bad = np.count_nonzero(~np.isfinite(image).all(axis=2))
        if n_bad:
            raise ValueError(f"{name}: expected finite colour inside the mask, got {n_bad} pixels with NaN or infinity")
    return inside[0], inside[1], weights


def _checked_srgb(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    """As `_checked_images`, and refuses colour outside [0, 1]."""
    predicted, true, weights = _checked_images(prediction, truth, mask)
    for name, image in (("prediction", predicted), ("truth", true)):
        n_outside = np.count_nonzero(((image < -RANGE_TOLERANCE) | (image > 1 + RANGE_TOLERANCE)).any(axis=2))
        if n_outside:
            raise ValueError(f"{name}: expected sRGB-encoded colour in [0, 1], got {n_outside} pixels outside")
    return predicted, true, weights


def _root_mean_square(difference: ArrayF64, weights: ArrayF64) -> float:
    """Mean over pixels and channels of the squared difference, its root; the weights must not all be 0.

    Brought to size 1 by a power of two, which rounds nothing: squares of 1e200 and of 1e-200 would leave float64, and
    two lights that differ would score infinity or a perfect 0.
    """
    exponent = np.frexp(np.abs(difference).max())[1]
    scaled = np.ldexp(difference, -exponent).reshape(weights.size, -1)
    mean_square = np.einsum("pc,pc,p->", scaled, scaled, weights.ravel()) / (scaled.shape[1] * weights.sum())
    return float(np.ldexp(np.sqrt(mean_square), exponent))


def image_rmse(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> float | None:
    """Root mean square error over pixels and channels of linear colour, in its unit; None for an empty mask."""
    predicted, true, weights = _checked_images(prediction, truth, mask)
    return _root_mean_square(predicted - true, weights) if weights.any() else None


def si_rmse(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> float | None:
    """Scale-invariant RMSE: the RMSE after the one factor on the prediction that makes it smallest.

    In the truth's unit; with alpha = <p, g> / <p, p>, the RMSE of alpha p - g. A black prediction cannot be scaled to
    anything: it scores the truth's own root mean square. None for an empty mask.
    """
    predicted, true, weights = _checked_images(prediction, truth, mask)
    if not weights.any():
        return None
    # The squares of a very dim prediction would leave float64 and make it look black. A power of two rounds nothing.
    scaled = np.ldexp(predicted, -np.frexp(np.abs(predicted).max())[1])
    power = np.einsum("hwc,hwc,hw->", scaled, scaled, weights)
    alpha = np.einsum("hwc,hwc,hw->", scaled, true, weights) / power if power > 0 else 0.0
    return _root_mean_square(alpha * scaled - true, weights)


def hues(image: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
    """Each pixel (..., 3) divided by its largest component, 0 where it is black; and that component, (...)."""
    largest = np.abs(image).max(axis=-1)
    return image / np.where(largest > 0, largest, 1.0)[..., None], largest


def angles_deg(first: ArrayF64, second: ArrayF64) -> ArrayF64:
    """(...) between vectors (..., 3): atan2(|a x b|, a . b), 0 exactly for equal ones."""
    across = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.degrees(np.arctan2(across, np.einsum("...c,...c->...", first, second)))


def angular_error(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> AngularError:
    """Angle between the RGB vectors of prediction and truth, per pixel, black pixels counted.

    0 exactly for equal images, 0 to 90 degrees for colours >= 0 and to 180 otherwise.
    """
    predicted, true, weights = _checked_images(prediction, truth, mask)
    (hue_p, largest_p), (hue_g, largest_g) = hues(predicted), hues(true)
    is_inside = weights > 0
    asked = weights * ((largest_p > 0) & (largest_g > 0))
    return AngularError(
        mean_deg=float((angles_deg(hue_p, hue_g) * asked).sum() / asked.sum()) if asked.any() else None,
        n_pixels=int(np.count_nonzero(is_inside)),
        n_black_prediction=int(np.count_nonzero(is_inside & (largest_p == 0) & (largest_g > 0))),
        n_black_truth=int(np.count_nonzero(is_inside & (largest_g == 0))),
    )


def angular_error_deg(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> float | None:
    """`angular_error(...).mean_deg`: degrees, None where no pixel has a hue on both sides."""
    return angular_error(prediction, truth, mask).mean_deg


def psnr(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> float | None:
    """Peak signal-to-noise ratio of displayed pictures, in decibels against a peak of 1.

    None for an empty mask and for equal images, where the ratio is infinite. ValueError for colour outside [0, 1], too.
    """
    predicted, true, weights = _checked_srgb(prediction, truth, mask)
    rmse = _root_mean_square(predicted - true, weights) if weights.any() else 0.0
    return float(-20 * np.log10(rmse)) if rmse > 0 else None


def _gaussian_sum(image: ArrayF64) -> ArrayF64:
    """Sum of each pixel's 11 x 11 surroundings (H, W) under a Gaussian; 0 outside the image."""
    kernel = np.exp(-0.5 * (np.arange(-SSIM_RADIUS, SSIM_RADIUS + 1) / SSIM_SIGMA) ** 2)
    height, width = image.shape
    padded = np.pad(image, SSIM_RADIUS)
    rows = sum(weight * padded[shift : shift + height] for shift, weight in enumerate(kernel))
    return np.asarray(sum(weight * rows[:, shift : shift + width] for shift, weight in enumerate(kernel)))


def _local_ssim(x: ArrayF64, y: ArrayF64, weights: ArrayF64) -> ArrayF64:
    """SSIM of the window around each pixel of two luma images, (H, W); of no meaning where the weight is 0."""
    window_weight = _gaussian_sum(weights)
    window_weight[weights == 0] = 1.0
    mean_x, mean_y, mean_xx, mean_yy, mean_xy = (
        _gaussian_sum(moment * weights) / window_weight for moment in (x, y, x * x, y * y, x * y)
    )
    variances = (mean_xx - mean_x * mean_x) + (mean_yy - mean_y * mean_y)
    covariance = mean_xy - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + SSIM_K1**2) / (mean_x * mean_x + mean_y * mean_y + SSIM_K1**2)
    structure = (2 * covariance + SSIM_K2**2) / (variances + SSIM_K2**2)
    return np.asarray(luminance * structure, dtype=np.float64)


def ssim(prediction: ArrayLike, truth: ArrayLike, mask: ArrayLike) -> float | None:
    """Structural similarity of the luma of displayed pictures (Wang et al. 2004), averaged over the mask.

    The 11 x 11 Gaussian window (sigma 1.5) is multiplied by the mask and normalised again, so local means and
    variances come from inside the mask alone, at its edge and at the image's border too. With windows wholly inside it
    is the published formula. At most 1, and 1 exactly for equal images; None for an empty mask. Raises as `psnr`.
    """
    predicted, true, weights = _checked_srgb(prediction, truth, mask)
    if not weights.any():
        return None
    local = _local_ssim(predicted @ LUMINANCE, true @ LUMINANCE, weights)
    return float((local * weights).sum() / weights.sum())
