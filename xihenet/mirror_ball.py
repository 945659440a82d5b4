"""A mirror ball: the whole sphere in a square picture in which every pixel sees the same solid angle.

The picture of a mirror ball is Lambert's azimuthal equal-area map: a disc whose centre looks straight up (+Z), whose
rim is straight down, and in which +X lies to the right and -Y at the top. A camera that samples such a picture evenly
samples the sphere evenly, so that nothing counts more than it covers. The rows next to the poles of an equirectangular
picture are sampled evenly in polar angle instead: a lamp above a table had up to 3.9 times its light there.

Pixels within RIM of the rim are not looked at. They lie in part outside of the ball; and Cycles, which takes the
footprint of a ray from its neighbours, finds none there: whatever has textures or bumps comes out black, which was 1 to
5 % of the light. What they would see, straight down, is taken from the pixels just inside; or, where a second picture
looks the other way, from its middle.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.panorama import panorama_directions
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt
from xihenet.sh_basis import basis

FINEST = 2048  # Cells along a side, at the most, in which a pixel's mean of a basis function is taken
RIM = 1.5  # Pixels from the rim to the middle of the outermost one that counts: its whole neighbour lies on the ball
CELLS = 8  # The same along a pixel's side, where the picture is small
FEWEST = 512  # Cells along a side, at the least: with 24 constant light shone 2 % more from above than from below


def ball_directions(size: int) -> tuple[ArrayF64, ArrayBool]:
    """Unit directions (size, size, 3) in world axes of the pixel centres, and which of them lie on the ball.

    ValueError for a size below 1. Directions off the ball look straight down.
    """
    if size < 1:
        raise ValueError(f"mirror ball: expected a picture of at least one pixel, got {size}")
    place = (np.arange(size) + 0.5) / size * 2 - 1
    return _directions(*np.meshgrid(place, place))


def _directions(right: ArrayF64, down: ArrayF64) -> tuple[ArrayF64, ArrayBool]:
    squared = right**2 + down**2
    on_ball = squared < 1
    across = 2 * np.sqrt(np.maximum(1 - squared, 0.0))
    up = np.where(on_ball, 1 - 2 * squared, -1.0)
    return np.stack([across * right, across * down, up], axis=-1), on_ball


def ball_pixels(directions: ArrayLike, size: int) -> tuple[ArrayInt, ArrayInt]:
    """Row and column of the pixel that tells of each unit direction (..., 3): within RIM, the one just inside."""
    x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
    level = np.hypot(x, y)
    # Of a direction in the disc: sin(polar angle / 2). Straight down is all of the rim.
    radius = np.minimum(np.sqrt(np.maximum((1 - z) / 2, 0.0)), max(0.0, 1 - 2 * RIM / size))
    is_upright = level < 1e-12
    per_side = radius / np.where(is_upright, 1.0, level)
    return _pixel((y * per_side + 1) / 2, size), _pixel((np.where(is_upright, radius, x * per_side) + 1) / 2, size)


def _pixel(place: ArrayF64, size: int) -> ArrayInt:
    return np.clip(np.floor(place * size).astype(np.intp), 0, size - 1)


@lru_cache(maxsize=8)
def _pixel_integrals(size: int, order: int) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    """((order + 1)^2, size * size) each basis function's integral over what a pixel tells of. Read-only.

    All of the sphere; what lies inside of RIM; and, for a picture turned over about X, what lies beyond it. All three
    at once, since the basis functions take most of the time.

    A quarter of the ball is looked at, the rest are its mirror images.
    """
    cells = max(2, FEWEST // size, min(CELLS, FINEST // size))
    cells -= cells * size % 2  # Else cells would lie across the borders of pixels, and count to one side alone.
    place = np.arange(0.5, size * cells / 2) / (size * cells / 2)
    directions, on_ball = _directions(*np.meshgrid(place, place))
    seen = directions[on_ball]
    values = basis(seen, order).T * (np.pi / len(seen))
    is_inside = np.sqrt((1 - seen[:, 2]) / 2) <= 1 - 2 * RIM / size

    def integrals(counted: ArrayBool | slice, *, is_turned: bool = False) -> ArrayF64:
        rows, columns = ball_pixels(seen[counted] * (1, 1, -1 if is_turned else 1), size)
        pixels = rows * size + columns
        quarters = [np.bincount(pixels, of_one[counted], size * size).reshape(size, size) for of_one in values]
        pictures = np.array(list(map(_mirrored, quarters, *_parities(order))))
        found: ArrayF64 = (pictures[:, ::-1] if is_turned else pictures).reshape(len(quarters), -1)
        found.flags.writeable = False
        return found

    return integrals(slice(None)), integrals(is_inside), integrals(~is_inside, is_turned=True)


def _parities(order: int) -> tuple[ArrayInt, ArrayInt]:
    """1 or -1 for each basis function: what it is multiplied by when X, and when Y, is mirrored."""
    m = np.concatenate([np.arange(-band, band + 1) for band in range(order + 1)])
    along_y = np.where(m < 0, -1, 1)
    return along_y * (1 - 2 * (m % 2)), along_y


def _mirrored(quarter: NDArray[Any], along_x: int, along_y: int) -> ArrayF64:
    """The whole picture's sums (N, N), from those of the quarter where X and Y are positive."""
    half = quarter + along_x * quarter[:, ::-1]
    return (half + along_y * half[::-1]).astype(np.float64)


