"""The comparison in an Image Editor: which side is which, a slider for the wipe, and the frame of the playhead.

The picture is composed anew when the playhead comes to another compared frame, and not while a run or a render moves
it. In background there is no editor to draw on.
"""

from __future__ import annotations

import contextlib
from typing import Any

import bpy

from xihe_blender.addon.overlay import FONT_PX, LINE, draw_text, text_width
from xihe_blender.addon.properties import last_run_folder
from xihe_blender.addon.runs_folder import last_run
from xihe_blender.apply.datablocks import COMPARISON_NAME, FRAME, image_named
from xihe_blender.errors import UserError
from xihe_blender.scene.blend_file import room_of

MARGIN_PX = 8.0
_handles: list[Any] = []


def shows_comparison(context: bpy.types.Context) -> bool:
    """Whether the Image Editor of `context` shows the comparison."""
    image = context.space_data.image
    return image is not None and image == image_named(COMPARISON_NAME)


def draw_labels() -> None:
    """Called by Blender for every Image Editor that is drawn: names both sides, and the frame."""
    context = bpy.context
    if not shows_comparison(context):
        return
    room = room_of(context.scene)
    run = last_run(room.xihe.run_folder)
    if run is None:
        return
    scale = context.preferences.system.ui_scale
    to_region = context.region.view2d.view_to_region
    left, top = to_region(0.0, 1.0, clip=False)
    right, _ = to_region(1.0, 1.0, clip=False)
    line = top - (LINE * FONT_PX + MARGIN_PX) * scale
    if room.xihe.wipe > 0:
        draw_text(left + MARGIN_PX * scale, line, f"Estimate: {run.settings.estimator}")
    if room.xihe.wipe < 1:
        draw_text(right - MARGIN_PX * scale - text_width("Ground truth"), line, "Ground truth")
    _, bottom = to_region(0.0, 0.0, clip=False)
    frame = context.space_data.image.get(FRAME)
    draw_text(left + MARGIN_PX * scale, bottom + MARGIN_PX * scale, f"Frame {frame}")


def draw_wipe(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """In the header of the editor, beside the picture that it wipes."""
    if shows_comparison(context):
        header.layout.prop(room_of(context.scene).xihe, "wipe", slider=True)


def follow_playhead() -> None:
    """Show the compared frame next to the playhead, where that is another one than is shown."""
    image, job, scene = image_named(COMPARISON_NAME), bpy.context.window_manager.xihe, bpy.context.scene
    if image is None or bpy.app.is_job_running("RENDER") or (job.is_running and job.works_here):
        return
    room = room_of(scene)
    run = last_run(room.xihe.run_folder)
    if run is None or run.nearest_compared_frame(scene.frame_current) in (None, image.get(FRAME)):
        return
    from xihe_blender.addon.results_in_blender import show_comparison

    # Its pictures are gone: the last one stays, and Compare says why.
    with contextlib.suppress(UserError):
        show_comparison(last_run_folder(room), scene.frame_current, room.xihe.wipe)


@bpy.app.handlers.persistent
def _playhead_moved(*_: Any) -> None:
    """Follow it once the frame is done: Blender 5.2 crashes on images that come and go while it is evaluated."""
    if not bpy.app.timers.is_registered(follow_playhead):
        bpy.app.timers.register(follow_playhead, first_interval=0.0)


HANDLERS = {"frame_change_post": _playhead_moved}


def register() -> None:
    if bpy.app.background:
        return
    _handles.append(bpy.types.SpaceImageEditor.draw_handler_add(draw_labels, (), "WINDOW", "POST_PIXEL"))
    bpy.types.IMAGE_HT_header.append(draw_wipe)


def unregister() -> None:
    if not _handles:
        return
    bpy.types.IMAGE_HT_header.remove(draw_wipe)
    bpy.types.SpaceImageEditor.draw_handler_remove(_handles.pop(), "WINDOW")
