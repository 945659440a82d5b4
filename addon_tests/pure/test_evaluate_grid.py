"""Which trials make up a batch, and whose folder it is."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from addon_tests.pure.batches import batch, results
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_json
from xihe_blender.lab.batch.grid import BatchSettings, planned_units
from xihe_blender.lab.batch.results import (
    TRIAL_COLUMNS,
    BatchFolder,
    batch_results,
    manifest_of,
    read_frontier,
    result_file,
    worst_frame,
    write_tables,
)

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = BatchSettings(estimators=("lattice", "ambient"), phones=("perfect", "ipad_pro_lidar"), frames=(1, 2))


def test_every_phone_meets_every_estimator_once():
    trials = SETTINGS.trials()
    assert len(set(trials)) == len(trials) == 4 and trials[0] == ("perfect", "lattice")


@pytest.mark.parametrize("wrong", [{"estimators": ()}, {"phones": ("perfect", "perfect")}])
def test_names_are_given_once(wrong):
    with pytest.raises(UserError, match="once"):
        replace(SETTINGS, **wrong)


def test_settings_survive_their_json():
    assert BatchSettings.from_json(json.loads(json.dumps(SETTINGS.as_json()))) == SETTINGS


def test_a_scene_that_cannot_be_read_does_not_stop_the_others(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"one")
    (tmp_path / "b.blend").write_bytes(b"two")
    scenes = [tmp_path / name for name in ("a.blend", "none.blend", "b.blend")]
    units, broken = planned_units(scenes, (0, 1))
    assert [(unit.scene.name, unit.seed) for unit in units] == [(n, s) for n in ("a.blend", "b.blend") for s in (0, 1)]
    assert list(broken) == [tmp_path / "none.blend"]


def test_the_same_scene_twice_is_one_unit_and_another_of_its_name_is_not(tmp_path):
    for folder, content in (("a", b"one"), ("b", b"two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "room.blend").write_bytes(content)
    files = [tmp_path / "a" / "room.blend", tmp_path / "b" / "room.blend"]
    units, _ = planned_units([*files, files[0]], (0,))
    assert len({unit.name for unit in units}) == len(units) == 2


def test_a_folder_goes_on_with_the_same_settings_alone(tmp_path):
    folder = BatchFolder(tmp_path / "out")
    manifest_of(folder, SETTINGS).take()
    manifest_of(folder, SETTINGS).take()
    with pytest.raises(UserError, match="another size"):
        manifest_of(folder, replace(SETTINGS, size=(32, 24))).take()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ('{"format": 1, "xihe": "0.0.1"}', "version of xihe"),
        ("[]", r"batch\.json is damaged"),
        ("{", r"batch\.json is damaged"),
        ("null", r"batch\.json is damaged"),
    ],
)
def test_a_folder_of_another_version_or_that_is_damaged_is_refused(tmp_path, content, says):
    (tmp_path / "batch.json").write_text(content)
    with pytest.raises(UserError, match=says):
        manifest_of(BatchFolder(tmp_path), SETTINGS).take()
    assert (tmp_path / "batch.json").read_text() == content


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "results.json").write_text("{}")
    with pytest.raises(UserError, match="not from a batch"):
        manifest_of(BatchFolder(tmp_path), SETTINGS).take()
    with pytest.raises(UserError, match="is a file"):
        manifest_of(BatchFolder(tmp_path / "results.json"), SETTINGS).take()


def test_a_result_that_is_damaged_is_none(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"one")
    (unit,), _ = planned_units([tmp_path / "a.blend"], (0,))
    folder = BatchFolder(tmp_path / "out")
    assert folder.result(unit) is None
    write_json(result_file(folder.of_unit(unit)), {"trials": []})
    assert folder.result(unit) == {"trials": []}
    result_file(folder.of_unit(unit)).write_text('{"tri')
    assert folder.result(unit) is None


def test_only_units_that_are_done_are_in_the_results(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"one")
    units, _ = planned_units([tmp_path / "a.blend"], (0, 1))
    folder = BatchFolder(tmp_path / "out")
    done = {"trials": [{"estimator": "lattice"}], "cost": {"elapsed_s": 1.0}, "render_s": 0.5, "step_ms": [1.0]}
    write_json(result_file(folder.of_unit(units[1])), done)
    content = batch_results(folder, SETTINGS, units, {"b.blend": "gone"})
    assert [(t["scene"], t["seed"], t["number"]) for t in content["trials"]] == [("a", 1, 0)]
    assert content["failed"] == [{"what": "b.blend", "reason": "gone"}] and content["units"][0]["elapsed_s"] == 1.0


def test_tables_hold_a_row_per_trial_and_leave_empty_what_is_not_known(tmp_path):
    trials = batch(2)
    trials[0]["psnr"] = None
    write_tables(BatchFolder(tmp_path), results(trials))
    lines = (tmp_path / "trials.csv").read_text().splitlines()
    assert len(lines) == 1 + len(trials) and lines[0] == ",".join(TRIAL_COLUMNS)
    assert lines[1].split(",")[TRIAL_COLUMNS.index("psnr")] == ""
    assert len((tmp_path / "frames.csv").read_text().splitlines()) == 1 + 3 * len(trials)


def test_the_worst_frame_is_the_earliest_of_the_lowest_psnr():
    assert worst_frame({3: {"psnr": 5.0}, 2: {"psnr": 5.0}, 1: {"psnr": None}}) == 2
    assert worst_frame({1: {"psnr": None}}) is None and worst_frame({}) is None


def test_a_frontier_that_is_given_must_be_there(tmp_path):
    assert read_frontier(None, tmp_path) is None
    with pytest.raises(UserError, match="run xihe frontier"):
        read_frontier(tmp_path, tmp_path)
    (tmp_path / "frontier.json").write_text('{"points": []}')
    assert read_frontier(None, tmp_path) == read_frontier(tmp_path / "frontier.json", tmp_path) == {"points": []}


@pytest.mark.wheel_only("a whole Blender's Python has no Dask")
def test_a_worker_never_loads_blender():
    code = "import sys, xihe_blender.lab.workers.dask_worker; print({'bpy', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "set()"


def test_only_what_spreads_the_work_knows_dask():
    knows = [
        file.name
        for file in sorted((ROOT / "xihe_blender").rglob("*.py"))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        and any(name.split(".")[0] in ("dask", "distributed") for name in _names(node))
    ]
    assert set(knows) == {"dask_workers.py", "dask_worker.py"}


def _names(node):
    return [node.module or ""] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
