"""What presets cost on this machine: the function, and the button that calls it."""

import json
from dataclasses import asdict, replace

import bpy
import numpy as np
import pytest
from addon_runs import walk_for_the_panel
from previs_runs import counted_renders
from scene_snapshot import nothing_changes
from tiny_scenes import look_at, room_with_a_virtual_sphere

from xihe_blender.addon.planning_operators import calibration_file, calibration_line
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.run_time import Calibration, calibrate, format_calibration, save_calibration
from xihe_blender.previs.settings import PrevisSettings

pytestmark = pytest.mark.usefixtures("addon")
SMALL = PrevisSettings(size=(32, 24), exposure=1.0)
KNOWN = Calibration("room", {"draft": 0.41, "balanced": 0.9, "accurate": 3.14}, {"draft": 1})


def test_dearer_presets_take_no_less_and_the_scene_stays_as_it_is():
    scene = room_with_a_virtual_sphere()
    with nothing_changes():
        found = run_blocking(calibrate(scene, SMALL))
    assert list(found.frame_s) == list(found.samples) == list(PRESETS)
    for values in (list(found.frame_s.values()), list(found.samples.values())):
        assert values == sorted(values) and values[0] > 0


def test_it_can_be_stopped_after_each_capture():
    scene = room_with_a_virtual_sphere()
    with counted_renders() as renders:
        captured = [renders.count("Xihe Capture") for _ in calibrate(scene, SMALL)]
    assert max(np.diff(captured)) == 1 < captured[-1]


def test_what_is_remembered_is_whole_and_says_its_sentence(tmp_path):
    save_calibration(tmp_path / "deep" / "calibration.json", KNOWN)
    kept = json.loads((tmp_path / "deep" / "calibration.json").read_text(encoding="utf-8"))
    said = "Capturing a frame of room took 0.41 s at draft, 0.90 s at balanced and 3.1 s at accurate quality"
    assert kept == {**asdict(KNOWN), "said": said} and format_calibration(KNOWN) == said


@pytest.mark.slow
def test_the_button_keeps_what_the_function_measures_and_the_panel_says_it(tmp_path):
    scene = walk_for_the_panel(tmp_path / "runs")
    assert calibration_line() == ""
    assert bpy.ops.xihe.calibrate() == {"FINISHED"}
    kept = json.loads(calibration_file().read_text(encoding="utf-8"))
    assert calibration_file().parent == tmp_path / "runs"
    again = Calibration(**{name: value for name, value in kept.items() if name != "said"})
    assert calibration_line() == kept["said"] == format_calibration(again)
    size = tuple(scene.xihe.size)
    by_function = run_blocking(calibrate(scene, replace(SMALL, size=size, preset="draft", exposure=None)))
    # Times differ from one measurement to the next, and what follows from the scene alone does not.
    assert by_function.samples == kept["samples"] and by_function.scene == kept["scene"]


def test_a_path_that_never_sees_an_object_is_refused():
    scene = room_with_a_virtual_sphere(is_still=True)
    look_at(scene.camera, (-1.2, -1.5, 1.5), (-1.2, -3.0, 1.5))
    with pytest.raises(UserError, match="never has a virtual object in view"):
        run_blocking(calibrate(scene, SMALL))


def test_costs_that_cannot_be_kept_are_a_line_that_names_the_place(tmp_path):
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    walk_for_the_panel(tmp_path / "file")
    with pytest.raises(RuntimeError, match=r"file.*: File exists"):
        bpy.ops.xihe.calibrate()
    window_manager = bpy.context.window_manager.xihe
    assert "File exists" in window_manager.error and not window_manager.is_running
    assert calibration_line() == ""
