"""Pictures of a light for engines that take these: panoramas (latitude and longitude) with all of the sphere in them.

A picture holds no light below zero, which spherical harmonics have where they ring: it is black there. A key light that
the engine does not take apart is a disc in the picture, of the irradiance that it has.

Radiance HDR (RGBE, Ward 1991) is what every engine reads; its colours are within half a percent of the brightest
channel.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from xihenet.light.key_light import rest_of
from xihenet.light.platforms import Layout, Platform
from xihenet.light.reflections import reflection_panorama
from xihenet.panorama import evaluate_panorama, panorama_directions, solid_angles
from xihenet.records import ArrayF32, ArrayF64, ArrayU8, KeyLight, ObjectLight

HEIGHT = 128
"""Of a picture: a texel is 1.4 degrees wide, as wide as the directions of reflections are apart."""

SMALLEST_DISC = 2
"""Texels that the radius of a key light in a picture has at least."""

Picture = TypeVar("Picture", ArrayF64, ArrayF32)
QUARTERS: dict[Layout, int] = {"+X": -1, "-Y": 2}
"""Of a turn by which columns move."""


def environment_picture(light: ObjectLight, platform: Platform) -> ArrayF64:
    """(H, 2H, 3) radiance, none below zero, of what the engine does not take apart; laid out as ours are."""
    picture = np.maximum(evaluate_panorama(rest_of(light), HEIGHT, 2 * HEIGHT), 0.0)
    if light.key is not None and not platform.main_light_apart:
        picture += disc_picture(light.key, HEIGHT)
    return picture


def reflections_picture(light: ObjectLight) -> ArrayF64 | None:
    """(H, 2H, 3) radiance that glossy things reflect, or None for a light without reflections."""
    return None if light.reflections is None else reflection_panorama(light.reflections, HEIGHT).astype(np.float64)


def disc_picture(key: KeyLight, height: int) -> ArrayF64:
    """(H, 2H, 3) radiance of a key light alone, with its irradiance to rounding.

    Its radius is two texels at least, and its rim fades over two: engines look the picture up in directions of a cube
    map as fine, and of smaller discs they find a half, the double or nothing.
    """
    texel = np.pi / height
    cosine = panorama_directions(height, 2 * height) @ key.direction
    beyond = np.arccos(np.clip(cosine, -1.0, 1.0)) - max(key.angular_radius, SMALLEST_DISC * texel)
    share = np.clip(0.5 - beyond / (2 * texel), 0.0, 1.0)
    weights = share * np.maximum(cosine, 0.0) * solid_angles(height, 2 * height)
    return share[..., None] * np.maximum(key.irradiance, 0.0) / weights.sum()


def laid_out(picture: Picture, layout: Layout) -> Picture:
    """One of our panoramas as an engine reads it; its width divides by four."""
    return np.roll(picture, QUARTERS[layout] * picture.shape[1] // 4, axis=1)


def laid_out_as_ours(picture: Picture, layout: Layout) -> Picture:
    """The panorama that `laid_out` makes the picture of."""
    return np.roll(picture, -QUARTERS[layout] * picture.shape[1] // 4, axis=1)


def encode_hdr(picture: ArrayLike) -> bytes:
    """A Radiance HDR file, run-length encoded, of (H, W, 3) radiance, none below zero or not finite: else ValueError.

    W is 8 to 32767, as the format asks.
    """
    radiance = np.asarray(picture, np.float64)
    height, width = radiance.shape[:2]
    if radiance.shape[2:] != (3,) or not 8 <= width <= 32767:
        raise ValueError(f"encode_hdr: expected (H, W, 3) with W from 8 to 32767, got {radiance.shape}")
    if not (np.isfinite(radiance).all() and (radiance >= 0).all()):
        raise ValueError("encode_hdr: expected finite radiance of 0 or more")
    rgbe = rgbe_of(radiance)
    start = bytes([2, 2, width >> 8, width & 255])
    rows = b"".join(start + b"".join(_in_runs(row[:, channel]) for channel in range(4)) for row in rgbe)
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode() + rows


def rgbe_of(radiance: ArrayF64) -> ArrayU8:
    """(..., 4) uint8: mantissas of a common exponent, and the exponent.

    What is darker than the format can say (some 3e-39) is black, and what is brighter (1.7e38) as bright as it can say.
    """
    mantissa, exponent = np.frexp(radiance.max(axis=-1))
    is_sayable = (mantissa > 0) & (exponent >= 1 - 128)
    exponent = np.where(is_sayable, np.minimum(exponent, 255 - 128), 0)
    scale = np.where(is_sayable, np.ldexp(256.0, -exponent), 0.0)
    # What rounds up to 256 is one less: the exponent is of the brightest channel before it was rounded.
    colours = np.minimum(np.rint(radiance * scale[..., None]), 255)
    exponents = np.where(is_sayable, exponent + 128, 0)[..., None]
    return np.concatenate([colours, exponents], axis=-1).astype(np.uint8)


def _in_runs(values: ArrayU8) -> bytes:
    """One channel of a row: equal neighbours as a run where there are at least four, else as they are."""
    packed, as_it_is, at = bytearray(), values.tobytes(), 0
    edges = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1, [len(values)]])

    def up_to(end: int) -> None:
        for begin in range(at, end, 128):
            part = as_it_is[begin : min(begin + 128, end)]
            packed.extend([len(part), *part])

    for number in np.flatnonzero(np.diff(edges) >= 4):
        begin, end = int(edges[number]), int(edges[number + 1])
        up_to(begin)
        at = begin
        while end - at >= 4:
            n = min(end - at, 127)
            packed.extend([128 + n, as_it_is[at]])
            at += n
    up_to(len(values))
    return bytes(packed)
