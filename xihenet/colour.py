"""Colour: how does light relate to the numbers in a picture? The sRGB transfer (IEC 61966-2-1), both ways.

The exact piecewise curve is used, not a power of 2.2: a round trip through 8 bits then returns every code, and dark
anchors keep their light. Its two published thresholds meet only to 1e-7, far below half an 8-bit step.
Exposure and tone mapping are not here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

CLIPPED_FROM = 253.5 / 255
"""An encoded colour is clipped where a channel is at least that: what is shown may be brighter. Between two codes of 8
bits, so that a colour that is rounded to one is clipped as it was."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Of linear Rec.709, ITU-R BT.709


def _clipped_floats(values: ArrayLike) -> NDArray[Any]:
    """`values` clipped to [0, 1]; float32 stays float32, all else becomes float64; NaN stays NaN."""
    array = np.asarray(values)
    dtype = np.float32 if array.dtype == np.float32 else np.float64
    return np.clip(array.astype(dtype, copy=False), 0.0, 1.0)


def srgb_to_linear(srgb: ArrayLike) -> NDArray[Any]:
    """Decode sRGB of any shape to linear light in [0, 1]; float32 for float32 input, else float64.

    Values outside [0, 1] are clipped, NaN stays NaN; 8-bit codes must be divided by 255 first.
    """
    encoded = _clipped_floats(srgb)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(
        encoded.dtype, copy=False
    )


LINEAR_OF_CODE = srgb_to_linear(np.arange(256) / 255)
"""(256,) float64, the linear light of each 8-bit code."""


def linear_to_srgb(linear: ArrayLike) -> NDArray[Any]:
    """Encode linear light of any shape as sRGB in [0, 1], the inverse; float32 for float32 input, else float64.

    Values outside [0, 1] are clipped, as a camera clips; NaN stays NaN.
    """
    light = _clipped_floats(linear)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055).astype(
        light.dtype, copy=False
    )


def in_any_channel(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(..., 1) where a mask (..., 3) is true in any channel; `any` over an axis of 3 takes ten times as long."""
    return mask[..., :1] | mask[..., 1:2] | mask[..., 2:]
