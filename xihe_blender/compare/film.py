"""Pictures as an .mp4, which Blender's sequencer encodes, so that no encoder has to be installed."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

from xihe_blender.compare.side_by_side import SMALLEST_WIDTH_PX, render_film, sequence
from xihe_blender.io.outputs import copy_whole

SCENE = "Xihe Film"


def save_film(pictures: Mapping[int, Path], size: tuple[int, int], fps: float, path: Path) -> None:
    """Write `pictures`, by frame and in order, to `path` (.mp4), with each shown until the next.

    Small ones are enlarged by whole pixels; encoders take even numbers of these. UserError if this Blender cannot.
    """
    larger = math.ceil(SMALLEST_WIDTH_PX / size[0])
    larger += larger % 2 if any(side % 2 for side in size) else 0
    first, last = min(pictures), max(pictures)
    shown = [pictures[first]]
    for frame in range(first + 1, last + 1):
        shown.append(pictures.get(frame, shown[-1]))
    with sequence(SCENE, shown, (larger * size[0], larger * size[1]), fps) as (scene, _, strip):
        strip.transform.scale_x = strip.transform.scale_y = larger
        strip.transform.filter = "NEAREST"
        with tempfile.TemporaryDirectory(prefix="xihe_") as temporary:
            copy_whole(render_film(scene, Path(temporary)), path)
