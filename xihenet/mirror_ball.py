"""A mirror ball: the whole sphere in a square picture in which every pixel sees the same solid angle.

The picture of a mirror ball is Lambert's azimuthal equal-area map: a disc whose centre looks straight up (+Z), whose
rim is straight down, and in which +X lies to the right and -Y at the top. A camera that samples such a picture evenly
samples the sphere evenly, so that nothing counts more than it covers. The rows next to the poles of an equirectangular
picture are sampled evenly in polar angle instead: a lamp above a table had up to 3.9 times its light there.

Pixels on the rim lie in part outside of the ball. What a renderer writes into them is their radiance times the share
of their samples that met the ball, so that the plain sum over all pixels is the integral over the sphere.

Not here: panoramas, which pictures and files are in; see `panorama`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from xihenet.panorama import panorama_directions
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt
from xihenet.sh_basis import basis, n_coefficients

FINEST = 2048
"""Cells along a side, at the most, in which a pixel's mean of a basis function is taken."""

NEARBY = 5
"""Pixels along a side of the neighbourhood that a pixel on the rim is the mean of, in pictures."""

CELLS = 8
"""The same along a pixel's side, where the picture is small."""


def ball_directions(size: int) -> tuple[ArrayF64, ArrayBool]:
    """Unit directions (size, size, 3) in world axes of the pixel centres, and which of them lie on the ball.

    ValueError for a size below 1. Directions off the ball look straight down.
    """
    if size < 1:
        raise ValueError(f"mirror ball: expected a picture of at least one pixel, got {size}")
    place = (np.arange(size) + 0.5) / size * 2 - 1
    right, down = np.meshgrid(place, place)
    squared = right**2 + down**2
    on_ball = squared < 1
    across = 2 * np.sqrt(np.maximum(1 - squared, 0.0))
    up = np.where(on_ball, 1 - 2 * squared, -1.0)
    return np.stack([across * right, across * down, up], axis=-1), on_ball


def ball_pixels(directions: ArrayLike, size: int) -> tuple[ArrayInt, ArrayInt]:
    """Row and column of the pixel that sees each unit direction (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    # The radius of a direction in the disc is sin(polar angle / 2); x and y have sin(polar angle) in them.
    per_side = 1 / np.sqrt(np.maximum(2 * (1 + z), 1e-12))
    column, row = ((place * per_side + 1) / 2 * size for place in (x, y))
    return _inside(row, size), _inside(column, size)


def _inside(place: ArrayF64, size: int) -> ArrayInt:
    return np.clip(np.floor(place).astype(np.intp), 0, size - 1)


@lru_cache(maxsize=16)
def ball_coverage(size: int) -> ArrayF32:
    """(size, size) read-only share of each pixel that lies on the ball: 1 inside, 0 in the corners."""
    cells = max(1, min(CELLS, FINEST // size))
    _, on_ball = ball_directions(size * cells)
    share: ArrayF32 = on_ball.reshape(size, cells, size, cells).mean(axis=(1, 3)).astype(np.float32)
    share.flags.writeable = False
    return share


def is_off_the_rim(size: int, n_pixels: int) -> ArrayBool:
    """(size, size) bool, pixels that lie farther than so many from the ball's rim, inside."""
    place = np.arange(size) + 0.5 - size / 2
    inside: ArrayBool = np.hypot(place[:, None], place) < size / 2 - n_pixels
    return inside


@lru_cache(maxsize=16)
def _pixel_integrals(size: int, order: int) -> ArrayF64:
    """((order + 1)^2, size, size) each basis function's integral over a pixel that lay on the ball as a whole.

    Read-only. On the rim the mean is over the part on the ball, since the radiance there has its share already.
    """
    cells = max(1, min(CELLS, FINEST // size))
    directions, on_ball = ball_directions(size * cells)
    n = n_coefficients(order)
    sums = np.zeros((n, size, size))
    counts = on_ball.reshape(size, cells, size, cells).sum(axis=(1, 3))
    for row in range(size):
        of_row = slice(row * cells, (row + 1) * cells)
        values = basis(directions[of_row].reshape(-1, 3), order) * on_ball[of_row].reshape(-1, 1)
        sums[:, row] = values.reshape(cells, size, cells, n).sum(axis=(0, 2)).T
    integrals: ArrayF64 = sums / np.maximum(counts, 1) * (16.0 / size**2)
    integrals.flags.writeable = False
    return integrals


def project_mirror_ball(radiance: ArrayLike, order: int = 2) -> ArrayF64:
    """Spherical-harmonic coefficients of a mirror ball.

    Parameters
    ----------
    radiance : (N, N, 3) linear, as this module says of the rim; negative values are taken as they are
    order : highest band

    Returns
    -------
    ((order + 1)^2, 3) float64, integral of radiance x Y over the sphere. Raises ValueError for another shape, and with
    their number if pixels are NaN or infinite.
    """
    image = np.asarray(radiance, np.float64)
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[0] != image.shape[1]:
        raise ValueError(f"mirror ball: expected shape (N, N, 3), got {image.shape}")
    if not len(image):
        raise ValueError("mirror ball: expected a picture of at least one pixel, got none")
    if not np.isfinite(image).all():
        n_bad = np.count_nonzero(~np.isfinite(image).all(axis=2))
        raise ValueError(f"mirror ball: expected finite radiance, got {n_bad} pixels with NaN or infinity")
    table = _pixel_integrals(len(image), order)
    # As one row per coefficient: a product of (n, N * N) with (N * N, 3).
    projected: ArrayF64 = table.reshape(len(table), -1) @ image.reshape(-1, 3)
    return projected


def whole_pixels(rendered: ArrayLike, smooth: ArrayLike) -> ArrayF32:
    """A mirror ball as it is rendered (N, N, 3) with all of their radiance in the pixels on the rim, for looking at.

    Inside it is `smooth` (N, N, 3), the same denoised; a denoiser draws the black around the ball into the rim. There
    each pixel is the mean over those nearby, by how much of them lies on the ball.
    """
    noisy, size = np.asarray(rendered, np.float32), len(np.asarray(rendered))
    sums = [neighbours(some, NEARBY).sum(axis=0) for some in (noisy, ball_coverage(size)[..., None])]
    is_inside = is_off_the_rim(size, NEARBY // 2 + 1)[..., None]
    whole: ArrayF32 = np.where(is_inside, np.asarray(smooth, np.float32), sums[0] / np.maximum(sums[1], 1e-3))
    return whole


def neighbours(picture: ArrayF32, side: int) -> ArrayF32:
    """(side^2, N, N, C) each pixel's neighbours in (N, N, C), itself among them; beyond the border comes it again."""
    reach = side // 2
    padded = np.pad(picture, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    n = len(picture)
    return np.stack([padded[i : i + n, j : j + n] for i in range(side) for j in range(side)])


def panorama_of_ball(radiance: ArrayLike, height: int) -> ArrayF32:
    """(height, 2 height, 3) a mirror ball of whole pixels as a panorama: each texel the mean of what it covers."""
    cells = 4
    fine = seen_in_ball(radiance, panorama_directions(height * cells, 2 * height * cells))
    panorama: ArrayF32 = fine.reshape(height, cells, 2 * height, cells, 3).mean(axis=(1, 3))
    return panorama


def seen_in_ball(radiance: ArrayLike, directions: ArrayLike) -> ArrayF32:
    """(..., 3) what a mirror ball of whole pixels (N, N, 3) shows in unit directions (..., 3)."""
    ball = np.asarray(radiance, np.float32)
    seen: ArrayF32 = ball[ball_pixels(directions, len(ball))]
    return seen
