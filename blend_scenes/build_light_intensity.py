"""Build `light_intensity`: a desk lamp of 3000 K that is turned up from dark to full power in 24 frames, evenly."""

from __future__ import annotations

import bpy
import numpy as np
from lamp_room import build_lamp_room, key_lamp
from staging import N_FRAMES, main

LAMP_K = 3000.0


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, lamp = build_lamp_room("Light intensity")
    key_lamp(scene, lamp, [LAMP_K] * N_FRAMES, np.linspace(0.0, 1.0, N_FRAMES).tolist())
    return scene


if __name__ == "__main__":
    main(build, __file__)
