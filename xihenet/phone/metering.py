"""The phone's meter: which exposure does it take for what it sees?

`key` brings what the picture balances around to a middle grey, and lets light beyond white be lost, whatever its share.
In a lamp-lit room that is a third of the sphere around an object. Phones protect highlights: `highlights`, the default,
takes that exposure and lowers it until the brightest pixels of each picture are below white on average.

Source: libcamera, automatic exposure of the Raspberry Pi (src/ipa/rpi/controller/rpi/agc_channel.cpp), which sets a
gain by the mean and then lets "constraints" on quantiles of the histogram correct it. Its constraint mode `highlight`
(utils/raspberrypi/ctt/ctt_pisp.py) is an upper bound: between the quantiles 0.98 and 1 the mean is at most 0.8 of
white. At most 1.6 % of a picture can then be clipped. Makers of phones publish no numbers.

Ours, and not libcamera's: a pixel counts by its brightest channel, since what clips in one channel is lost too; the
lower bound (0.5 for the same pixels), which brightens dull pictures, is left out; and exposure is lowered by
`MOST_STOPS` at most. Rejected: no such limit, as a sun or a window that fills a twentieth of the picture would black
out the room; and setting aside what is far beyond white, as then more light could ask for more exposure.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal, get_args

import numpy as np

from xihenet.colour import LUMINANCE
from xihenet.records import ArrayF32, ArrayF64

Metering = Literal["highlights", "key"]
METERINGS: tuple[Metering, ...] = get_args(Metering)

KEY_LUMINANCE = 0.12  # Of a session. Meters are calibrated for 12 to 18 %; the low end spares lamps.
DARKEST = 1 / 20  # Of the key: what is darker counts as this dark to the meter. It is code 18 of 255 in the picture.

# Of a picture's pixels, and the mean of these that `highlights` allows, where white is 1: libcamera's `highlight`.
BRIGHTEST_SHARE, BRIGHTEST_MEAN = 0.02, 0.8

# `highlights` lies below `key` by no more; the key is then 0.03, code 48 of 255. Chosen: in the worst picture of the
# seven example scenes this leaves 12 % clipped of 34 %. A stop more leaves 2 %, in pictures that no phone would show.
MOST_STOPS = 2

BISECTIONS = 60  # Of the key: all that float64 can hold of it
SMALLEST_KEY = 1e-300  # A darker session has no light to meter, and its exposure would not fit a float


def checked_metering(name: object) -> Metering:
    """`name` as one of METERINGS; ValueError lists them."""
    for metering in METERINGS:
        if name == metering:
            return metering
    raise ValueError(f"expected one of {', '.join(METERINGS)}, got {name!r}")


def metered_exposure(pictures: Iterable[ArrayF32], metering: Metering = "highlights") -> float:
    """The exposure of pictures (..., 3) of scene radiance; 1 without light.

    Both ways begin with the exposure that brings the mean key of the pictures to KEY_LUMINANCE. A picture's key is what
    its luminance balances around on a log scale, where light beyond white counts as white and darkness as no darker
    than DARKEST of the key. A phone meters its own clipped picture in the same way: neither the sun nor a black window
    decides by how far off it is, only by how many pixels it fills. Where most of a picture is black, the median of the
    rest is at most white. The mean over pictures is arithmetic, so that a lamp that is off at first does not blow out
    the rest. `highlights` lowers this until every picture meets its bound, by MOST_STOPS at most: an exposure is locked
    for the session, and what it clips in one frame is lost there.

    Pixels that are NaN or infinite, which renderers leave behind, do not count. Twice the light asks for half of the
    exposure, and more light never for more of it, unless it falls where a picture was black: however little it is, the
    picture may then balance around it. (It cannot be told from a room in which the rest is far beyond white.)
    """
    seen = [_finite_pixels(picture) for picture in pictures]
    keys = [_key(pixels) for pixels in seen]
    key = float(np.mean(keys)) if keys else 0.0
    if not SMALLEST_KEY < key < np.inf:
        return 1.0
    exposure = KEY_LUMINANCE / key
    if checked_metering(metering) == "key":
        return exposure
    protecting = min(_protecting_exposure(pixels) for pixels in seen)
    return min(exposure, max(protecting, math.ldexp(exposure, -MOST_STOPS)))


def _finite_pixels(radiance: ArrayF32) -> ArrayF64:
    """(P, 3) pixels of a picture that are finite in all channels."""
    pixels = np.asarray(radiance, np.float64).reshape(-1, 3)
    is_finite = np.isfinite(pixels).all(axis=-1)
    return pixels if is_finite.all() else pixels[is_finite]


def _key(pixels: ArrayF64) -> float:
    """The key of one picture; 0 for a frame that is black, empty or broken throughout."""
    luminance = pixels @ LUMINANCE
    lit = luminance[luminance > 0]
    if not lit.size:
        return 0.0
    balanced = float(np.exp(_balanced_log(np.log(lit), luminance.size - lit.size)))
    return max(balanced, KEY_LUMINANCE * float(np.median(lit)))


def _balanced_log(log_luminance: ArrayF64, n_black: int) -> float:
    """By bisection: the logarithm of the key around which pixels balance, each as far off as it may count."""
    brightest, darkest = -np.log(KEY_LUMINANCE), np.log(DARKEST)
    low, high = log_luminance.min() - brightest, log_luminance.max() - darkest
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        if np.clip(log_luminance - middle, darkest, brightest).sum() + n_black * darkest > 0:
            low = middle
        else:
            high = middle
    return float(low)


def _protecting_exposure(pixels: ArrayF64) -> float:
    """The exposure at which the brightest pixels, clipped at white, have the mean that is allowed; infinite for black.

    Clipped pixels count as 1, the others as they are: with the n brightest clipped, the mean is linear in the exposure.
    """
    if not len(pixels):
        return np.inf
    n_brightest = max(1, round(BRIGHTEST_SHARE * len(pixels)))
    ranked = np.sort(np.maximum(pixels.max(axis=1), 0.0))[::-1][:n_brightest]
    if ranked[0] <= 0:
        return np.inf
    with np.errstate(over="ignore", divide="ignore"):  # Light too dim for any exposure has an infinite one.
        below = np.cumsum(ranked[::-1])[::-1]
        exposures = (BRIGHTEST_MEAN * n_brightest - np.arange(n_brightest)) / below
        is_below_white = exposures * ranked <= 1.0
    return float(exposures[np.argmax(is_below_white)]) if is_below_white.any() else np.inf
