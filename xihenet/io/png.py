"""A picture as a PNG file where nothing but NumPy may be assumed: Blender's Python carries no imaging library.

8-bit RGB or RGBA, no palette, no interlacing. Source of the format: W3C Portable Network Graphics, third edition.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

SIGNATURE = b"\x89PNG\r\n\x1a\n"
LEVEL = 4  # The usual 6 takes three times as long, for files that are a twentieth smaller
_8_BIT = {3: struct.pack(">BBBBB", 8, 2, 0, 0, 0), 4: struct.pack(">BBBBB", 8, 6, 0, 0, 0)}
"""By channels."""


def encode_png(srgb_u8: ArrayLike) -> bytes:
    """The PNG file of (H, W, 3) uint8 sRGB, or of (H, W, 4) with an alpha, row 0 on top.

    ValueError for another shape or type, or without a pixel.
    """
    pixels = np.asarray(srgb_u8)
    if pixels.ndim != 3 or pixels.shape[2] not in _8_BIT or pixels.dtype != np.uint8 or not pixels.size:
        raise ValueError(f"encode_png: expected uint8 of shape (H, W, 3 or 4), got {pixels.dtype} of {pixels.shape}")
    height, width, channels = pixels.shape
    # Filter 1 (difference to the pixel on the left) makes smooth renders a third smaller.
    left = np.concatenate([np.zeros_like(pixels[:, :1]), pixels[:, :-1]], axis=1)
    rows = np.concatenate([np.ones((height, 1), np.uint8), (pixels - left).reshape(height, -1)], axis=1)
    header = struct.pack(">II", width, height) + _8_BIT[channels]
    chunks = ((b"IHDR", header), (b"sRGB", b"\0"), (b"IDAT", zlib.compress(rows.tobytes(), LEVEL)), (b"IEND", b""))
    return SIGNATURE + b"".join(_chunk(kind, content) for kind, content in chunks)


def write_png(path: Path, srgb_u8: ArrayLike) -> None:
    """Write `encode_png(srgb_u8)` to `path`; OSError if it cannot be written."""
    path.write_bytes(encode_png(srgb_u8))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
