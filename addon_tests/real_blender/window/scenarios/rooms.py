"""The rooms of the scenarios: so small that a run takes seconds in software OpenGL's company."""

import bpy


def room_to_light():
    """A closed room with a lamp, a moving phone and a ball that is not yet virtual; the ball is selected."""
    from tiny_scenes import room_with_a_virtual_sphere

    scene = room_with_a_virtual_sphere()
    ball = bpy.data.objects["Ball"]
    bpy.data.collections.remove(bpy.data.collections["Xihe Virtual"])
    scene.collection.objects.link(ball)
    ball.select_set(True)
    scene.frame_set(scene.frame_start)
    bpy.context.view_layer.objects.active = ball
    return scene


def room_with_a_virtual_ball(frame_end):
    """The same room, its ball virtual already, and a path as long as a run has to last."""
    from xihe_blender.scene.virtual_objects import virtual_collection

    scene = room_to_light()
    scene.frame_end = frame_end
    ball = bpy.data.objects["Ball"]
    scene.collection.objects.unlink(ball)
    virtual_collection(scene, create=True).objects.link(ball)


def make_runs_short(scene):
    """Small pictures and few samples, by the settings an artist has."""
    settings = scene.xihe
    settings.use_own_size, settings.size = True, (32, 24)
    settings.preset = "draft"
    # Of the view through Cycles, which takes all cores until it is done.
    scene.cycles.preview_samples = 4


def look_through_camera(window):
    """What a user sees after Numpad 0, set up so that software OpenGL draws it quickly."""
    # Else each move of the mouse over the sidebar draws the 3D view below it, too.
    bpy.context.preferences.system.use_region_overlap = False
    space = window.area.spaces.active
    space.region_3d.view_perspective = "CAMERA"
    space.shading.type = "SOLID"
