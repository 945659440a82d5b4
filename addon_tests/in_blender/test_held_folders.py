"""A folder in which somebody is at work is refused, whatever the work, and what is in it stays as it is."""

import pytest
from previs_runs import QuickPrevis, files_below, walk
from tiny_scenes import saved

from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import take_lock
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.batch.batch import evaluate_batch
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.frontier.records import FrontierSettings
from xihe_blender.lab.frontier.study import frontier
from xihe_blender.lab.paper.run import PaperSettings, evaluate_paper
from xihe_blender.lab.rooms.build import build_dataset
from xihe_blender.lab.rooms.scene import add_scene
from xihe_blender.lab.rooms.settings import BuildSettings, RoomRenderSettings
from xihe_blender.previs.better_path import LookWishes, better_path
from xihe_blender.previs.error_budget import error_budget
from xihe_blender.previs.placement import PlacementSettings, placement
from xihe_blender.previs.previs import previs
from xihe_blender.previs.record import RecordWishes, record_session

QUICK = QuickPrevis(size=(24, 18), preset="draft", samples=1, exposure=1.0)
BATCH = {"n_workers": 1, "scheduler": None, "frontier": None}
WORK = {
    "batch": lambda _, file, out: evaluate_batch([file.with_name("none")], out, BatchSettings(), (0,), **BATCH),
    "frontier": lambda _, file, out: frontier([file], out, FrontierSettings(is_quick=True)),
    "paper": lambda _, file, out: evaluate_paper(out, PaperSettings(only=("anchors_uniform",), scenes=(file,)), ""),
    "rooms": lambda _, file, out: build_dataset(out, BuildSettings(1)),
    "scene": lambda scene, file, out: add_scene(scene, "walk", out, RoomRenderSettings()),
    "budget": lambda scene, file, out: error_budget(scene, out, QUICK),
    "look": lambda scene, file, out: better_path(scene, out, QUICK, LookWishes(), blend_file=file),
    "placement": lambda scene, file, out: placement(scene, out, QUICK, PlacementSettings(), blend_file=file),
    "run": lambda scene, file, out: previs(scene, out, QUICK),
    "record": lambda scene, file, out: record_session(scene, out, QUICK, RecordWishes(), blend_file=file),
}


@pytest.mark.parametrize("name", WORK)
def test_work_in_a_folder_of_work_under_way_is_refused(name, tmp_path):
    scene = walk()
    file, out = saved(tmp_path / "walk.blend"), tmp_path / "out"
    in_work = name in ("frontier", "budget", "look", "placement", "run", "record")
    (out / "work" if in_work else out).mkdir(parents=True)
    lock = (out / "work" / "held") if in_work else out / "held"
    with lock.open("ab") as held:
        assert take_lock(held)
        with pytest.raises(UserError, match=r"is under way in .*out: wait for its end, or choose another"):
            run_blocking(WORK[name](scene, file, out))
    assert set(files_below(out)) <= {str(lock.relative_to(out)), "work/survey.json"}
