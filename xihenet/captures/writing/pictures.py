"""Pictures, as all layouts write them: colour as an image, plane depth in 16 bits, and what became of both."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.camera import valid_plane_depth
from xihenet.captures.capture import EXTRA
from xihenet.records import ArrayF64, ArrayU8, Intrinsics, RgbdFrame

LARGEST_IN_16_BITS = 65534  # 65535 stands for a miss
HIGH_CONFIDENCE = 2
Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
JPEG_QUALITY = 95


@dataclass(frozen=True)
class Form:
    """How pictures are stored, where a layout leaves it open."""

    colour_scale: int = 1
    """Colour is so many times as wide and high as depth, by repeating pixels: that of a phone is larger."""

    is_jpeg: bool = False
    """Colour as JPEG where the layout may have PNG as well."""


USUAL = Form()


@dataclass(frozen=True)
class Written:
    """What was written."""

    n_frames: int
    n_unheld: int = 0  # Pixels whose depth the layout cannot hold; they have none in the file


def pillow() -> Any:
    """The package's Image; ImportError, naming the extra, without it."""
    try:
        from PIL import Image
    except ImportError as error:
        raise ImportError(f"pictures are written by pillow: {EXTRA}") from error
    return Image


def enlarged(image: ArrayU8, scale: int) -> ArrayU8:
    """(H, W, 3) with each pixel `scale` times in a row and as many in a column."""
    return image if scale == 1 else image.repeat(scale, axis=0).repeat(scale, axis=1)


def enlarged_intrinsics(k: Intrinsics, scale: int) -> Intrinsics:
    """Of the same field in `scale` times as many pixels along each side."""
    return Intrinsics(k.width * scale, k.height * scale, k.fx * scale, k.fy * scale, k.cx * scale, k.cy * scale)


def colour_bytes(frame: RgbdFrame, form: Form) -> bytes:
    """Content of an image file, JPEG or PNG."""
    image, file = pillow().fromarray(enlarged(frame.srgb_u8, form.colour_scale)), io.BytesIO()
    if form.is_jpeg:
        # Colour in half as many pixels, as usual, moves the light of a dark room by 3.8 % in place of 0.7 %.
        image.save(file, format="JPEG", quality=JPEG_QUALITY, subsampling="4:4:4")
    else:
        image.save(file, format="PNG", compress_level=1)
    return file.getvalue()


def save_depth(path: Path, frame: RgbdFrame, units_per_metre: float) -> int:
    """Write a grey image of 16 bits, 0 where there is no depth; and how many pixels are too far or too near for it."""
    valid = valid_plane_depth(frame.plane_depth_m)
    units = np.rint(np.where(valid, frame.plane_depth_m, 0).astype(np.float64) * units_per_metre)
    fits = (units >= 1) & (units <= LARGEST_IN_16_BITS)
    pillow().fromarray(np.where(fits, units, 0).astype(np.uint16)).save(path, compress_level=1)
    return int(np.count_nonzero(valid & ~fits))


def confidence_of(frame: RgbdFrame) -> ArrayU8:
    """(H, W) 0, 1, 2; where the frame has none, high for all that has a depth, as phones' files always have one."""
    if frame.confidence is not None:
        return frame.confidence
    return (valid_plane_depth(frame.plane_depth_m) * HIGH_CONFIDENCE).astype(np.uint8)


def in_y_up(pose: ArrayF64) -> ArrayF64:
    """(4, 4) of a camera in ARKit's world."""
    return Y_UP_FROM_Z_UP @ pose
