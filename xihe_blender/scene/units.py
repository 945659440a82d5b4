"""Units: what is a metre in this scene? What Blender's own panels call one.

Phones' ranges, the spacing of estimation positions and the estimators' distances are in metres. A Blender unit is as
many of them as the scene's unit scale says (Scene > Units), or one where the unit system is None, since Blender then
shows no lengths. Chosen: lengths become metres where they leave Blender (camera pose, plane depth, bounding boxes), and
Blender units again where they enter it. Rejected: one unit is one metre, which would put a room that is modelled in
centimetres out of every phone's range.

Not here: light. Cycles does not look at the unit scale; its lamps fall off with Blender units, as the artist saw them.
"""

from __future__ import annotations

import bpy


def metres_per_unit(scene: bpy.types.Scene) -> float:
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else float(units.scale_length)


def seconds_of(scene: bpy.types.Scene, frame: int) -> float:
    """Seconds of the session at a frame: the scene's first one is at 0."""
    return float((frame - scene.frame_start) * scene.render.fps_base / scene.render.fps)
