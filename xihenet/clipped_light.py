"""Light clipped at white, from pictures that are still noisy.

A phone's picture ends at white, and what it could know of the light ends there too: the mean over directions of
min(light, 1). Clipping a noisy picture gives less than that, however many seeds are averaged, since noise above white
is cut and noise below it is not: 9 to 31 % less in dim rooms. Denoising first leaves 3 to 35 %.

Chosen: a smooth picture only decides whether a direction is white; where it is not, the noisy pictures themselves
count, whose mean is right. It is one of its own, so that their noise has no say. A wrong verdict costs little: it
happens where the light is near white, and there both answers are near each other. Rejected: the mean of the other
pictures, each denoised. From one ray in each pixel a denoiser flattens what is sharp: a ring of light on a chair, 1.5
times white, came out below it, and the clipped light was 3.5 % too bright; from four rays half of that is left.

Lamps and sky that a ray meets directly are free of noise. Each pixel has one ray, so that what it meets is clipped for
itself, whatever lies next to it: with four rays a pixel in which the bars of a window and the sky share was white as a
whole, and such a room had 5 % too much light. Next to lamps a denoiser runs over; there, what was reflected decides.

In fog it is chance whether a ray gets through to a lamp, and what it meets says nothing of its direction. There the
mean of all rays around decides, where the lamp fills all pixels around; its rim is left to each ray, since a mean makes
the lamp half a pixel wider.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xihenet.colour import in_any_channel
from xihenet.mirror_ball import neighbours, project_mirror_ball
from xihenet.records import ArrayBool, ArrayF32, ArrayF64

NEIGHBOURHOOD = 3  # Pixels along a side over which light beside lamps is smoothed

# The same for all light where there is no denoiser: the median of such means, which keeps the edges of what is white.
# Of all pictures together, since a few rays say little.
MEDIANS = 5


def clipped_sh(
    radiance: Sequence[ArrayF32], emission: Sequence[ArrayF32], smooth: ArrayF32 | None, order: int = 2,
    fog: ArrayBool | None = None,
) -> ArrayF64:  # fmt: skip
    """Coefficients of the light clipped at white, as each of S pictures has it; their mean is the answer.

    (S, (order + 1)^2, 3) float64. ValueError for no picture at all, or for pixels that are not finite.

    Parameters
    ----------
    radiance : S mirror balls (N, N, 3) of one ray in each pixel, carrying the exposure; white is 1
    emission : the part of them that rays met directly, lamps and sky, which has no noise
    smooth : (N, N, 3) the same seen once more, denoised; None where no denoiser is to be had, at the cost of some bias
    fog : (N, N, 1) where rays may be scattered on their way; None without any
    """
    if not len(radiance):
        raise ValueError("clipped_sh: expected at least one picture, got none")
    # Asked before anything is clipped: white hides what is infinite, and black what is NaN.
    every = (*radiance, *emission, *([] if smooth is None else [smooth]))
    n_bad = sum(np.count_nonzero(in_any_channel(~np.isfinite(one))) for one in every)
    if n_bad:
        raise ValueError(f"clipped_sh: expected finite pictures, got {n_bad} pixels with NaN or infinity")
    # Light below black is none to a picture.
    radiance, emission = ([np.maximum(picture, 0) for picture in some] for some in (radiance, emission))
    reflections = _Reflections(radiance, emission)
    judged = _median_is_white(reflections.mean()) if smooth is None else smooth >= 1
    by_chance, around = _met_by_chance(reflections.is_lamp, fog), None
    if by_chance.any():
        around = neighbours(np.mean(radiance, axis=0), NEIGHBOURHOOD).mean(axis=0)
    lights = []
    for number, (seen, met) in enumerate(zip(radiance, emission, strict=True)):
        is_white = judged.copy()
        is_white[reflections.near_lamp] = reflections.without(number) >= 1
        is_lamp = reflections.is_lamp[number][..., 0]
        is_white[is_lamp] = met[is_lamp] >= 1
        if around is not None:
            is_white = np.where(by_chance, around >= 1, is_white)
        lights.append(project_mirror_ball(np.where(is_white, np.float32(1), seen), order))
    return np.array(lights)


def relative_noise(lights: ArrayF64, smallest: float) -> float | None:
    """Standard error of the mean of S independent lights (S, n, 3), relative to it; None for a single one.

    A light whose norm is below `smallest` is held against that instead.
    """
    if len(lights) < 2:
        return None
    # By a power of two, which rounds nothing: the squares of light as it comes may not fit float64.
    exponent = -np.frexp(np.abs(lights).max(initial=smallest))[1]
    lights, smallest = np.ldexp(lights, exponent), float(np.ldexp(smallest, exponent))
    variance = lights.var(axis=0, ddof=1).sum() / len(lights)
    return float(np.sqrt(variance) / max(float(np.linalg.norm(lights.mean(axis=0))), smallest))


def _met_by_chance(is_lamp: Sequence[ArrayBool], fog: ArrayBool | None) -> ArrayBool:
    """(N, N, 1) where a lamp behind fog fills a pixel and those around, of pictures (N, N, 1) some of which met it."""
    if fog is None:
        return np.zeros_like(is_lamp[0])
    # Pixels in which no ray got through are filled, and the lamp is no larger for it.
    lamp = np.any(is_lamp, axis=0)
    for inside in (False, True, True):
        around = neighbours(lamp, NEIGHBOURHOOD)
        lamp = around.all(axis=0) if inside else around.any(axis=0)
    return lamp & fog


def _median_is_white(picture: ArrayF32) -> ArrayBool:
    """(N, N, 3) where the median of a pixel's neighbours is white: where more than half of them are."""
    return neighbours(picture >= 1, MEDIANS).sum(axis=0, dtype=np.uint8) > MEDIANS**2 // 2


