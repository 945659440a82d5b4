"""Radiance in files: OpenEXR in 32-bit float, nothing lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xihenet.io.exr import read_exr, write_exr
from xihenet.io.whole_files import written_whole
from xihenet.records import ArrayF32


def read_radiance(path: Path) -> ArrayF32:
    """(H, W, 3) of a file that `write_radiance` wrote. ValueError if it has no R, G and B."""
    channels = read_exr(path)
    if not {"R", "G", "B"} <= channels.keys():
        raise ValueError(f"{path}: expected the channels R, G and B, found {', '.join(sorted(channels))}")
    return np.stack([channels[c] for c in "RGB"], axis=-1)


def write_radiance(path: Path, radiance: ArrayF32) -> None:
    """Write (H, W, 3) linear Rec.709 as channels R, G, B; whole or not at all. OSError if it cannot be written."""
    pixels = np.asarray(radiance, np.float32)
    with written_whole(path) as beside:
        write_exr(beside, {c: pixels[..., index] for index, c in enumerate("RGB")})
