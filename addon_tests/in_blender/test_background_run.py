"""A run in a second Blender: one that ends without a word, of a scene that was renamed, and what its window shows."""

import platform
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import bpy
import pytest
from addon_runs import enable_preferences
from previs_runs import walk
from tiny_scenes import empty_scene

from xihe_blender.addon import leftovers
from xihe_blender.addon.background_run import BackgroundRun, RunState, saved_for_run
from xihe_blender.addon.modal_job import RunUnderWay
from xihe_blender.addon.panels import ended_elsewhere
from xihe_blender.addon.run_operators import Following
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json
from xihe_blender.io.outputs import write_json
from xihe_blender.jobs import Progress, run_blocking
from xihe_blender.scene.blend_file import ROOM


def test_a_run_that_ended_early_says_how_to_go_on_and_where_its_console_is(tmp_path):
    run = saved_for_run(bpy.context.scene, tmp_path, {})
    died = subprocess.Popen([sys.executable, "-c", "raise SystemExit(7)"])
    died.wait()
    for process, ended in ((None, ""), (died, " (exit code 7)")):
        with pytest.raises(UserError) as raised:
            run_blocking(BackgroundRun(run.folder, process).follow())
        console = run.outputs.console
        assert str(raised.value) == f"the run ended early{ended}: Resume goes on with it. Its console is in {console}"


HOLDS_A_LOCK = """
import sys
from pathlib import Path
from xihe_blender.io.folder_manifest import take_lock
file = Path(sys.argv[1]).open("ab")
memory = b"x" * 200_000_000  # Which takes a moment to be given back.
print(take_lock(file), flush=True)
sys.stdin.read()
"""


def test_a_run_of_another_blender_has_ended_when_it_is_stopped(tmp_path):
    run = saved_for_run(bpy.context.scene, tmp_path, {})
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", HOLDS_A_LOCK, str(run.outputs.lock)], **piped) as other:
        assert other.stdout.readline() == "True\n"
        state = RunState(0, 1, "", {}, pid=other.pid, host="elsewhere", error="")
        write_json(run.outputs.progress, as_json(state))
        with pytest.raises(UserError, match="is under way in another Blender: stop it there"):
            run.discard()
        operator = SimpleNamespace(background=run, cancelled="")
        Following.stop(operator)  # As Esc does.
        assert operator.cancelled == "The run goes on in another Blender: stop it there"
        assert run.is_under_way and other.poll() is None and run.outputs.request.exists()
        write_json(run.outputs.progress, as_json(replace(state, host=platform.node())))
        assert run.is_under_way
        run.stop()
        assert not run.is_under_way


def test_a_run_whose_scene_was_renamed_is_shown_there_and_one_whose_scene_was_deleted_in_no_other(tmp_path, addon):
    hall, kitchen = bpy.context.scene, bpy.data.scenes.new("Kitchen")
    run = saved_for_run(kitchen, tmp_path, {})
    assert run.find_scene() == kitchen
    kitchen.name, kitchen.xihe.begun_run = "Bath", str(run.folder)  # As Run notes it.
    lit = kitchen.copy()
    lit.name, lit[ROOM] = "Aisle", kitchen  # As Show Lit makes it.
    assert run.find_scene() == kitchen
    enable_preferences().cache_folder = str(tmp_path.parent)
    kitchen.xihe.begun_run = f"/elsewhere/{tmp_path.name}"
    assert run.find_scene() == kitchen, "the run was moved with its file"
    bpy.data.scenes.remove(lit)
    bpy.data.scenes.remove(kitchen)
    with pytest.raises(UserError, match="no scene is called 'Kitchen' any more: give the run's scene that name"):
        run.find_scene()
    asked, hall.name = hall.name, "Kitchen"
    assert run.find_scene() == hall
    hall[ROOM] = True
    with pytest.raises(UserError, match="no scene is called 'Kitchen' any more"):
        run.find_scene()
    del hall[ROOM]
    hall.name = asked


def test_the_run_of_a_scene_that_is_linked_is_another_files(tmp_path, addon):
    run, job = saved_for_run(empty_scene(), tmp_path, {}), bpy.context.window_manager.xihe  # In no file.
    kitchen = bpy.data.scenes.new("Kitchen")
    kitchen.xihe.begun_run = str(run.folder)
    leftovers._look_for_run()
    assert job.unshown_run == str(run.folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "kitchen.blend"), copy=True)
    bpy.data.scenes.remove(kitchen)
    with bpy.data.libraries.load(str(tmp_path / "kitchen.blend"), link=True) as (_, linked):
        linked.scenes = ["Kitchen"]
    leftovers._look_for_run()
    assert job.unshown_run == ""


def test_a_run_that_ends_while_another_scene_is_shown_is_said_there(finished, addon):
    scene, job = walk(), bpy.context.window_manager.xihe
    kitchen = bpy.data.scenes.new("Kitchen")
    operator = SimpleNamespace(background=None, folder=finished.outputs.folder, report=lambda *_: None)
    for of_run, said in ((scene, ""), (kitchen, "The run of scene 'Kitchen' is finished: go there to see it")):
        operator.scene = of_run
        Following.finish(operator, bpy.context, None)
        assert ended_elsewhere(bpy.context) == said
    kitchen.name = "Bath"
    assert ended_elsewhere(bpy.context) == ""
    job.ended_in = ""


def test_the_mouse_pointer_shows_the_progress_of_a_job_in_this_file_alone():
    shown = []
    manager = SimpleNamespace(
        xihe=SimpleNamespace(), windows=(), progress_begin=lambda *_: None, progress_update=shown.append,
        progress_end=lambda: None,
    )  # fmt: skip
    job = (Progress(done, 4, "capturing") for done in (1, 2, 3))
    run = RunUnderWay(SimpleNamespace(window_manager=manager, workspace=None), job)
    run.step()
    manager.xihe.works_here = False
    run.step()
    assert (shown, manager.xihe.progress) == ([25], 0.5)
    run.end()
