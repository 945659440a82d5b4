"""After a run: where should the phone look? Said below the button, drawn as an arrow in the view, done by a camera."""

import json

import bpy
from rooms import make_runs_short, room_with_a_virtual_ball


def prepare():
    room_with_a_virtual_ball(6)


def scenario(w):
    scene, job = bpy.context.scene, bpy.context.window_manager.xihe
    make_runs_short(scene)
    bpy.context.preferences.system.use_region_overlap = False
    bpy.data.objects["Room"].hide_set(True)
    view = w.area.spaces.active.region_3d
    view.view_location, view.view_distance = (-0.5, -0.8, 1.2), 4.5
    yield from w.open_tab()
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: scene.xihe.run_folder and not job.is_running, "the run is over", at_most_s=600)
    yield 0.5
    yield from w.click_on("xihe.look_where")
    yield from w.wait_until(lambda: len(job.looks) > 0, "the advice is there")
    yield 0.5
    w.facts["said"], w.facts["frame"] = job.looks[0].sentence, json.loads(job.looks[0].look)["frame"]
    yield from w.picture("advice")
    yield from w.click_on("xihe.add_better_camera", across=0.8)
    yield 0.5
    w.facts["cameras"] = sorted(camera.name for camera in bpy.data.cameras)
    yield from w.picture("camera")
