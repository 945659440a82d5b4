"""Pictures, as all layouts write them: colour as an image, plane depth in 16 bits, and what became of both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.camera import valid_plane_depth
from xihenet.captures.capture import EXTRA
from xihenet.records import ArrayF64, ArrayU8, Intrinsics, RgbdFrame

LARGEST_IN_16_BITS = 65534  # 65535 stands for a miss
HIGH_CONFIDENCE = 2
COLOUR_SCALE = 4
"""Where a layout's JPEG or video mixes the colours of neighbours, colour is so many times as wide and high as depth, by
repeating pixels: that of a phone is larger too."""

Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


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


def enlarged(frame: RgbdFrame) -> tuple[ArrayU8, Intrinsics]:
    """Colour with each pixel `COLOUR_SCALE` times in a row and as many in a column, and the intrinsics of that."""
    k, n = frame.intrinsics, COLOUR_SCALE
    intrinsics = Intrinsics(k.width * n, k.height * n, k.fx * n, k.fy * n, k.cx * n, k.cy * n)
    return frame.srgb_u8.repeat(n, axis=0).repeat(n, axis=1), intrinsics


def save_png(path: Path, pixels: ArrayU8 | NDArray[np.uint16]) -> None:
    """Write an image, without loss; its folder is made if it is not there."""
    path.parent.mkdir(exist_ok=True, parents=True)
    pillow().fromarray(pixels).save(path, compress_level=1)


def save_depth(path: Path, frame: RgbdFrame, units_per_metre: float) -> int:
    """Write a grey image of 16 bits, 0 where there is no depth; and how many pixels are too far or too near for it."""
    valid = valid_plane_depth(frame.plane_depth_m)
    units = np.rint(np.where(valid, frame.plane_depth_m, 0).astype(np.float64) * units_per_metre)
    fits = (units >= 1) & (units <= LARGEST_IN_16_BITS)
    save_png(path, np.where(fits, units, 0).astype(np.uint16))
    return int(np.count_nonzero(valid & ~fits))


def confidence_of(frame: RgbdFrame) -> ArrayU8:
    """(H, W) 0, 1, 2; where the frame has none, high for all that has a depth, as phones' files always have one."""
    if frame.confidence is not None:
        return frame.confidence
    return (valid_plane_depth(frame.plane_depth_m) * HIGH_CONFIDENCE).astype(np.uint8)


def in_y_up(pose: ArrayF64) -> ArrayF64:
    """(4, 4) of a camera in ARKit's world."""
    return Y_UP_FROM_Z_UP @ pose
