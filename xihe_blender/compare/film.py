"""Pictures as an .mp4, which Blender's sequencer encodes, so that no encoder has to be installed."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path

import bpy

from xihe_blender.compare.side_by_side import SMALLEST_WIDTH_PX, render_film, set_up_output
from xihe_blender.io.outputs import copy_whole
from xihe_blender.scene.state import WORKING

SCENE = "Xihe Film"


def save_film(pictures: Mapping[int, Path], size: tuple[int, int], fps: float, path: Path) -> None:
    """Write `pictures`, by frame and in order, to `path` (.mp4), with each shown until the next.

    Small ones are enlarged by whole pixels; encoders take even numbers of these. UserError if this Blender cannot.
    """
    larger = math.ceil(SMALLEST_WIDTH_PX / size[0])
    larger += larger % 2 if any(side % 2 for side in size) else 0
    first, last = min(pictures), max(pictures)
    scene = bpy.data.scenes.new(SCENE)
    try:
        scene[WORKING] = True
        set_up_output(scene, (larger * size[0], larger * size[1]), fps)
        scene.frame_start, scene.frame_end = 1, last - first + 1
        editor = scene.sequence_editor_create()
        strips = editor.strips if hasattr(editor, "strips") else editor.sequences  # Blender 4.3
        shown = pictures[first]
        strip = strips.new_image("Pictures", str(shown), channel=1, frame_start=1)
        for frame in range(first + 1, last + 1):
            shown = pictures.get(frame, shown)
            strip.elements.append(shown.name)
        strip.transform.scale_x = strip.transform.scale_y = larger
        strip.transform.filter = "NEAREST"
        with tempfile.TemporaryDirectory(prefix="xihe_") as temporary:
            copy_whole(render_film(scene, Path(temporary)), path)
    finally:
        bpy.data.scenes.remove(scene)
