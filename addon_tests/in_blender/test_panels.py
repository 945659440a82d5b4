"""What the tab says, and from where: held against the work modules and a results.json, without a window."""

import json
import os
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from addon_runs import registered_addon

from addon_tests.pure import runs
from xihe_blender.addon import panels
from xihe_blender.addon import runs_folder as reader
from xihe_blender.addon.failures import in_the_panels_words
from xihe_blender.addon.polls import has_comparison
from xihe_blender.io.json_records import from_json
from xihe_blender.io.run_results import EffectResult
from xihe_blender.previs.presets import PRESETS

CONTENT = runs.content(
    [
        runs.frame(1, runs.probe("Ball", coverage=0.25, fired=True, reason="first")),
        runs.frame(2, runs.probe("Ball", coverage=0.75)),
        runs.frame(3, runs.probe("Vase", coverage=0.5, fired=True, reason="first")),
    ],
    lights={"Ball": [], "Vase": []},
    settings={"estimator": "lattice"},
    summary={
        "n_frames": 2,
        "n_estimates": 3,
        "mean_shc_rmse": 0.25,
        "mean_coverage": 0.5,
        "mean_step_ms": 3.25,
        "render_s": 61.0,
        "comparison_render_s": 20.0,
        "n_compared_frames": 1,
    },
)


@pytest.fixture
def run_folder(tmp_path):
    (tmp_path / "results.json").write_text(json.dumps(CONTENT), encoding="utf-8")
    return tmp_path


def test_the_last_run_is_read_out_of_its_results(run_folder):
    run = reader.last_run(str(run_folder))
    assert run.last_coverage == {"Ball": 0.75, "Vase": 0.5}
    rows = {name: value for name, value, _ in panels.result_rows(run)}
    assert (rows["Light Error"], rows["Ambient Error"], rows["Rendering"]) == ("0.250", "none", "1 min 21 s")
    assert rows["Estimates"] == "3 in 2 frames"


def test_a_copy_of_a_scene_says_which_scene_its_results_are_of(run_folder):
    run = reader.last_run(str(run_folder))
    with registered_addon():
        ran, other = bpy.data.scenes.new("Ran"), bpy.data.scenes.new("Copy")
        run = replace(run, scene=replace(run.scene, name=ran.name))
        assert panels.made_of(ran, run) == ""
        assert panels.made_of(other, run) == f"These results are of scene {ran.name!r}"
        ran.xihe.run_made_of = other.xihe.run_made_of = "14:03"
        assert panels.made_of(ran, run) == "These results are of the scene as it was at 14:03"
        assert panels.made_of(other, run) == f"These results are of scene {ran.name!r} as it was at 14:03"
        bpy.data.scenes.remove(ran)
        assert panels.made_of(other, run) == "These results are of the scene as it was at 14:03", "renamed since"


def test_results_name_the_phone_and_the_network_that_were_simulated(run_folder):
    run = reader.last_run(str(run_folder))
    assert panels.simulated_phone(run) == ""
    of_wifi = replace(run, settings=replace(run.settings, network="wifi"))
    assert panels.simulated_phone(of_wifi) == "Network: Wi-Fi"
    left_out = from_json(EffectResult, {"name": "network", "state": "off", "reason": "chosen"})
    assert panels.simulated_phone(replace(of_wifi, effects=(left_out,))) == ""
    chosen = replace(of_wifi.settings, phone="/phones/mine.toml")
    of_both = replace(of_wifi, settings=chosen, phone=replace(run.phone, name="Our Phone"))
    assert panels.simulated_phone(of_both) == "Phone: Our Phone. Network: Wi-Fi"


def test_the_tooltip_of_unknown_lights_says_how_many_the_server_did_not_answer(run_folder):
    for counts, said in (({"nothing_seen": 2}, False), ({"no_answer": 2}, True)):
        invalid = runs.SUMMARY["invalid"] | {"lights": counts}
        content = CONTENT | {"summary": CONTENT["summary"] | {"n_unknown_lights": 2, "invalid": invalid}}
        (run_folder / "results.json").write_text(json.dumps(content), encoding="utf-8")
        os.utime(run_folder / "results.json", (said, said))
        (tip,) = (
            tip for name, _, tip in panels.result_rows(reader.last_run(str(run_folder))) if name == "Unknown Light"
        )
        assert ("edge service did not answer: 2 of them" in tip) == said


