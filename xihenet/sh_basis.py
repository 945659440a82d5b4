"""The basis: what are the values of the real spherical harmonics in given directions?

The basis is orthonormal and real, carries no Condon-Shortley sign, and is indexed l*l + l + m: so the three functions
of l = 1 are sqrt(3 / (4 pi)) times y, z, x, all positive towards their axis.

Each function is a polynomial in z times the real or the imaginary part of (x + iy)^|m|. Both factors come from short
recurrences whose terms are normalised from the start, so nothing overflows at high order and the poles need no special
case. Angles, and the factorials of the textbook formula, were rejected: the azimuth is undefined at the poles and the
factorials leave float64 at order 86.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.records import ArrayF64


def n_coefficients(order: int) -> int:
    """Number of basis functions of all bands 0 to `order`; raises ValueError below order 0."""
    if order < 0:
        raise ValueError(f"spherical harmonics: expected an order of at least 0, got {order}")
    return (order + 1) ** 2


def band_slice(band: int) -> slice:
    """Where the 2 l + 1 coefficients of band l = `band` lie."""
    return slice(band * band, (band + 1) * (band + 1))


def per_coefficient(of_bands: ArrayF64) -> ArrayF64:
    """((order + 1)^2,) from one number for each band, (order + 1,)."""
    return np.repeat(of_bands, 2 * np.arange(len(of_bands)) + 1)


def checked_sh(sh: ArrayLike) -> tuple[ArrayF64, int]:
    """Coefficients as ((order + 1)^2, 3) float64, with their order; ValueError for another shape, NaN or infinity."""
    coefficients = np.asarray(sh, dtype=np.float64)
    order = round(np.sqrt(len(coefficients))) - 1 if coefficients.ndim == 2 else -1
    if order < 0 or coefficients.shape != ((order + 1) ** 2, 3):
        raise ValueError(f"spherical harmonics: expected shape ((order + 1)^2, 3), got {coefficients.shape}")
    if not np.isfinite(coefficients).all():
        n_bad = np.count_nonzero(~np.isfinite(coefficients))
        raise ValueError(f"spherical harmonics: expected finite coefficients, got {n_bad} NaN or infinite ones")
    return coefficients, order


def unit_directions(directions: ArrayLike) -> ArrayF64:
    """Directions (P, 3) of any finite length above 0, brought to length 1, float64; P may be 0.

    ValueError with their number if some are zero, NaN or infinite.
    """
    vectors = np.asarray(directions, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 3:
        raise ValueError(f"directions: expected shape (P, 3), got {vectors.shape}")
    # Dividing by the largest component first keeps the squares of very long and very short vectors in range.
    largest = np.abs(vectors).max(axis=1, keepdims=True)
    is_direction = np.isfinite(largest) & (largest > 0)
    if not is_direction.all():
        n_bad = np.count_nonzero(~is_direction)
        raise ValueError(f"directions: expected finite lengths above 0, got {n_bad} that are zero, NaN or infinite")
    scaled = vectors / largest
    return scaled / np.sqrt(np.einsum("pi,pi->p", scaled, scaled))[:, None]


def legendre_factors(z: ArrayF64, order: int) -> ArrayF64:
    """The factor of each basis function that is a polynomial in `z`, the (P,) cosines of the polar angle.

    (order + 1, order + 1, P), indexed [l, m] for 0 <= m <= l, zero elsewhere, normalisation included: the basis
    function (l, m) is the factor (l, |m|) times sin(theta)^|m| times cos(m phi) or sin(|m| phi). Three-term recurrence
    in l of the fully normalised associated Legendre functions (Holmes and Featherstone 2002), without sin(theta)^|m|.
    """
    factors = np.zeros((order + 1, order + 1, len(z)))
    m_above_0 = np.arange(1, order + 1)
    growth = np.sqrt((2 * m_above_0 + 1) / (2 * m_above_0))
    growth[:1] *= np.sqrt(2)  # The real form's sqrt(2) for m > 0 enters once, and the product carries it on.
    diagonal = np.sqrt(1 / (4 * np.pi)) * np.cumprod(np.concatenate([[1.0], growth]))
    for m in range(order + 1):
        factors[m, m] = diagonal[m]
        for band in range(m + 1, order + 1):
            lower = band - 1
            scale = np.sqrt((4 * band**2 - 1) / (band**2 - m**2))
            share = np.sqrt((lower**2 - m**2) / (4 * lower**2 - 1))
            older = factors[band - 2, m] if band - 2 >= m else 0.0
            factors[band, m] = scale * (z * factors[lower, m] - share * older)
    return factors


def _azimuth_powers(directions: ArrayF64, order: int) -> NDArray[Any]:
    """(x + iy)^m for m = 0 to `order`, that is sin(theta)^m exp(i m phi): (order + 1, P) complex."""
    powers = np.ones((order + 1, len(directions)), dtype=np.complex128)
    in_plane = directions[:, 0] + 1j * directions[:, 1]
    for m in range(1, order + 1):
        powers[m] = powers[m - 1] * in_plane
    return powers


def basis(directions: ArrayLike, order: int = 2) -> ArrayF64:
    """Real spherical harmonics in directions (P, 3): world axes, any finite length above 0; P may be 0.

    (P, (order + 1)^2) float64, column l*l + l + m; within 1e-13 of SciPy to order 10. ValueError with their number if
    directions are zero, NaN or infinite, and for an order below 0.
    """
    units = unit_directions(directions)
    table = np.empty((n_coefficients(order), len(units)))
    factors = legendre_factors(units[:, 2], order)
    powers = _azimuth_powers(units, order)
    for band in range(order + 1):
        centre = band * band + band
        table[centre] = factors[band, 0]
        for m in range(1, band + 1):
            table[centre + m] = factors[band, m] * powers[m].real
            table[centre - m] = factors[band, m] * powers[m].imag
    return table.T
