"""Panoramas: which part of the sphere does each texel see, and what are the panorama's spherical harmonics?

Convention: row 0 is straight up (+Z). From the left edge to the right the columns look along -Y, -X, +Y (the middle),
+X and -Y again: what lies to the right of the middle is +X, as in Blender's upright equirectangular camera.

Projection integrates every basis function over every texel. Samples at the centres, weighted by solid angle, leak: of a
constant light in 8 rows, 1.5 % of the l = 0 coefficient turns up in l = 2. The integrals of all texels add up to that
over the sphere by construction, so constant light is exact at any size, 1 x 1 included. In azimuth the integral is
elementary; in the polar angle each function times the area element is a trigonometric polynomial of degree order + 1,
whose Fourier series is finite and is integrated term by term.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayF64
from xihenet.sh_basis import band_slice, checked_sh, legendre_factors, n_coefficients


def _check_size(height: int, width: int) -> None:
    if height < 1 or width < 1:
        raise ValueError(f"panorama: expected at least one texel, got {height} rows x {width} columns")


def _azimuth(column: ArrayF64, width: int) -> ArrayF64:
    """Azimuth in radians, from +X towards +Y, of a position in columns from the left edge; falls from 3/2 pi."""
    return 1.5 * np.pi - 2 * np.pi * column / width


def _angles(height: int, width: int) -> tuple[ArrayF64, ArrayF64]:
    """Polar angles (H,) and azimuths (W,) of the texel centres, radians. ValueError without a texel."""
    _check_size(height, width)
    return np.pi * (np.arange(height) + 0.5) / height, _azimuth(np.arange(width) + 0.5, width)


def panorama_directions(height: int, width: int) -> ArrayF64:
    """Unit directions in world axes of the texel centres, (H, W, 3) float64; one texel alone looks along +Y.

    ValueError without a texel.
    """
    polar, azimuth = _angles(height, width)
    directions = np.empty((height, width, 3))
    directions[..., 0] = np.sin(polar)[:, None] * np.cos(azimuth)
    directions[..., 1] = np.sin(polar)[:, None] * np.sin(azimuth)
    directions[..., 2] = np.cos(polar)[:, None]
    return directions


def solid_angles(height: int, width: int) -> ArrayF64:
    """Solid angle of each texel in steradians, (H, W) float64; they add up to 4 pi. ValueError without a texel."""
    _check_size(height, width)
    polar_centre = np.pi * (np.arange(height) + 0.5) / height
    # As a product instead of a difference of cosines, which would lose digits at the poles of large panoramas.
    per_row = 2 * np.sin(polar_centre) * np.sin(np.pi / (2 * height)) * (2 * np.pi / width)
    return np.repeat(per_row[:, None], width, axis=1)


def _row_integrals(height: int, order: int) -> ArrayF64:
    """Integral over each row's polar angles of factor (l, m) x sin^m x the area element: (order+1, order+1, H)."""
    degree = order + 1
    n_samples = 2 * degree + 1
    angles = 2 * np.pi * np.arange(n_samples) / n_samples
    powers = np.sin(angles) ** (np.arange(order + 1)[:, None] + 1)
    spectrum = np.fft.rfft(legendre_factors(np.cos(angles), order) * powers, axis=-1) / n_samples
    edges = np.pi * np.arange(height + 1) / height
    harmonic = np.arange(1, degree + 1)
    cosine_part = np.sin(harmonic[:, None] * edges) / harmonic[:, None]
    sine_part = -np.cos(harmonic[:, None] * edges) / harmonic[:, None]
    varying = 2 * (spectrum.real[..., 1:] @ cosine_part - spectrum.imag[..., 1:] @ sine_part)
    return np.diff(spectrum.real[..., :1] * edges + varying, axis=-1)


def _column_integrals(width: int, order: int) -> ArrayF64:
    """Integral over each column's azimuths of cos(m phi), 1, sin(|m| phi): (2 order + 1, W), row order + m."""
    edges = _azimuth(np.arange(width + 1.0), width)
    integrals = np.empty((2 * order + 1, width))
    integrals[order] = 2 * np.pi / width
    for m in range(1, order + 1):
        # Azimuth falls from left to right, so the difference is left minus right.
        integrals[order + m] = -np.diff(np.sin(m * edges)) / m
        integrals[order - m] = np.diff(np.cos(m * edges)) / m
    return integrals


@lru_cache(maxsize=32)
def _texel_tables(height: int, width: int, order: int) -> tuple[ArrayF64, ArrayF64]:
    """Row and column integrals for every coefficient: ((order + 1)^2, H) and ((order + 1)^2, W), read-only.

    The integral of a basis function over a texel is the product of its two entries.
    """
    n_functions = n_coefficients(order)
    by_row, by_column = _row_integrals(height, order), _column_integrals(width, order)
    rows, columns = np.empty((n_functions, height)), np.empty((n_functions, width))
    for band in range(order + 1):
        rows[band_slice(band)] = by_row[band, np.abs(np.arange(-band, band + 1))]
        columns[band_slice(band)] = by_column[order - band : order + band + 1]
    rows.flags.writeable = columns.flags.writeable = False
    return rows, columns


def project_panorama(radiance: ArrayLike, order: int = 2) -> ArrayF64:
    """Spherical-harmonic coefficients of a panorama whose texels are each taken as one constant radiance.

    `radiance` is (H, W, 3), linear, in the convention of this module; negative values are taken as they are.
    ((order + 1)^2, 3) float64, integral of radiance x Y over the sphere. ValueError for another shape, for an empty
    panorama, and with their number if pixels are NaN or infinite.
    """
    image = np.asarray(radiance, dtype=np.float64)
    if image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"panorama: expected shape (H, W, 3), got {image.shape}")
    height, width, _ = image.shape
    _check_size(height, width)
    if not np.isfinite(image).all():
        n_bad = np.count_nonzero(~np.isfinite(image).all(axis=2))
        raise ValueError(f"panorama: expected finite radiance, got {n_bad} pixels with NaN or infinity")
    rows, columns = _texel_tables(height, width, order)
    row_sums = (rows @ image.reshape(height, width * 3)).reshape(len(rows), width, 3)
    return np.matmul(columns[:, None, :], row_sums)[:, 0]


def evaluate_panorama(sh_radiance: ArrayLike, height: int, width: int) -> ArrayF64:
    """The radiance that ((order + 1)^2, 3) describe, at the texel centres of a panorama: a picture of an estimate.

    (H, W, 3) float64, linear, not clipped: a finite series rings, so values may be negative. ValueError without texels.
    """
    coefficients, order = checked_sh(sh_radiance)
    polar, azimuth = _angles(height, width)
    band = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
    m = np.arange(len(band)) - band * (band + 1)
    # Each basis function is a factor of the row times one of the column: a tenth of the time of `basis` for all texels.
    rows = legendre_factors(np.cos(polar), order)[band, abs(m)].T * np.sin(polar)[:, None] ** abs(m)
    columns = np.where(m[:, None] < 0, np.sin(-m[:, None] * azimuth), np.cos(m[:, None] * azimuth))
    return np.stack([(rows * channel) @ columns for channel in coefficients.T], axis=-1)
