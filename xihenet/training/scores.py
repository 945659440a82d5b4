"""Errors of M lights, by every measure that the report states.

The same errors as `xihenet.metrics` gives for one light at a time, for thousands at once: of coefficients, of the
irradiance on surfaces, of where the light comes from, and of what three spheres would show. Errors of coefficients and
irradiance are pooled over all clouds, as the paper's figures are; those of pictures are means over clouds, as the usual
protocol has them. Everything is float64.

A measure without anything to measure is None. A light that is not finite is no error of a size but a broken predictor:
it raises ValueError. Not here: what an error is divided by, and whose lights these are.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.colour import LUMINANCE
from xihenet.light.light_picture import SPHERES, sphere_transfer
from xihenet.metrics import angles_deg, hues
from xihenet.records import ArrayBool, ArrayF64
from xihenet.sh import cosine_lobe
from xihenet.sh_basis import band_slice, basis
from xihenet.sphere import AnchorLattice

COVERAGE_EDGES = (0.0, 0.25, 0.4, 0.55, 0.7, 1.0)
N_NORMALS = 64
SPHERE_SIZE = 16
"""Pixels across a sphere's picture: its mean errors are within some percent of those of large pictures."""

DOMINANT_SHARE = 0.15
"""Length of the l = 1 vector of luminance over its l = 0 coefficient from which a light is said to come from somewhere:
0 is light from everywhere, 1.73 light from one point."""

UNDIRECTED_DEG = 90.0
"""What a predicted light without any direction is held to be wrong by: the median of guesses at random."""

_CLOUDS_AT_ONCE = 256


@dataclass(frozen=True)
class DominantLight:
    """Median angle between the l = 1 vectors of luminance over the clouds whose true light comes from somewhere, and
    of how many clouds it does not, see `DOMINANT_SHARE`.
    """

    median_deg: float | None
    n_left_out: int


@dataclass(frozen=True)
class SphereErrors:
    """Means over clouds of the errors of one sphere's picture, those of `xihenet.metrics`; light below 0 is black.

    The angle is over clouds with any pixel to ask; of all pixels, it leaves out the `black_share` that is black in the
    prediction alone.
    """

    rmse: float | None
    si_rmse: float | None
    angular_deg: float | None
    black_share: float | None


@dataclass(frozen=True)
class Scores:
    """All errors of M lights."""

    n_clouds: int
    rmse: float | None  # SHC RMSE of all clouds
    by_band: tuple[float | None, ...]  # the same, of l = 0, 1, 2
    by_coverage: tuple[float | None, ...]  # and of the clouds between the `COVERAGE_EDGES`
    irradiance: float | None  # RMSE at fixed normals over the root mean square of the true one, pooled
    irradiance_percent: float | None  # mean over clouds of that ratio within each, in percent; black ones left out
    dominant: DominantLight
    spheres: dict[str, SphereErrors]  # of each of `SPHERES`

    @classmethod
    def of(cls, lights: ArrayLike, truth: ArrayLike, coverage: ArrayLike) -> Scores:
        """Every error of M lights against their truth, both (M, 9, 3) radiance coefficients; M may be 0.

        `coverage` (M,) is the share of the sphere seen, 0 to 1. ValueError for other shapes, and with their number for
        lights that are not finite.
        """
        predicted, true = checked_lights(lights, truth)
        seen = np.asarray(coverage, np.float64)
        if seen.shape != (len(true),):
            raise ValueError(f"coverage: expected shape ({len(true)},), got {seen.shape}")
        error = predicted - true
        return cls(
            len(true),
            pooled_rms(error),
            tuple(pooled_rms(error[:, band_slice(band)]) for band in range(3)),
            tuple(pooled_rms(error[group]) for group in coverage_groups(seen)),
            *_irradiance_errors(predicted, true),
            dominant_light(predicted, true),
            sphere_errors(predicted, true),
        )


def checked_lights(lights: ArrayLike, truth: ArrayLike) -> tuple[ArrayF64, ArrayF64]:
    """Both as (M, 9, 3) float64; ValueError for other or different shapes, NaN or infinity."""
    predicted, true = np.asarray(lights, np.float64), np.asarray(truth, np.float64)
    if predicted.shape != true.shape or true.shape[1:] != (9, 3):
        raise ValueError(f"lights: expected two equal shapes (M, 9, 3), got {predicted.shape} and {true.shape}")
    for name, values in (("lights", predicted), ("truth", true)):
        n_bad = int(np.count_nonzero(~np.isfinite(values).all(axis=(1, 2))))
        if n_bad:
            raise ValueError(f"{name}: expected finite coefficients, got {n_bad} lights with NaN or infinity")
    return predicted, true


def pooled_rms(values: ArrayLike) -> float | None:
    """Root mean square of all values; None for none."""
    array = np.asarray(values, np.float64)
    return float(np.sqrt(np.mean(np.square(array)))) if array.size else None


def rmse_of_each(lights: ArrayLike, truth: ArrayLike) -> ArrayF64:
    """(M,) SHC RMSE of each light; raises as `checked_lights`."""
    predicted, true = checked_lights(lights, truth)
    return np.sqrt(np.mean((predicted - true) ** 2, axis=(1, 2)))