class _Reflections:
    """What the rays of S pictures met that is neither lamp nor sky.

    `is_lamp` says of each picture (N, N, 1) where its ray met one, `near_lamp` in which rows and columns any did nearby
    but not all of them right there.
    """

    def __init__(self, radiance: Sequence[ArrayF32], emission: Sequence[ArrayF32]) -> None:
        self.is_lamp: list[ArrayBool] = [in_any_channel(met > 0) for met in emission]
        self._seen = [picture.copy() for picture in radiance]
        for seen, lamp in zip(self._seen, self.is_lamp, strict=True):
            seen[lamp[..., 0]] = 0
        self._total: ArrayF32 = np.sum(self._seen, axis=0)
        self._counts: ArrayF32 = np.sum(np.logical_not(self.is_lamp), axis=0, dtype=np.float32)
        is_near_lamp = neighbours(np.any(self.is_lamp, axis=0), NEIGHBOURHOOD).any(axis=0)
        self.near_lamp = np.nonzero((is_near_lamp & ~np.all(self.is_lamp, axis=0))[..., 0])
        steps = np.mgrid[:NEIGHBOURHOOD, :NEIGHBOURHOOD].reshape(2, -1, 1) - NEIGHBOURHOOD // 2
        rows, columns = (np.array(self.near_lamp)[:, None] + steps).clip(0, len(is_near_lamp) - 1)
        self._beside = rows * len(is_near_lamp) + columns

    def without(self, number: int) -> ArrayF32:
        """(K, 3) their mean over the pixels around each of `near_lamp`, of all pictures but one; 0 where there is none.

        Of a single picture, its own.
        """
        total, counts = self._total, self._counts
        if len(self._seen) > 1:
            total, counts = total - self._seen[number], counts - ~self.is_lamp[number]
        around = (each.reshape(-1, each.shape[-1]).take(self._beside, axis=0) for each in (total, counts))
        return _mean_of(*around)

    def mean(self) -> ArrayF32:
        """(N, N, 3) the same of all pictures, of every pixel."""
        return _mean_of(neighbours(self._total, NEIGHBOURHOOD), neighbours(self._counts, NEIGHBOURHOOD))


def _mean_of(totals: ArrayF32, counts: ArrayF32) -> ArrayF32:
    return totals.sum(axis=0) / np.maximum(counts.sum(axis=0), 1)