def project_mirror_ball(radiance: ArrayLike, order: int = 2, *, turned: ArrayLike | None = None) -> ArrayF64:
    """Spherical-harmonic coefficients of a mirror ball (N, N, 3), linear: the integral of radiance x Y over the sphere.

    Negative values are taken as they are. Pixels beside the ball do not count, nor those within RIM of its rim; what
    they would see is taken from `turned`, where it is given: the same light in a ball that is turned over about X, so
    that its centre looks straight down. ((order + 1)^2, 3) float64. ValueError for another shape, and with their number
    if pixels are NaN or infinite.
    """
    image = _checked(radiance)
    of_all, inside, beyond = _pixel_integrals(len(image), order)
    if turned is None:
        return of_all @ image.reshape(-1, 3)
    return np.add(inside @ image.reshape(-1, 3), beyond @ _checked(turned).reshape(-1, 3))


def _checked(radiance: ArrayLike) -> ArrayF64:
    image = np.asarray(radiance, np.float64)
    if image.ndim != 3 or image.shape[2] != 3 or image.shape[0] != image.shape[1]:
        raise ValueError(f"mirror ball: expected shape (N, N, 3), got {image.shape}")
    if not len(image):
        raise ValueError("mirror ball: expected a picture of at least one pixel, got none")
    if not np.isfinite(image).all():
        n_bad = np.count_nonzero(~np.isfinite(image).all(axis=2))
        raise ValueError(f"mirror ball: expected finite radiance, got {n_bad} pixels with NaN or infinity")
    return image


def neighbours(picture: NDArray[Any], side: int) -> NDArray[Any]:
    """(side^2, N, N, C) each pixel's neighbours in (N, N, C), itself among them; beyond the border comes it again."""
    reach = side // 2
    padded = np.pad(picture, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    n = len(picture)
    return np.stack([padded[i : i + n, j : j + n] for i in range(side) for j in range(side)])


def panorama_of_ball(radiance: ArrayLike, height: int) -> ArrayF32:
    """(height, 2 height, 3) a mirror ball as a panorama: each texel the mean of what it covers."""
    cells = 4
    fine = seen_in_ball(radiance, panorama_directions(height * cells, 2 * height * cells))
    return fine.reshape(height, cells, 2 * height, cells, 3).mean(axis=(1, 3))


def seen_in_ball(radiance: ArrayLike, directions: ArrayLike) -> ArrayF32:
    """(..., 3) what a mirror ball (N, N, 3) shows in unit directions (..., 3)."""
    ball = np.asarray(radiance, np.float32)
    return ball[ball_pixels(directions, len(ball))]
