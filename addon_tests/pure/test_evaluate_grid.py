"""Which trials make up a batch, and whose folder it is."""

import contextlib
import json
import sys
from dataclasses import fields, replace
from importlib import resources
from types import SimpleNamespace

import pytest
from jsonschema import Draft202012Validator

from addon_tests.pure.batches import batch, frontier, results, trial
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import contents_sha256
from xihe_blender.io.json_records import as_json, from_json, json_schema
from xihe_blender.io.outputs import write_json
from xihe_blender.io.run_results import METRICS, Metrics
from xihe_blender.jobs import Progress, run_blocking
from xihe_blender.lab.batch import batch as batch_module
from xihe_blender.lab.batch.batch import evaluate_batch
from xihe_blender.lab.batch.grid import BatchSettings, planned_units
from xihe_blender.lab.batch.results import (
    TRIAL_COLUMNS,
    BatchFolder,
    BatchManifest,
    BatchResults,
    FilesRead,
    TrialFigures,
    UnitCost,
    UnitResult,
    batch_results,
    batch_schema,
    read_frontier,
    read_result,
    result_file,
    worst_frame,
)
from xihenet import __version__

SETTINGS = BatchSettings(estimators=("lattice", "ambient"), phones=("perfect", "ipad_pro_lidar"), frames=(1, 2))
NOTHING_DONE = UnitResult(
    trials=(),
    step_ms=(),
    render_s=0.5,
    cost=UnitCost(elapsed_s=1.0, processor_s=1.0, peak_memory_mb=None, written_bytes=1),
)


def figures(one):
    """Of a trial, what its unit's file holds."""
    return TrialFigures(**{part.name: getattr(one, part.name) for part in fields(TrialFigures)})


def test_every_phone_meets_every_estimator_once():
    trials = SETTINGS.trials()
    assert len(set(trials)) == len(trials) == 4 and trials[0] == ("perfect", "lattice")


@pytest.mark.parametrize("wrong", [{"estimators": ()}, {"phones": ("perfect", "perfect")}])
def test_names_are_given_once(wrong):
    with pytest.raises(UserError, match="once"):
        replace(SETTINGS, **wrong)


def test_a_scene_that_cannot_be_read_does_not_stop_the_others(tmp_path):
    (tmp_path / "a.blend").write_bytes(b"one")
    (tmp_path / "b.blend").write_bytes(b"two")
    scenes = [tmp_path / name for name in ("a.blend", "none.blend", "b.blend")]
    units, broken = planned_units(scenes, (0, 1))
    assert [(unit.scene.name, unit.seed) for unit in units] == [(n, s) for n in ("a.blend", "b.blend") for s in (0, 1)]
    assert list(broken) == [str(tmp_path / "none.blend")]


def test_the_same_scene_twice_is_one_unit_and_another_of_its_name_is_not(tmp_path):
    for folder, content in (("a", b"one"), ("b", b"two")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "room.blend").write_bytes(content)
    files = [tmp_path / "a" / "room.blend", tmp_path / "b" / "room.blend"]
    units, _ = planned_units([*files, files[0]], (0,))
    assert len({unit.name for unit in units}) == len(units) == 2
    files[1].write_bytes(files[0].read_bytes())
    copies, _ = planned_units(files, (0,))
    assert [unit.scene for unit in copies] == files  # What they read beside them may differ.
    assert planned_units(files[:1], (0,))[0] == copies[:1]  # A copy that is added leaves what is done.


def test_a_folder_goes_on_with_the_same_settings_alone(tmp_path):
    folder = BatchFolder(tmp_path / "out")
    assert not folder.manifest(SETTINGS).take() and folder.manifest(SETTINGS).take()
    with pytest.raises(UserError, match="another size"):
        folder.manifest(replace(SETTINGS, size=(32, 24))).take()
    content = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert content["xihe"] == __version__
    assert from_json(BatchManifest, content).settings == SETTINGS
    Draft202012Validator(json_schema(BatchManifest)).validate(content)
    content["weights"][SETTINGS.estimators[0]] = "of another training"
    (tmp_path / "out" / "batch.json").write_text(json.dumps(content))
    with pytest.raises(UserError, match="another training of its networks or code of an estimator: choose"):
        folder.manifest(SETTINGS).take()
    (tmp_path / "out" / "batch.json").write_text(json.dumps(content | {"blender": "4.1"}))
    with pytest.raises(UserError, match="another version of Blender"):
        folder.manifest(SETTINGS).take()


def test_a_batch_in_a_whole_blender_knows_its_version(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(app=SimpleNamespace(version=(4, 3, 2))))
    folder = BatchFolder(tmp_path / "out")
    folder.manifest(SETTINGS).take()
    assert json.loads((tmp_path / "out" / "batch.json").read_text())["blender"] == "4.3.2"


