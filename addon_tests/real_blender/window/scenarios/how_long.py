"""The time of a run, measured by a click; and another, which would see nothing, is refused at once."""

import bpy
from rooms import look_through_camera, make_runs_short, room_with_a_virtual_ball


def prepare():
    room_with_a_virtual_ball(frame_end=3)


def scenario(w):
    job = bpy.context.window_manager.xihe
    make_runs_short(bpy.context.scene)
    look_through_camera(w)
    yield from w.open_tab()
    yield from w.click_on("xihe.measure_run")
    yield from w.wait_until(lambda: job.run_estimate and not job.is_running, "the time is known")
    yield 0.5
    w.facts["said"], w.facts["error"] = job.run_estimate, job.error
    yield from w.picture("how_long")
    bpy.data.objects["Ball"].location.z += 50
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: job.error, "the run is refused", at_most_s=20)
    w.facts["refused"], w.facts["unshown_run"] = job.error, job.unshown_run
    yield from w.picture("refused")
