"""Build `light_temperature`: a desk lamp that goes from candle light (1500 K) to a cool white (6500 K) in 24 frames.

Even steps in mired (1e6 / kelvin), in which equal steps look equal; the luminance stays.
"""

from __future__ import annotations

import bpy
import numpy as np
from lamp_room import build_lamp_room, key_lamp
from staging import N_FRAMES, main

COLDEST_K, WARMEST_K = 6500.0, 1500.0


def build() -> bpy.types.Scene:
    """The whole scene in an empty file."""
    scene, lamp = build_lamp_room("Light temperature")
    kelvin = 1e6 / np.linspace(1e6 / WARMEST_K, 1e6 / COLDEST_K, N_FRAMES)
    key_lamp(scene, lamp, kelvin.tolist(), [1.0] * N_FRAMES)
    return scene


if __name__ == "__main__":
    main(build, __file__)
