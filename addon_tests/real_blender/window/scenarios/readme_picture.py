"""The picture of the README: the tab beside a lit room, and estimate against ground truth beside both."""

import bpy
from window_steps import smooth_edges


def scenario(w):
    scene = bpy.context.scene
    bpy.context.preferences.view.ui_scale = 0.9
    smooth_edges(True)
    tidy_window(w)
    yield 1
    timeline = next(a for a in w.window.screen.areas if a.type == "DOPESHEET_EDITOR")
    edge = timeline.x + timeline.width / 3, timeline.y + timeline.height
    # Room for the markers at the triggers.
    yield from w.drag(edge, (edge[0], edge[1] + 20))
    yield from w.open_tab()
    scene.xihe.run_folder = str(w.run_folder)
    scene.xihe.preset = "draft"
    scene.frame_set(1)
    with w.context():
        w.facts["applied"] = sorted(bpy.ops.xihe.apply_light())
        w.facts["compared"] = sorted(bpy.ops.xihe.show_comparison())
    scene.xihe.wipe = 0.73
    yield 1
    fit_image(w)
    w.move(w.window.width * 0.3, 5)
    for area in w.window.screen.areas:
        area.tag_redraw()
    yield 4
    yield from w.picture("panel")


def tidy_window(w):
    """The 3D view on the left, an Image Editor on the right, the timeline below; nothing else."""
    screen = w.window.screen
    for kind in ("OUTLINER", "PROPERTIES"):
        area = next(a for a in screen.areas if a.type == kind)
        with bpy.context.temp_override(window=w.window, area=area):
            bpy.ops.screen.area_close()
    with bpy.context.temp_override(window=w.window, area=w.area):
        bpy.ops.screen.area_split(direction="VERTICAL", factor=0.62)
    left, right = sorted((a for a in screen.areas if a.type == "VIEW_3D"), key=lambda a: a.x)
    # Blender changes areas for the window of the context, which a timer has none of.
    with bpy.context.temp_override(window=w.window, area=right):
        right.type = "IMAGE_EDITOR"
        right.spaces.active.show_region_toolbar = False
    with bpy.context.temp_override(window=w.window, area=left):
        space = left.spaces.active
        space.show_region_toolbar = space.show_gizmo = space.show_region_tool_header = False
        space.overlay.show_text = space.overlay.show_cursor = False
        space.shading.type = "MATERIAL"
        space.region_3d.view_perspective = "CAMERA"
        # Left of the sidebar, which lies over the view.
        space.region_3d.view_camera_zoom = 9
        space.region_3d.view_camera_offset = (0.14, 0.0)


def fit_image(w):
    area = next(a for a in w.window.screen.areas if a.type == "IMAGE_EDITOR")
    region = next(r for r in area.regions if r.type == "WINDOW")
    with bpy.context.temp_override(window=w.window, area=area, region=region):
        bpy.ops.image.view_all(fit_view=True)
