"""Reflections of glossy things: a finer sphere of directions, filled from the same frames by the same sampling.

An estimate of order 2 shows a mirror broad stripes. The phone has seen much of what the mirror would show, though: each
frame, thinned to as many pixels as that takes, is sampled into more anchors and merged as the estimate's are.

What was never seen is halfway, as a ratio, between the estimate and the median of what was seen. The estimate alone has
bright windows spread over dark ceilings, the median no lamp at all. What borders on it fades into it in ratios too, so
that there is no seam; but for lamps and windows, which would draw streaks. Measured in docs/reflections.md.

A phone's picture ends at white. What is white in it is shown twice as bright, and where it is the key light of the
estimate as bright as that, up to sixteen times. A key light that the estimate implies is shown too, as far as nothing
was seen there: without the lamp that lights the room a mirror is further off. Of both only as much is shown as the
estimate is sure of: a lamp at the wrong place on metal is worse than none.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import LUMINANCE, srgb_to_linear
from xihenet.light.key_light import SAME_LIGHT_COSINE, WHITE, sure_part, sure_share
from xihenet.mirror_ball import seen_in_ball
from xihenet.panorama import panorama_directions, solid_angles
from xihenet.records import (
    ArrayBool,
    ArrayF32,
    ArrayF64,
    ArrayInt,
    FarPixels,
    KeyLight,
    ObjectLight,
    PixelGrid,
    PointCloud,
    Reflections,
    UnitSphereCloud,
)
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

N_DIRECTIONS = 8192
N_PIXELS = 12_000
"""Of a frame, at least: a pixel of a wide camera then covers a fifth of an anchor."""

DARKEST = 0.003
"""Radiance, carrying the exposure, below which ratios count no more."""

LAMP_OF_USUAL = 2.5
"""What is brighter than so many medians is a lamp or a window, and does not go on beyond what was seen of it."""

WHITE_IS, MOST_BRIGHTENED = 2.0, 16.0
"""Times what a picture shows where it ends at white, and where that is the key light, at most: an estimate gives a lamp
in view the light of others too. Measured in docs/reflections.md."""

IMPLIED_IS = 0.6
"""Share of its light with which a key light that nobody has seen is shown, at most."""

FINE_HEIGHT = 256
"""Of the grid of directions in which a rendered picture is looked at: 16 for each anchor."""

N_NEIGHBOURS = 7
FADES_OVER = float(np.radians(20))
"""Angle over which the difference at the border of what was seen falls to 1 / e."""

N_SMOOTHED = 6
"""Rounds of smoothing what was filled, so that no anchor at the border draws a streak."""

SHARPNESS = 1.5
"""Of the picture between anchors: their distance over the width of the bell that weights them."""


def thinned(cloud: PointCloud) -> PointCloud:
    """Every n-th row and column of a frame's points, as many as N_DIRECTIONS need; without a grid all of them.

    Done once, however many positions and moves of an object sample the cloud.
    """
    step = 1 if cloud.grid is None else math.isqrt(cloud.grid.height * cloud.grid.width // N_PIXELS)
    if cloud.grid is None or step <= 1:
        return cloud
    if cloud not in _THINNED:
        _THINNED[cloud] = _every(cloud, cloud.grid, step)
    return _THINNED[cloud]


_THINNED: WeakKeyDictionary[PointCloud, PointCloud] = WeakKeyDictionary()


def _every(cloud: PointCloud, grid: PixelGrid, step: int) -> PointCloud:
    height, width = -(-grid.height // step), -(-grid.width // step)

    def kept(pixels: ArrayInt) -> tuple[ArrayBool, ArrayInt]:
        """Which of these pixels stay, and the new numbers of those."""
        row, column = np.divmod(pixels, grid.width)
        stays = (row % step == 0) & (column % step == 0)
        return stays, row[stays] // step * width + column[stays] // step

    def taken(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(grid.height, grid.width, 3)[::step, ::step].reshape(-1, 3)

    far, openings = grid.far, grid.openings
    if far is not None:
        stays, pixels = kept(far.pixels)
        far = FarPixels(pixels, far.rays[:, stays]) if len(pixels) else None
    if openings is not None:
        openings = kept(openings)[1]
    rest = replace(grid, height=height, width=width, far=far, openings=openings)
    return PointCloud(taken(cloud.points_m), taken(cloud.srgb), grid=rest)


def fill_reflections(cloud: UnitSphereCloud, lattice: AnchorLattice, light: ObjectLight) -> Reflections:
    """What was seen, and a guess from it and the estimate `light` elsewhere; both carry the same exposure.

    Where nothing was seen at all it is the estimate. ValueError for a cloud that is not the lattice's.
    """
    if len(cloud) != len(lattice):
        raise ValueError(f"fill_reflections: expected a cloud of {len(lattice)} anchors, got {len(cloud)}")
    radiance, seen = np.maximum(basis(lattice.directions) @ light.sh, 0.0), cloud.is_set
    if seen.any():
        shown = srgb_to_linear(cloud.srgb[seen].astype(np.float64))
        usual = np.median(shown, axis=0)
        guess = (np.log(np.maximum(radiance, DARKEST)) + np.log(np.maximum(usual, DARKEST))) / 2
        difference = np.zeros_like(radiance)
        is_lamp = shown @ LUMINANCE > LAMP_OF_USUAL * (usual @ LUMINANCE)
        difference[seen] = np.where(is_lamp[:, None], 0.0, np.log(np.maximum(shown, DARKEST)) - guess[seen])
        around = lattice.neighbours(min(N_NEIGHBOURS, len(lattice)))
        radiance = np.exp(guess + _faded(difference, seen, around))
        radiance[seen] = shown
        radiance *= _brightened(radiance, cloud, lattice, light.key)
    return Reflections(radiance.astype(np.float32), float(seen.mean()) if len(seen) else 0.0)


def rendered_reflections(ball: ArrayF32, lattice: AnchorLattice) -> Reflections:
    """Those of a mirror ball's picture (N, N, 3): the mean of what it shows in each anchor's directions."""
    directions = panorama_directions(FINE_HEIGHT, 2 * FINE_HEIGHT).reshape(-1, 3)
    weights, shown = solid_angles(FINE_HEIGHT, 2 * FINE_HEIGHT).ravel(), np.maximum(seen_in_ball(ball, directions), 0)
    return Reflections(lattice.means(directions, shown, weights)[0].astype(np.float32), 1.0)


def _faded(difference: ArrayF64, seen: ArrayBool, around: ArrayInt) -> ArrayF64:
    """(N, 3) `difference` where it is known, fading away from there: ring by ring, then smoothed.

    Sums are over the first axis: over a short one in the middle NumPy takes three times as long.
    """
    faded, known = np.where(seen[:, None], difference, 0.0), seen.copy()
    kept = float(np.exp(-np.sqrt(4 * np.pi / max(1, len(seen))) / FADES_OVER))
    filled = left = np.flatnonzero(~seen)
    together = around[filled].T.copy()
    beside = together[1:]
    while len(left) and known.any():
        n_known = known.take(beside).sum(axis=0, dtype=np.int8)
        is_ring = n_known > 0
        ring, n_known = left[is_ring], n_known[is_ring]
        if not len(ring):
            break
        # What is not known is 0.
        faded[ring] = kept * faded.take(beside.compress(is_ring, axis=1), axis=0).sum(axis=0) / n_known[:, None]
        known[ring] = True
        left, beside = left[~is_ring], beside.compress(~is_ring, axis=1)
    for _ in range(N_SMOOTHED if seen.any() else 0):
        faded[filled] = faded.take(together, axis=0).mean(axis=0)
    return faded


def _brightened(radiance: ArrayF64, cloud: UnitSphereCloud, lattice: AnchorLattice, key: KeyLight | None) -> ArrayF64:
    """(N, 3) by what the picture is multiplied, 1 or more: where it ends at white, and where the key light is."""
    is_white = cloud.is_set & (cloud.srgb >= WHITE).any(axis=1)
    gain = np.where(is_white[:, None], WHITE_IS, np.ones(3))
    if key is None:
        return gain
    cosine = lattice.directions @ key.direction
    if key.is_seen:
        patch, most, share = is_white & (cosine > SAME_LIGHT_COSINE), MOST_BRIGHTENED, sure_share(key)
    else:
        spacing = np.sqrt(4 * np.pi / len(lattice))
        disc = cosine > max(np.cos(max(key.angular_radius, spacing)), 0)
        patch, most = ~cloud.is_set & disc, np.inf
        # What is left of the disc where a part was seen is as bright as all of it: it gives its part of the light.
        share = min(sure_share(key), IMPLIED_IS) * cosine[patch].sum() / max(cosine[disc].sum(), 1e-9)
    shown = (radiance[patch] * cosine[patch, None]).sum(axis=0) * 4 * np.pi / len(lattice)
    of_key = np.divide(share * key.irradiance, shown, out=np.ones(3), where=shown > 0)
    gain[patch] = np.maximum(gain[patch], np.minimum(of_key, most))
    return gain


def without_key_light(reflections: Reflections, key: KeyLight | None) -> Reflections:
    """What is reflected beside a sun that shines as `key`: its lamp is taken out, as far as the sun gives its light.

    Both carry the same exposure; without a key light it is all of the picture.
    """
    if key is None:
        return reflections
    radiance = reflections.radiance.astype(np.float64)
    cosine = AnchorLattice(len(radiance)).directions @ key.direction
    brightness = radiance @ LUMINANCE
    is_lamp = cosine > min(SAME_LIGHT_COSINE, math.cos(key.angular_radius))
    is_lamp &= brightness > LAMP_OF_USUAL * np.median(brightness)
    shown = (radiance[is_lamp] * cosine[is_lamp, None]).sum(axis=0) * 4 * np.pi / len(radiance)
    of_sun = np.divide(key.irradiance, shown, out=np.zeros(3), where=shown > 0)
    radiance[is_lamp] *= np.maximum(1 - of_sun, 0)
    return replace(reflections, radiance=radiance.astype(np.float32))


def light_of_rough(light: ObjectLight) -> ObjectLight:
    """The light of rough things, which reflect the sun of its key light: as much of that as is sure, and a picture
    without its lamp. The rest of the key light is soft light."""
    if light.key is None:
        return light
    key = sure_part(light.key)
    return replace(light, key=key, reflections=light.reflections and without_key_light(light.reflections, key))


def reflection_panorama(reflections: Reflections, height: int = 128) -> ArrayF32:
    """(H, 2H, 3) float32, laid out as `xihenet.panorama` does, smooth between anchors."""
    around, weights = _between_anchors(len(reflections.radiance), height)
    smooth = np.einsum("pk,pkc->pc", weights, reflections.radiance[around])
    return smooth.reshape(height, 2 * height, 3).astype(np.float32)


@lru_cache(maxsize=4)
def _between_anchors(n: int, height: int) -> tuple[ArrayInt, ArrayF64]:
    """(P, k) the anchors around each texel, and their weights: a bell as wide as anchors are apart."""
    lattice, directions = AnchorLattice(n), panorama_directions(height, 2 * height).reshape(-1, 3)
    around = lattice.neighbours(min(N_NEIGHBOURS, n))[lattice.nearest(directions)]
    cosine = np.einsum("pkc,pc->pk", lattice.directions[around], directions)
    weights = np.exp((cosine - 1) * n * SHARPNESS**2 / (4 * np.pi))
    return around, weights / weights.sum(axis=1, keepdims=True)