def test_several_estimators_stand_in_a_table_with_the_best_picture_first(run_folder):
    metrics = dict.fromkeys(("psnr", "ssim", "si_rmse", "angular_deg"))
    several = CONTENT | {
        "settings": CONTENT["settings"] | {"others": ["projection"]},
        "summary": CONTENT["summary"]
        | {"others_shc_rmse": {"projection": 0.125}, "ambient_shc_rmse": 0.5}
        | {"estimate_ms": {"lattice": 1.25, "projection": 0.5}},
        "comparison": {
            name: metrics | {"rmse": rmse} for name, rmse in (("lattice", 0.2), ("projection", 0.1), ("ambient", None))
        },
    }
    (run_folder / "results.json").write_text(json.dumps(several), encoding="utf-8")
    assert panels.method_rows(reader.last_run(str(run_folder))) == [
        ("projection", "0.125", "0.100", "0.5"),
        ("lattice", "0.250", "0.200", "1.2"),
        ("ambient", "0.500", "none", "none"),
    ]


def test_what_a_run_asks_to_check_is_shown_in_the_panels_words_and_the_rest_is_in_the_report(run_folder):
    first = "2 frames showed no surface at all: check the camera's clip range."
    said = [first, "Set another with --exposure.", "c", "d"]
    for n, shown in ((0, []), (3, [first, "Set another with Own Exposure.", "c"])):
        content = CONTENT | {"notes": ["One Blender unit is 0.1 m", *said], "warnings": said[:n]}
        (run_folder / "results.json").write_text(json.dumps(content), encoding="utf-8")
        os.utime(run_folder / "results.json", (n, n))
        assert panels.shown_warnings(reader.last_run(str(run_folder))) == shown
    many = replace(reader.last_run(str(run_folder)), warnings=(*said, "e"))
    assert panels.shown_warnings(many)[3:] == ["And 2 more: see the report"]


def test_errors_of_the_command_line_are_said_in_the_panels_words():
    said = in_the_panels_words("light.exr cannot be read: run xihe previs again, or add --light sh+key with --units")
    assert said == "light.exr cannot be read: run again, or add Light sh+key with --units"
    said = in_the_panels_words("cannot write viewer.html (Read-only file system): choose another folder for --out")
    assert said.endswith("(Read-only file system): run again, with a Runs Folder that can be written to")


def test_results_are_read_once_until_they_change(run_folder):
    first = reader.last_run(str(run_folder))
    assert reader.last_run(str(run_folder)) is first
    changed = CONTENT | {"settings": CONTENT["settings"] | {"estimator": "ambient"}}
    path = run_folder / "results.json"
    path.write_text(json.dumps(changed), encoding="utf-8")
    before = path.stat().st_mtime
    os.utime(path, (before + 5, before + 5))
    assert reader.last_run(str(run_folder)).settings.estimator == "ambient"


def test_whether_a_run_compared_a_frame_is_known_without_looking_through_its_pictures(run_folder, monkeypatch):
    """Of a long run these are tens of thousands of files, and buttons are drawn with every move of the mouse."""
    listed, scandir = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: listed.append(path) or scandir(path))
    with registered_addon():
        bpy.context.scene.xihe.run_folder = str(run_folder)
        assert has_comparison(bpy.context) == "The last run compared no frame: no virtual object was in view"
        compared = runs.frame(4, runs.probe("Ball"), **runs.compared(["ground_truth"]))
        content = CONTENT | {"frames": [*CONTENT["frames"], compared]}
        (run_folder / "results.json").write_text(json.dumps(content), encoding="utf-8")
        os.utime(run_folder / "results.json", (1, 1))
        assert has_comparison(bpy.context) is None
    assert not listed


