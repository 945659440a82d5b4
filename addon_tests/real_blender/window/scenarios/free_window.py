"""A run in the background: the window stays free, the file is left and found again, and a stopped run resumes."""

import json
import os
import time
from pathlib import Path

import bpy
from rooms import look_through_camera, make_runs_short, room_with_a_virtual_ball

from xihe_blender import addon
from xihe_blender.addon.background_run import BackgroundRun, is_locked
from xihe_blender.addon.preferences import XihePreferences

BEAT_S = 0.02
N_DRAWS = 8


def prepare():
    """Long enough that a run is still under way while it is disturbed."""
    room_with_a_virtual_ball(frame_end=12)


class Heartbeat:
    """The longest time for which Blender did not come back to its timers."""

    def __init__(self):
        self.longest_s, self.last, self.is_over = 0.0, time.perf_counter(), False
        bpy.app.timers.register(self.beat, persistent=True)

    def beat(self):
        now = time.perf_counter()
        self.longest_s, self.last = max(self.longest_s, now - self.last), now
        return None if self.is_over else BEAT_S

    def stop(self):
        self.is_over = True
        return self.longest_s


def job():
    return bpy.context.window_manager.xihe


def run_folder():
    return Path(bpy.context.scene.xihe.run_folder)


def results():
    return json.loads((run_folder() / "results.json").read_text())


def start(w):
    yield from w.click_on("xihe.run(")
    yield from w.wait_until(lambda: job().is_running and job().progress > 0, "the run begins")


def wait_for_end(w):
    yield from w.wait_until(lambda: not job().is_running, "the run ends")
    yield 0.5


def wait_for_results(w, folder):
    """Not merely for the end: on a busy machine a resumed run has not begun when its button was just clicked."""
    yield from w.wait_until(lambda: run_folder() == folder and not job().is_running, "the run's results are shown")
    yield 0.5


def scenario(w):
    make_runs_short(bpy.context.scene)
    look_through_camera(w)
    yield from w.open_tab()
    file = str(w.out / "room.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    yield from undisturbed(w)
    yield from edited(w)
    yield from left_and_found_again(w, file)
    yield from stopped_and_resumed(w)


def undisturbed(w):
    """By its numbers the reference of all others, and by its heartbeat."""
    yield from w.find("xihe.run(")
    yield 2
    heart = Heartbeat()
    for _ in range(N_DRAWS):
        w.area.tag_redraw()
        yield 0.1
    w.facts["draw_s"] = heart.stop()
    w.click()
    heart = Heartbeat()
    yield from w.wait_until(lambda: job().is_running and job().progress > 0, "the run begins")
    pid = BackgroundRun(Path(job().unshown_run)).state.pid
    w.facts["niceness"] = os.getpriority(os.PRIO_PROCESS, pid)
    yield from wait_for_end(w)
    w.facts["longest_s"] = heart.stop()
    w.facts["undisturbed"] = {"error": job().error, "folder": str(run_folder()), "results": results()}


def edited(w):
    """The run knows the scene as it was when it began, and the panel says when that was; Undo takes an edit back."""
    yield from start(w)
    place = bpy.data.objects["Ball"].location.copy()
    with w.context():
        bpy.ops.ed.undo_push(message="Before")
        bpy.data.objects["Ball"].location.x += 0.3
        bpy.data.materials.new("Made Meanwhile")
        bpy.ops.ed.undo_push(message="Edit")
    w.move(w.area.x + w.area.width * 0.3, w.area.y + w.area.height * 0.5)
    yield 0.5
    w.facts["is_free"] = job().is_running
    w.press("ctrl+z")
    yield 0.5
    w.facts["undone"] = bpy.data.objects["Ball"].location == place
    yield from wait_for_end(w)
    made_of = bpy.context.scene.xihe.run_made_of
    w.facts["edited"] = {"error": job().error, "made_of": made_of, "results": results()}
    yield from w.picture("edited")


def left_and_found_again(w, file):
    yield from start(w)
    bpy.ops.wm.save_mainfile()
    folder = Path(job().unshown_run)
    bpy.ops.wm.read_homefile(load_ui=False)
    yield 1
    w.facts["goes_on"] = is_locked(folder / "work" / "lock")
    w.facts["said_elsewhere"] = job().unshown_run
    bpy.ops.wm.open_mainfile(filepath=file, load_ui=False)
    yield 1
    w.facts["found"] = Path(job().unshown_run) == folder
    addon.unregister()
    addon.register(XihePreferences.bl_idname)
    yield 1
    w.facts["found_when_enabled"] = Path(job().unshown_run) == folder
    yield from w.open_tab()
    yield from w.picture("found_again")
    yield from w.click_on("xihe.resume_run")
    yield from wait_for_results(w, folder)
    w.facts["found_again"] = {"error": job().error, "same": run_folder() == folder, "results": results()}
    w.facts["left"] = job().unshown_run


def stopped_and_resumed(w):
    yield from start(w)
    folder = Path(job().unshown_run)
    w.move(w.area.x + w.area.width * 0.3, w.area.y + w.area.height * 0.5)
    yield 0.3
    w.press("Escape")
    yield from wait_for_end(w)
    w.facts["stopped"] = {"is_locked": is_locked(folder / "work" / "lock"), "progress": job().progress}
    w.facts["stopped"]["has_ended"] = (folder / "results.json").exists()
    yield from w.picture("stopped")
    yield from w.click_on("xihe.resume_run")
    yield from wait_for_results(w, folder)
    w.facts["resumed"] = {"error": job().error, "same": run_folder() == folder, "results": results()}
    yield from start(w)
    folder = Path(job().unshown_run)
    yield from w.click_on("xihe.cancel_run", across=0.89)
    yield from wait_for_end(w)
    yield from w.click_on("xihe.discard_run", across=0.89)
    yield 1
    w.facts["kept_while_asking"] = folder.exists()
    w.press("Return")
    yield 0.5
    w.facts["discarded"] = not folder.exists() and not job().unshown_run
