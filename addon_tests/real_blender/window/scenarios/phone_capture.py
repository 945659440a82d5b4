"""From a phone's recording to a lit object over its pictures: import, a ball on the scan, Run, play."""

import os
from pathlib import Path

import bpy
from mathutils import Vector
from rooms import look_through_camera

ABOVE_M = 0.3


def view(w):
    return next(region for region in w.area.regions if region.type == "WINDOW")


def scenario(w):
    scene = bpy.context.scene
    for item in list(scene.objects):
        bpy.data.objects.remove(item)
    bpy.ops.wm.save_as_mainfile(filepath=str(w.out / "shot.blend"))
    with w.context(view(w)):
        w.facts["imported"] = list(bpy.ops.xihe.import_capture(filepath=os.environ["XIHE_RECORDING"]))
    w.facts["frames"] = [scene.frame_start, scene.frame_end, scene.render.fps]
    w.facts["objects"] = sorted(item.name for item in scene.objects)
    look_through_camera(w)
    yield from w.picture("1_imported")
    place = put_ball(w, Vector(float(x) for x in os.environ["XIHE_AT"].split(",")))
    scene.xihe.preset = "draft"
    yield from w.open_tab()
    yield from w.click_on("xihe.add_virtual_objects", across=0.3)
    yield 0.5
    yield from w.picture("2_virtual")
    job = bpy.context.window_manager.xihe
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: job.is_running or scene.xihe.run_folder, "the run begins", at_most_s=60)
    yield from w.wait_until(lambda: not job.is_running, "the run ends", at_most_s=900)
    yield 1
    folder = Path(bpy.context.scene.xihe.run_folder)
    w.facts["error"], w.facts["stands_on"] = job.error, list(place)
    w.facts["left"] = sorted(path.name for path in folder.iterdir() if path.is_file())
    yield from w.picture("3_done")
    yield from w.click_on("xihe.show_lit")
    yield 4
    w.facts["lit_scene"] = w.window.scene.name
    for frame in (scene.frame_start, scene.frame_end):
        w.window.scene.frame_set(frame)
        yield 4
        w.picture_now(f"4_lit_{frame}")


def put_ball(w, above):
    """A ball on what the scan shows below a place; where it touches."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    down = Vector((0, 0, -1))
    was_hit, place, *_ = bpy.context.scene.ray_cast(depsgraph, above + ABOVE_M * Vector((0, 0, 1)), down)
    assert was_hit, "the scan has no surface there"
    with w.context(view(w)):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.12, location=place + Vector((0, 0, 0.12)))
    return place
