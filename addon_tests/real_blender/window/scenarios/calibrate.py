"""What presets cost here: stopped with Esc, stopped with the button, then left alone until the panel has the answer."""

import bpy
from rooms import look_through_camera, make_runs_short
from scene_snapshot import differences, snapshot

from xihe_blender.addon import panels
from xihe_blender.addon.planning_operators import calibration_file, calibration_line


def prepare():
    from tiny_scenes import room_with_a_virtual_sphere

    room_with_a_virtual_sphere()


def scenario(w):
    bpy.ops.wm.save_as_mainfile(filepath=str(w.out / "small_room.blend"))
    make_runs_short(bpy.context.scene)
    # Else it is over before anyone could stop it.
    bpy.context.scene.xihe.size = (256, 192)
    look_through_camera(w)
    yield from w.open_tab()
    # While something runs, the button that stops it is beside its progress, where Run is else.
    yield from w.find("xihe.run(")
    run_at = w.found_at
    before = snapshot()

    def escape():
        w.press("Escape")
        yield 0.1

    def button():
        w.move(w.sidebar_x(0.89), run_at)
        yield 0.1
        w.click()
        yield 0.1

    def look():
        while not bpy.context.window_manager.xihe.progress:
            yield 0.02
        # What a step tells is drawn after the tick that follows it.
        yield 0.02
        w.picture_now("running")

    for name, do in (("stopped_with_escape", escape), ("stopped_with_button", button), ("left_alone", look)):
        steps = yield from calibrated(w, do)
        yield from w.picture(name)
        changed, new = differences(before, snapshot())
        w.facts[name] = {
            "steps": steps,
            "changed": changed,
            "new": new,
            "is_remembered": calibration_file().exists(),
            "error": bpy.context.window_manager.xihe.error,
        }
    w.facts["said"] = calibration_line()
    w.facts["drawn"] = yield from sentences_drawn(w)


def calibrated(w, do):
    """Click on Calibrate, `do` that once it has begun, and wait for its end; returns how far it said it was."""
    job = bpy.context.window_manager.xihe
    yield from w.find("xihe.calibrate(")
    w.click()
    yield from w.wait_until(lambda: job.is_running and job.doing != "starting", "it begins", at_most_s=30)
    steps, acts = [], do()
    while job.is_running:
        if [job.progress, job.doing] not in steps:
            steps.append([job.progress, job.doing])
        yield next(acts, 0.02)
    yield 0.5
    return steps


def sentences_drawn(w):
    """What the tab says in sentences when it is drawn the next time."""
    drawn, draw = [], panels.sentence

    def note(context, layout, text, **options):
        drawn.append(text)
        draw(context, layout, text, **options)

    panels.sentence = note
    w.area.tag_redraw()
    yield 1
    panels.sentence = draw
    return drawn
