"""The picture of light parts in the README, cut from those of a bench.

    python addon_tests/bench/light_parts.py out/parts blend_scenes/walk_around.blend --every 12 --size 512x384
    python docs/light_parts.py out/parts/walk_around/parts_0013.png docs/light_parts.png

Soft light alone, what the spheres call for, and the ground truth.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image

COLUMNS, N_COLUMNS = (1, 3, 0), 7
LEFT, TOP, RIGHT, BOTTOM = 70, 190, 330, 345
LARGER = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", type=Path, help="of the bench")
    parser.add_argument("picture", type=Path)
    options = parser.parse_args()
    bench = Image.open(options.parts).convert("RGB")
    width, size = bench.width // N_COLUMNS, ((RIGHT - LEFT) * LARGER, (BOTTOM - TOP) * LARGER)
    strip = Image.new("RGB", (size[0] * len(COLUMNS), size[1]))
    for index, column in enumerate(COLUMNS):
        own = bench.crop((column * width + LEFT, TOP, column * width + RIGHT, BOTTOM))
        strip.paste(own.resize(size, Image.Resampling.LANCZOS), (index * size[0], 0))
    strip.save(options.picture, optimize=True)


if __name__ == "__main__":
    main()
