"""Reading what Cycles wrote, and writing radiance: OpenEXR in 32-bit float, nothing lost.

Blender 4.x writes all passes as one part, 5.x one part per pass; both are read here as one table of channels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from xihe_blender.outputs import written_whole
from xihenet.records import ArrayF32


def read_channels(path: Path) -> dict[str, ArrayF32]:
    """Every channel of the file as (H, W) float32 by its full name, such as "ViewLayer.Combined.R"; row 0 is the top.

    OSError or RuntimeError if the file is missing or no OpenEXR file.
    """
    channels: dict[str, ArrayF32] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            for name, channel in part.channels.items():
                channels[name] = channel.pixels.astype(np.float32, copy=False)
    return channels


def read_radiance(path: Path) -> ArrayF32:
    """(H, W, 3) of a file that `write_radiance` wrote. ValueError if it has no R, G and B."""
    channels = read_channels(path)
    if not {"R", "G", "B"} <= channels.keys():
        raise ValueError(f"{path}: expected the channels R, G and B, found {', '.join(sorted(channels))}")
    return np.stack([channels[c] for c in "RGB"], axis=-1)


def write_radiance(path: Path, radiance: ArrayF32) -> None:
    """Write (H, W, 3) linear Rec.709 as channels R, G, B; whole or not at all. OSError if it cannot be written."""
    pixels = np.ascontiguousarray(radiance, np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {c: OpenEXR.Channel(np.ascontiguousarray(pixels[..., i])) for i, c in enumerate("RGB")}
    with written_whole(path) as beside, OpenEXR.File(header, channels) as file:
        file.write(str(beside))