def test_a_folder_in_which_all_was_refused_is_free_for_any_batch(tmp_path):
    folder, other = BatchFolder(tmp_path), replace(SETTINGS, size=(32, 24))
    folder.manifest(SETTINGS).take()
    refused = batch_results(folder, SETTINGS, (), {"room.blend (seed 0)": "has no frame 9"})
    folder.write_tables(refused)
    rendered = folder.path / "units" / "room_seed0" / "work" / "renders.npz"
    rendered.parent.mkdir(parents=True)
    rendered.touch()
    folder.forget_what_made_nothing()
    with pytest.raises(UserError, match="another size"):
        folder.manifest(other).take()
    rendered.unlink()
    folder.forget_what_made_nothing()
    assert not folder.manifest(other).take()
    folder.forget_what_made_nothing()
    assert folder.manifest(other).take()


def test_a_batch_begins_anew_where_all_of_the_last_one_was_refused(tmp_path):
    for settings in (SETTINGS, replace(SETTINGS, size=(32, 24))):
        options = {"n_workers": 1, "scheduler": None, "frontier": None}
        found, _ = run_blocking(evaluate_batch([tmp_path / "none.blend"], tmp_path / "out", settings, (0,), **options))
        assert found.failed and found.settings == settings


def test_a_unit_whose_files_have_changed_in_the_meantime_is_named(tmp_path, monkeypatch):
    (tmp_path / "a.blend").write_bytes(b"one")
    folder = BatchFolder(tmp_path / "out")

    def run(work, _noun):
        done = replace(NOTHING_DONE, read=FilesRead(patterns=("*.png",), sha256="of a picture that is gone"))
        for one in work:
            write_json(result_file(folder.path / "units" / one.name), as_json(done))
            yield Progress(1, 1, one.name)

    workers = SimpleNamespace(failed={}, check_workers=lambda *_: None, run=run)
    monkeypatch.setattr(batch_module, "open_dask_workers", lambda *_: contextlib.nullcontext(workers))
    monkeypatch.setattr(batch_module, "dashboard", lambda _: "no dashboard")
    options = {"n_workers": 1, "scheduler": None, "frontier": None}
    found, n_done = run_blocking(evaluate_batch([tmp_path / "a.blend"], folder.path, SETTINGS, (0,), **options))
    assert n_done == 0 and [one.reason for one in found.failed] == [batch_module.OF_OTHER_FILES]


@pytest.mark.parametrize("name", ["results.json", "report.html"])
def test_a_folder_of_something_else_is_refused(tmp_path, name):
    (tmp_path / name).write_text("{}")
    with pytest.raises(UserError, match="not from a batch"):
        BatchFolder(tmp_path).manifest(SETTINGS).take()


def test_only_units_that_are_done_and_not_damaged_are_in_the_results(tmp_path, caplog):
    (tmp_path / "a.blend").write_bytes(b"one")
    units, _ = planned_units([tmp_path / "a.blend"], (0, 1))
    folder = BatchFolder(tmp_path / "out")
    done = replace(NOTHING_DONE, trials=(figures(trial()),), step_ms=(None,))
    write_json(result_file(folder.of_unit(units[1])), as_json(done))
    assert folder.result(units[0]) is None and folder.result(units[1]) == done
    found = batch_results(folder, SETTINGS, units, {"b.blend": "gone"})
    assert [(t.scene, t.seed, t.number, t.shc_rmse) for t in found.trials] == [("a", 1, 0, 0.1)]
    assert as_json(found.failed) == [{"what": "b.blend", "reason": "gone"}] and found.units[0].elapsed_s == 1.0
    for damage in ("", '{"tri', '{"trials": []}', "[]", "null", json.dumps(as_json(done) | {"trials": 1})):
        caplog.clear()
        path = result_file(folder.of_unit(units[1]))
        path.write_text(damage)
        assert folder.result(units[1]) is None
        assert caplog.messages == [f"{path} is damaged and is made again"]


def test_a_unit_is_not_done_any_more_where_a_file_that_its_scene_reads_has_changed(tmp_path):
    (tmp_path / "fog.vdb").write_bytes(b"one")
    patterns = (str(tmp_path / "*.vdb"),)
    read = FilesRead(patterns=patterns, sha256=contents_sha256(patterns))
    done = replace(NOTHING_DONE, read=read)
    write_json(result_file(tmp_path), as_json(done))
    scene = tmp_path / "room.blend"
    assert read_result(tmp_path, scene) == done
    (tmp_path / "fog.vdb").write_bytes(b"and more")
    assert read_result(tmp_path, scene) is None


