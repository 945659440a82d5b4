"""Light clipped at white, from pictures that are still noisy.

A phone's picture ends at white, and what it could know of the light ends there too: the mean over directions of
min(light, 1). Clipping a noisy picture gives less than that, however many seeds are averaged, since noise above white
is cut and noise below it is not: 9 to 31 % less in dim rooms. Denoising first leaves 3 to 35 %.

Chosen: a smooth picture only decides whether a direction is white; where it is not, the noisy picture itself counts,
whose mean is right. A direction is judged by all pictures but the one that counts, so that its own noise has no say. A
wrong verdict costs little: it happens where the light is near white, and there both answers are near each other. A
picture has a few rays in each pixel: denoised from one ray, what lies close to a small lamp came out a third too dark.

Light that rays meet directly, lamps and sky, is free of noise. A pixel that they fill in part has the share of the
brightest next to it, and white times that share counts: so the edge of a lamp does not count as a whole pixel.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihenet.mirror_ball import ball_coverage, neighbours, project_mirror_ball
from xihenet.records import ArrayBool, ArrayF32, ArrayF64

NEIGHBOURHOOD = 5
"""Pixels along a side over which light beside lamps, and all light where there is no denoiser, is smoothed."""


def clipped_sh(
    radiance: Sequence[ArrayF32], emission: Sequence[ArrayF32], smooth: Sequence[ArrayF32] | None, order: int = 2
) -> ArrayF64:
    """Coefficients of the light clipped at white, as each of S pictures has it; their mean is the answer.

    Parameters
    ----------
    radiance : S mirror balls (N, N, 3), carrying the exposure; white is 1
    emission : the part of them that rays met directly, lamps and sky, which has no noise
    smooth : the same pictures denoised; None where no denoiser is to be had, at the cost of some bias
    order : highest band

    Returns
    -------
    (S, (order + 1)^2, 3) float64. ValueError for no picture at all, or for pixels that are not finite.
    """
    if not len(radiance):
        raise ValueError("clipped_sh: expected at least one picture, got none")
    # Light below black is none to a picture.
    radiance, emission = ([np.maximum(picture, 0) for picture in some] for some in (radiance, emission))
    pictures = smoothed(radiance, emission) if smooth is None else smooth
    together, n = np.sum(pictures, axis=0), len(radiance)
    brightest = neighbours(np.mean(emission, axis=0), 3).max(axis=0)
    is_lamp = np.any([met.max(axis=-1) > 0 for met in emission], axis=0)
    reflected = np.sum(radiance, axis=0) - np.sum(emission, axis=0)
    is_beside = _is_beside(is_lamp)
    lights = []
    for noisy, met, own in zip(radiance, emission, pictures, strict=True):
        others = (together - own) / (n - 1) if n > 1 else together
        if is_lamp.any():
            beside = (reflected - (noisy - met)) / (n - 1) if n > 1 else reflected
            others = np.where(is_beside, _spread(beside, is_lamp), others)
        is_amid = is_lamp[..., None] & ~is_beside
        lights.append(project_mirror_ball(_clipped(noisy, met, others, brightest, is_amid), order))
    return np.array(lights)


def _clipped(noisy: ArrayF32, met: ArrayF32, smooth: ArrayF32, brightest: ArrayF32, is_amid: ArrayBool) -> ArrayF32:
    """One picture clipped, by the verdict of a smooth one and the brightest that rays met next to each pixel."""
    white = ball_coverage(len(noisy))[..., None]
    share = np.minimum(met / np.maximum(brightest, 1e-12), white)
    is_white = smooth >= 1
    beside = share * np.minimum(brightest, 1) + np.where(is_white, white - share, noisy - met)
    # Amid a lamp or the sky nothing else has a share, and what is painted there counts as it is.
    amid = np.where((met >= white) | (smooth >= 1), white, noisy)
    clipped: ArrayF32 = np.where(is_amid, amid, beside)
    return clipped


def smoothed(radiance: Sequence[ArrayF32], emission: Sequence[ArrayF32]) -> list[ArrayF32]:
    """Pictures smoothed without a denoiser: medians over a neighbourhood of means over pixels nearby.

    Of all pictures together, since a few rays say little. A pixel that is white in most pictures stays so, however
    small it is.
    """
    reflected = np.array([noisy - met for noisy, met in zip(radiance, emission, strict=True)])
    spread = np.median(neighbours(neighbours(reflected.mean(axis=0), 3).mean(axis=0), NEIGHBOURHOOD), axis=0)
    usual = np.median(reflected, axis=0) if len(reflected) > 2 else np.zeros_like(spread)
    picture = np.maximum(spread, usual).astype(np.float32)
    return [picture] * len(reflected)


def relative_noise(lights: ArrayF64, smallest: float) -> float | None:
    """Standard error of the mean of S independent lights (S, n, 3), relative to it; None for a single one.

    A light whose norm is below `smallest` is held against that instead.
    """
    if len(lights) < 2:
        return None
    variance = lights.var(axis=0, ddof=1).sum() / len(lights)
    return float(np.sqrt(variance) / max(float(np.linalg.norm(lights.mean(axis=0))), smallest))


def _is_beside(is_lamp: ArrayBool) -> ArrayBool:
    """(N, N, 1) the pixels at the edges of lamps, on either side, into which a denoiser runs over."""
    nearby = neighbours(is_lamp[..., None].astype(np.float32), 3)
    beside: ArrayBool = nearby.any(axis=0) & ~nearby.all(axis=0)
    return beside


def _spread(reflected: ArrayF32, is_lamp: ArrayBool) -> ArrayF32:
    """The mean of each pixel's neighbours that are no lamps; its own where all are."""
    counts = (~is_lamp[..., None]).astype(np.float32)
    n = neighbours(counts, NEIGHBOURHOOD).sum(axis=0)
    total = neighbours(reflected * counts, NEIGHBOURHOOD).sum(axis=0)
    spread: ArrayF32 = np.where(n > 0, total / np.maximum(n, 1), reflected)
    return spread