def ratio(above: float | None, below: float | None) -> float | None:
    """`above` / `below`, None where either is None or `below` is 0."""
    return above / below if above is not None and below else None


def coverage_groups(coverage: ArrayF64, edges: Sequence[float] = COVERAGE_EDGES) -> list[ArrayBool]:
    """Masks (M,) of the clouds between each two edges: the lower one included, the upper one where it is 1."""
    return [(coverage >= a) & ((coverage < b) | (b == 1)) for a, b in itertools.pairwise(edges)]


def dominant_light(lights: ArrayF64, truth: ArrayF64) -> DominantLight:
    """Angle between where two lights (M, 9, 3) come from, over the clouds where the true one has a direction."""
    # The l = 1 coefficients are of y, z, x: of both lights alike.
    predicted, true = lights[:, 1:4] @ LUMINANCE, truth[:, 1:4] @ LUMINANCE
    is_asked = np.linalg.norm(true, axis=1) > DOMINANT_SHARE * np.abs(truth[:, 0] @ LUMINANCE)
    if not is_asked.any():
        return DominantLight(None, len(true))
    predicted, true = predicted[is_asked], true[is_asked]
    angle_deg = angles_deg(predicted, true)
    angle_deg[~predicted.any(axis=1)] = UNDIRECTED_DEG
    return DominantLight(float(np.median(angle_deg)), int(np.count_nonzero(~is_asked)))


def sphere_errors(lights: ArrayF64, truth: ArrayF64) -> dict[str, SphereErrors]:
    """Errors of the pictures of the three spheres under lights (M, 9, 3)."""
    parts = [np.zeros((4, 0, len(SPHERES)))]
    for start in range(0, len(lights), _CLOUDS_AT_ONCE):
        block = slice(start, start + _CLOUDS_AT_ONCE)
        parts.append(_picture_errors(_pictures(lights[block]), _pictures(truth[block])))
    of_each = np.concatenate(parts, axis=1)
    return {name: SphereErrors(*map(_mean_known, of_each[:, :, i])) for i, name in enumerate(SPHERES)}


def _irradiance_errors(lights: ArrayF64, truth: ArrayF64) -> tuple[float | None, float | None]:
    """Pooled over all clouds, and the mean over clouds in percent."""
    true, shown = (np.einsum("ni,mic->mnc", irradiance_table(N_NORMALS), light) for light in (truth, lights))
    error = shown - true
    power, true_power = np.mean(error**2, axis=(1, 2)), np.mean(true**2, axis=(1, 2))
    is_lit = true_power > 0
    in_each = np.sqrt(power[is_lit] / true_power[is_lit])
    return ratio(pooled_rms(error), pooled_rms(true)), float(100 * in_each.mean()) if is_lit.any() else None


@lru_cache(maxsize=2)
def irradiance_table(n_normals: int) -> ArrayF64:
    """(n_normals, 9): irradiance at normals spread over the sphere, from coefficients."""
    return basis(AnchorLattice(n_normals).directions) * np.repeat(cosine_lobe(2), [1, 3, 5])


def _pictures(lights: ArrayF64) -> ArrayF64:
    """(M, 3, P, 3) what the pixels of the spheres show, black where light is negative."""
    shown: ArrayF64 = np.einsum("spi,mic->mspc", sphere_transfer(SPHERE_SIZE), lights, optimize=True)
    return np.maximum(shown, 0.0, out=shown)


def _picture_errors(predicted: ArrayF64, true: ArrayF64) -> ArrayF64:
    """(4, M, 3): RMSE, si-RMSE, mean angle (NaN where no pixel can be asked), share black in the prediction alone."""
    rmse = np.sqrt(np.mean((predicted - true) ** 2, axis=(2, 3)))
    # A power of two brings dim pictures into range and rounds nothing, as in xihenet.metrics.
    _, exponent = np.frexp(np.abs(predicted).max(axis=(2, 3), initial=0.0))
    scaled = np.ldexp(predicted, -exponent[..., None, None])
    power = np.sum(scaled * scaled, axis=(2, 3))
    alpha = np.sum(scaled * true, axis=(2, 3)) / np.where(power > 0, power, 1.0)
    si_rmse = np.sqrt(np.mean((alpha[..., None, None] * scaled - true) ** 2, axis=(2, 3)))
    return np.stack([rmse, si_rmse, *_hue_errors(predicted, true)])


def _hue_errors(predicted: ArrayF64, true: ArrayF64) -> tuple[ArrayF64, ArrayF64]:
    """(M, 3) mean RGB angle in degrees over pixels with a hue on both sides, NaN without any; and the black share."""
    (hue_p, largest_p), (hue_g, largest_g) = hues(predicted), hues(true)
    is_asked = (largest_p > 0) & (largest_g > 0)
    n_asked = is_asked.sum(axis=2)
    total_deg = (angles_deg(hue_p, hue_g) * is_asked).sum(axis=2)
    mean_deg = np.where(n_asked > 0, total_deg / np.maximum(n_asked, 1), np.nan)
    return mean_deg, np.mean((largest_p == 0) & (largest_g > 0), axis=2)


def _mean_known(values: ArrayF64) -> float | None:
    """Mean of what is not NaN; None without any."""
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else None