def test_a_batch_that_was_moved_with_its_scenes_and_phones_has_all_units_and_names(tmp_path):
    def in_folder(folder):
        scenes = [folder / "day" / "room.blend", folder / "night" / "room.blend"]
        phones = ("perfect", str(folder / "cheap.toml"))
        settings = replace(SETTINGS, estimators=("lattice",), phones=phones)
        return BatchFolder(folder / "out"), planned_units(scenes, (0, 1))[0], settings

    before, after = tmp_path / "before", tmp_path / "after"
    for time in ("day", "night"):
        (before / time).mkdir(parents=True)
        (before / time / "room.blend").write_bytes(b"the same")
        (before / time / "sky.exr").write_bytes(time.encode())
    profile = resources.files("xihenet.phone") / "profiles" / "ipad_pro_lidar.toml"
    (before / "cheap.toml").write_text(profile.read_text().replace("ipad_pro_lidar", "cheap"))
    folder, units, settings = in_folder(before)
    folder.manifest(settings).take()
    for unit in units:
        read = FilesRead(patterns=("sky.exr",), sha256=contents_sha256([str(unit.scene.with_name("sky.exr"))]))
        trials = tuple(figures(trial(phone=phone)) for phone in settings.phones)
        done = replace(NOTHING_DONE, trials=trials, step_ms=(None, None), read=read)
        write_json(result_file(folder.of_unit(unit)), as_json(done))
    found = batch_results(folder, settings, units, {})
    assert len(found.units) == 4 and {one.phone for one in found.trials} == {"perfect", "cheap"}
    before.rename(after)
    folder, units, settings = in_folder(after)
    assert folder.manifest(settings).take() and batch_results(folder, settings, units, {}) == found
    (after / "night" / "sky.exr").write_bytes(b"day")
    assert len(batch_results(folder, settings, units, {}).units) == 2


def test_scenes_of_one_name_are_told_apart_by_their_folders(tmp_path):
    files = [tmp_path / path for path in ("a/day/room.blend", "b/day/room.blend", "night/room.blend", "hall.blend")]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(file))
    units, _ = planned_units(files, (0, 1))
    folder = BatchFolder(tmp_path / "out")
    for unit in units:
        write_json(result_file(folder.of_unit(unit)), as_json(NOTHING_DONE))
    found = batch_results(folder, SETTINGS, units, {})
    names = ["a/day/room", "b/day/room", "night/room", "hall"]
    assert [(unit.scene, unit.seed) for unit in found.units] == [(name, seed) for name in names for seed in (0, 1)]


def test_a_batch_that_is_under_way_is_refused_before_any_worker_is_asked(tmp_path):
    (tmp_path / "room.blend").write_bytes(b"")
    options = {"n_workers": None, "scheduler": "nobody", "frontier": None}
    with BatchFolder(tmp_path).manifest(SETTINGS).held(), pytest.raises(UserError, match="a batch is under way"):
        next(evaluate_batch([tmp_path / "room.blend"], tmp_path, SETTINGS, (0,), **options))


def test_phones_of_the_users_own_go_by_their_files(tmp_path):
    (tmp_path / "hall.blend").write_text("hall")
    units, _ = planned_units([tmp_path / "hall.blend"], (0,))
    phones = ("perfect", "/study/cheap.toml", "/study/perfect.toml")
    folder, trials = BatchFolder(tmp_path / "out"), [figures(trial(phone=phone)) for phone in phones]
    write_json(result_file(folder.of_unit(units[0])), as_json(replace(NOTHING_DONE, trials=tuple(trials))))
    found = batch_results(folder, replace(SETTINGS, phones=phones), units, {})
    assert [one.phone for one in found.trials] == ["perfect", "cheap", "study/perfect"]


def test_tables_hold_a_row_per_trial_and_leave_empty_what_is_not_known(tmp_path):
    trials = [trial(psnr=None), *batch(2)]
    BatchFolder(tmp_path).write_tables(results(trials))
    lines = (tmp_path / "trials.csv").read_text().splitlines()
    assert len(lines) == 1 + len(trials) and lines[0] == ",".join(TRIAL_COLUMNS)
    assert lines[1].split(",")[TRIAL_COLUMNS.index("psnr")] == ""
    assert len((tmp_path / "frames.csv").read_text().splitlines()) == 1 + 3 * len(trials)
    content = json.loads((tmp_path / "results.json").read_text())
    Draft202012Validator(batch_schema()).validate(content)
    assert from_json(BatchResults, content) == results(trials)


def test_the_worst_frame_is_the_earliest_of_the_lowest_psnr():
    none = Metrics(**dict.fromkeys(METRICS))
    assert worst_frame({3: replace(none, psnr=5.0), 2: replace(none, psnr=5.0), 1: none}) == 2
    assert worst_frame({1: replace(none, psnr=6.0), 2: replace(none, psnr=5.0)}) == 2
    assert worst_frame({1: none}) is None and worst_frame({}) is None


def test_a_frontier_that_is_given_must_be_there(tmp_path):
    assert read_frontier(None, tmp_path) is None
    with pytest.raises(UserError, match="run xihe frontier"):
        read_frontier(tmp_path, tmp_path)
    for damage in ('{"points": []}', "", "[]", "null", '{"schema_version": 1'):
        (tmp_path / "frontier.json").write_text(damage)
        with pytest.raises(UserError, match="run xihe frontier"):
            read_frontier(tmp_path / "frontier.json", tmp_path)
        with pytest.raises(UserError, match=r"frontier\.json is damaged: run xihe frontier again, or delete it"):
            read_frontier(None, tmp_path)
    write_json(tmp_path / "frontier.json", as_json(frontier()))
    assert read_frontier(None, tmp_path) == read_frontier(tmp_path / "frontier.json", tmp_path) == frontier()
