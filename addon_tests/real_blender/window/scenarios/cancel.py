"""A run that is stopped: once with Esc, once with the button beside the progress bar; the first Esc ends playback."""

import bpy
from rooms import look_through_camera, make_runs_short, room_with_a_virtual_ball


def prepare():
    """Long enough that it cannot be over before Esc comes."""
    room_with_a_virtual_ball(frame_end=200)


def state():
    names = sorted(block.name for kind in ("worlds", "scenes", "images") for block in getattr(bpy.data, kind))
    return [names, bpy.context.scene.frame_current, bpy.context.scene.xihe.run_folder]


def stopped_with(w, name, stop):
    """Start a run with the mouse, let it go on for a while, stop it."""
    job = bpy.context.window_manager.xihe
    before = state()
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: job.is_running, "the run begins", at_most_s=30)
    yield from w.wait_until(lambda: job.doing != "", "the run goes on", at_most_s=30)
    yield 1
    yield from stop()
    yield from w.wait_until(lambda: not job.is_running, "the run ends", at_most_s=60)
    yield 0.5
    w.facts[name] = {"same": state() == before, "error": job.error, "before": before, "after": state()}
    yield from w.picture(name)


def scenario(w):
    make_runs_short(bpy.context.scene)
    # A second Blender is quick, and the button has to be found while it works.
    bpy.context.scene.xihe.preset = "accurate"
    look_through_camera(w)
    yield from w.open_tab()

    def escape():
        w.move(w.area.x + w.area.width * 0.3, w.area.y + w.area.height * 0.5)
        yield 0.3
        with w.context():
            bpy.ops.screen.animation_play()
        yield 1
        w.press("Escape")
        yield 1
        is_playing = bpy.context.screen.is_animation_playing
        w.facts["after_playback"] = {"plays": is_playing, "runs": bpy.context.window_manager.xihe.is_running}
        w.press("Escape")

    def button():
        yield from w.click_on("xihe.cancel_run", across=0.89)

    yield from stopped_with(w, "stopped_with_escape", escape)
    yield from stopped_with(w, "stopped_with_button", button)