def test_results_that_are_none_and_a_folder_that_is_gone_are_no_run(tmp_path):
    for text in ("", "{", "[]", "{}", '{"summary": {}, "frames": []}', '{"frames": 3, "summary": 1}'):
        (tmp_path / "results.json").write_text(text, encoding="utf-8")
        assert reader.last_run(str(tmp_path)) is None, text
    assert reader.last_run(str(tmp_path / "gone")) is reader.last_run("") is None
    assert len({panels.missing_run(*of) for of in (("", False), ("somewhere", False), ("", True))}) == 3


def test_progress_tells_the_time_left_and_sentences_are_wrapped_and_lose_no_word():
    assert panels.format_progress(0.0, 0.0) == "0%"
    assert panels.format_progress(0.43, 83) == "43%, 1 min 23 s left"
    text = "you turned it on; by itself it would be off: no smoke, fog or other volumes are rendered"
    lines = panels.wrapped(text, 30)
    assert " ".join(lines) == text
    assert max(map(len, lines)) <= 30
    assert panels.wrapped("", 30) == []
    assert panels.wrapped("took 2.4 s, then 19 min", 8) == ["took", "2.4 s,", "then", "19 min"]


def test_a_run_of_another_day_is_told_with_its_date():
    assert re.fullmatch(r"at \d\d:\d\d", panels.format_begun(time.time()))
    assert re.fullmatch(r"on 2001-09-\d\d at \d\d:\d\d", panels.format_begun(1e9))


def test_every_panel_is_in_the_tab_in_the_order_of_the_chain():
    stages = [cls for cls in panels.classes if issubclass(cls, bpy.types.Panel) and not hasattr(cls, "bl_parent_id")]
    assert [cls.bl_category for cls in stages] == ["Xihe"] * len(stages)
    assert [cls.bl_order for cls in stages] == list(range(len(stages)))
    names = ["Virtual Objects", "Camera Path", "Effects", "Estimator", "Run", "Apply", "Results"]
    assert [cls.bl_label for cls in stages] == names


def test_the_readme_says_where_the_quickest_quality_is_chosen():
    readme = Path(__file__).parents[2].joinpath("README.md").read_text(encoding="utf-8")
    with registered_addon():
        quality = bpy.context.scene.xihe.bl_rna.properties["preset"]
        where = f"{panels.XIHE_PT_estimator.bl_label} > {quality.name} > {PRESETS['draft'].label}"
    assert f"**{where}** is quickest" in readme


@pytest.mark.wheel_only(
    "starts a Python that has bpy as a module; real_blender/test_start_up.py asks it of a whole Blender"
)
def test_what_is_asked_at_every_redraw_needs_nothing_heavy():
    heavy = ["torch", "OpenEXR", "numpy"]
    root = Path(__file__).resolve().parents[2]
    # A module that is None cannot be imported. The wheel itself has imported NumPy already.
    code = (
        f"import sys, bpy; sys.modules.update(dict.fromkeys({heavy}));"
        "from xihe_blender.addon import panels, overlay, runs_folder;"
        "from xihe_blender.scene.virtual_objects import virtual_objects;"
        "virtual_objects(bpy.context.scene); runs_folder.last_run('/nowhere');"
        "from xihe_blender import addon; from xihe_blender.addon import polls; addon.register('xihe_test');"
        "polls.doubts(bpy.context.scene);"
        "conditions = [value for name, value in vars(polls).items() if name.startswith(('is_', 'has_'))"
        " and value.__module__ == polls.__name__];"
        "said = [condition(bpy.context) for condition in conditions]; addon.unregister();"
        "print(said.count(None), len(said))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root)
    n_true, n_asked = map(int, done.stdout.split()[-2:])
    assert 0 < n_true < n_asked


@pytest.mark.parametrize(("width_px", "scale", "is_narrow"), [(209, 1.0, True), (291, 1.0, False), (316, 1.5, True)])
def test_buttons_are_one_below_the_other_where_the_sidebar_would_cut_them(width_px, scale, is_narrow):
    system = SimpleNamespace(ui_scale=scale)
    context = SimpleNamespace(preferences=SimpleNamespace(system=system), region=SimpleNamespace(width=width_px))
    assert panels.is_narrow(context) == is_narrow
