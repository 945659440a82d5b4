"""The cube map of a glTF file by EXT_lights_image_based: the light that glossy things reflect, blurred for rough ones.

Each level is half as wide as the one before, and blurred by the lobe of GGX (Walter et al. 2007) about the reflected
direction, as it is for light and eye along the normal. The extension spaces levels evenly by roughness. Babylon.js, the
one engine that is known to read it, does so by the logarithm of alpha, which is roughness squared: the last of n levels
is for alpha 1, the first for 1 / SIDE. Chosen: what Babylon.js reads.

Light above white is packed as RGBD, again as Babylon.js unpacks it: (rgb ** 2.2) / alpha.
"""

from __future__ import annotations

import numpy as np

from xihenet.light.platforms import Y_UP
from xihenet.records import ArrayF64, ArrayU8

SIDE = 32
"""Of the first level: a texel is 2.8 degrees wide."""

N_LEVELS = 4
BRIGHTEST = 255.0
"""That RGBD can hold; what is brighter is clipped."""

# In the extension's order, Y up: the direction of the middle, of the right edge and of the upper one.
FACES = (
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
    ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
)
_FINER = 8
"""Samples of the panorama along a texel's side, so that a lamp keeps its light."""


def cube_levels(picture: ArrayF64, axes: ArrayF64 = Y_UP) -> list[ArrayF64]:
    """(6, S, S, 3) radiance of +X, -X, +Y, -Y, +Z, -Z, Y up, for S = `SIDE`, and half of that for each further level.

    `picture` is a panorama laid out as ours; `axes` are those of the cube, as of `Convention`.
    """
    height, width = picture.shape[:2]
    x, y, z = np.moveaxis(_directions(_FINER * SIDE) @ axes, -1, 0)
    row = np.clip((np.arccos(np.clip(z, -1, 1)) / np.pi * height).astype(int), 0, height - 1)
    column = ((0.75 - np.arctan2(y, x) / (2 * np.pi)) % 1 * width).astype(int) % width
    sharp = _coarser(picture[row, column], _FINER)
    source = _coarser(sharp, 2)
    # Of GGX, for which Babylon.js looks a level up.
    alphas = [float(SIDE ** (level / (N_LEVELS - 1) - 1)) for level in range(N_LEVELS)]
    return [sharp, *(_blurred(source, SIDE >> level, alphas[level]) for level in range(1, N_LEVELS))]


def encode_rgbd(radiance: ArrayF64) -> ArrayU8:
    """(..., 4) uint8 of (..., 3) radiance, none below zero."""
    brightest = np.maximum(radiance.max(axis=-1, keepdims=True), 1.0)
    divisor = np.clip(np.floor(BRIGHTEST / brightest), 1, 255) / 255
    colours = np.clip(radiance * divisor, 0, 1) ** (1 / 2.2)
    return np.rint(np.concatenate([colours, divisor], axis=-1) * 255).astype(np.uint8)


def _directions(side: int) -> ArrayF64:
    """(6, side, side, 3) unit vectors to the texels, Y up."""
    places = (np.arange(side) + 0.5) / side * 2 - 1
    right, down = (plane[..., None] for plane in np.meshgrid(places, places))
    found = np.stack([middle + right * to_right - down * up for middle, to_right, up in np.array(FACES, float)])
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def _coarser(faces: ArrayF64, by: int) -> ArrayF64:
    """The mean of each `by` times `by` texels."""
    n, side, _, channels = faces.shape
    return faces.reshape(n, side // by, by, side // by, by, channels).mean(axis=(2, 4))


def _blurred(faces: ArrayF64, side: int, alpha: float) -> ArrayF64:
    """(6, side, side, 3) of what a surface of roughness `alpha` reflects, of what is there."""
    towards, sources = _directions(side), _directions(faces.shape[1]).reshape(-1, 3)
    # A texel is smaller the farther it is from its face's middle, by the cube of that angle's cosine.
    solid_angles = np.abs(sources).max(axis=-1) ** 3
    cosine = np.clip(towards.reshape(-1, 3) @ sources.T, 0, 1)
    lobe = cosine / (1 - (1 - alpha**2) * (1 + cosine) / 2) ** 2 * solid_angles
    blurred: ArrayF64 = (lobe / lobe.sum(axis=1, keepdims=True)) @ faces.reshape(-1, 3)
    return blurred.reshape(towards.shape)
