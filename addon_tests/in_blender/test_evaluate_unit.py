"""One scene and one seed of a batch: a room is rendered once, and a trial has the numbers of a run of its own."""

import contextlib
import io
import json
import shutil
import subprocess
from dataclasses import replace
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest
from previs_runs import N_FRAMES, counted_renders, files_below, run, survey, walk
from tiny_scenes import saved

from xihe_blender.apply.datablocks import LIT_SCENE
from xihe_blender.compare.methods import Comparison
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Progress, run_blocking
from xihe_blender.lab.batch.blender_process import write_result
from xihe_blender.lab.batch.grid import BatchSettings, planned_units
from xihe_blender.lab.batch.results import WORST_KINDS, BatchFolder, FilesRead, read_result, result_file, worst_picture
from xihe_blender.lab.batch.unit import FACTORS, _record_frame, estimates_per_minute, evaluate_unit, render_s, step_ms
from xihe_blender.lab.workers.dask_workers import EXIT_CANNOT_BE_DONE
from xihe_blender.lab.workers.processes import module_command
from xihe_blender.scene.blend_file import open_blend
from xihenet.io.json_files import read_json
from xihenet.trigger import RULES

pytestmark = pytest.mark.usefixtures("small_light_probes")
SMALL = BatchSettings(
    estimators=("projection", "truth"),
    phones=("perfect", "ipad_pro_lidar"),
    size=(24, 18),
    samples=1,
    frames=(1, 3, 4, 5),
    light="sh+key+reflections",
)
FEWER = replace(SMALL, estimators=("projection",), frames=(1, 4), light="sh")
"""For what happens while a unit is made."""

SEED = 1


def test_every_rule_of_a_run_can_be_a_batchs():
    for rule, trigger in RULES.items():
        assert replace(SMALL, trigger=rule).of_trial("perfect", "projection", SEED).trigger == trigger


def test_frames_that_only_one_of_the_phones_captures_count_among_what_was_rendered():
    slow, fast = ([SimpleNamespace(render_s=s) for s in seconds] for seconds in ((2.0, 0.0), (2.0, 3.0)))
    assert render_s([SimpleNamespace(frames=slow), SimpleNamespace(frames=fast)]) == 5.0


@pytest.mark.parametrize("is_during", [False, True])
def test_a_phone_whose_file_changes_during_a_batch_is_refused(tmp_path, monkeypatch, is_during):
    profile, batch = tmp_path / "mine.toml", BatchFolder(tmp_path / "out")
    original = (resources.files("xihenet.phone") / "profiles" / "ipad_pro_lidar.toml").read_text()
    profile.write_text(original)
    settings = replace(FEWER, phones=(str(profile),))
    batch.manifest(settings).take()
    unit, begun = batch.path / "units" / "walk", []

    def edit():
        profile.write_text(original.replace("rate_hz = 60", "rate_hz = 30"))

    def evaluated(*_):
        begun.append(True)
        (unit / "work").mkdir(parents=True)
        edit()
        yield Progress(0, 1, "")

    monkeypatch.setattr("xihe_blender.lab.batch.unit.evaluate_unit", evaluated)
    if not is_during:
        edit()
    with pytest.raises(UserError, match="the file of a phone has changed since the batch began: put it back"):
        write_result(tmp_path / "walk.blend", SEED, unit, settings, io.StringIO())
    assert begun == [True] * is_during and not unit.exists()


def test_what_the_first_frame_sets_up_is_no_part_of_a_step():
    frames = [SimpleNamespace(active=True, stage_ms={"sample": ms}, probes=[None]) for ms in (900.0, 10.0, 12.0)]
    assert step_ms(SimpleNamespace(frames=frames)) == 12.0
    assert step_ms(SimpleNamespace(frames=[])) is None


def test_a_scene_that_was_saved_anew_in_the_meantime_is_refused(file, tmp_path):
    (unit,), _ = planned_units([file], [SEED])
    copy = tmp_path / "walk.blend"
    copy.write_bytes(file.read_bytes() + b" ")
    command = [*module_command("xihe_blender.lab.batch.blender_process"), str(copy), str(SEED), str(tmp_path / "unit")]
    settings = json.dumps(as_json(FEWER))
    ended = subprocess.run([*command, unit.content_sha256], input=settings, capture_output=True, text=True, check=False)
    assert ended.returncode == EXIT_CANNOT_BE_DONE and "has changed since the batch began" in ended.stderr
    assert not (tmp_path / "unit").exists()


def test_a_phone_that_gets_every_second_frame_of_the_path_is_asked_half_as_often():
    def rate(delivered):
        frames = [
            SimpleNamespace(time_s=k / 60, is_delivered=k in delivered, probes=[None] * (k in delivered))
            for k in range(9)
        ]
        return estimates_per_minute(SimpleNamespace(frames=frames), n_fired=len(delivered))

    assert rate(range(9)) == pytest.approx(60 * 60)
    assert rate(range(0, 9, 2)) == pytest.approx(60 * 30)


def test_the_pictures_of_a_trial_are_those_of_its_worst_frame(tmp_path):
    grey, done, kept = np.full((4, 6, 3), 0.2), {}, []
    for frame, light in ((1, 0.3), (2, 0.5), (4, 0.4), (3, 0.4)):
        compared = Comparison(grey, {"0": np.full_like(grey, light)}, np.ones((4, 6)), np.zeros((4, 6), bool), 0.0, {})
        done[frame] = _record_frame(tmp_path, {frame: {"0": {}}}, frame, compared, done)
        kept.append([worst_picture(tmp_path, 0, kind).read_bytes() for kind in WORST_KINDS])
    assert kept[0] != kept[1] == kept[2] == kept[3]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """The walk through the tiny room as a file of its own."""
    walk()
    return saved(tmp_path_factory.mktemp("saved") / "walk.blend")


@pytest.fixture(scope="module")
def whole(file, tmp_path_factory):
    """An undisturbed unit, and the names of the scenes that it rendered."""
    job = unit_of(file, tmp_path_factory.mktemp("whole"))
    next(job)  # Opens the file, which takes the handlers with it that count.
    with counted_renders() as renders:
        return run_blocking(job), renders


@pytest.fixture(scope="module")
def fewer(file, tmp_path_factory):
    """An undisturbed unit of `FEWER`."""
    return run_blocking(unit_of(file, tmp_path_factory.mktemp("fewer"), FEWER))


def unit_of(file, folder, settings=SMALL):
    return evaluate_unit(file, folder, settings, SEED)


def trial_of(unit, phone, estimator):
    return next(trial for trial in unit.trials if (trial.phone, trial.estimator) == (phone, estimator))


def renders_of_the_room(renders):
    """In any order: a unit has all captures before the first light probe."""
    return sorted(name for name in renders if name not in (LIT_SCENE, "Xihe Effects"))


@pytest.mark.slow
def test_a_trial_has_the_numbers_of_a_run_of_its_own_and_all_trials_render_no_more_of_the_room(tmp_path, whole, file):
    unit, of_unit = whole
    assert [(t.phone, t.estimator) for t in unit.trials] == SMALL.trials()
    trial = trial_of(unit, "ipad_pro_lidar", "projection")
    scene = open_blend(file)
    with counted_renders() as of_run:
        settings = replace(SMALL.of_trial("ipad_pro_lidar", "projection", 0), seed=SEED)
        alone = run(scene, tmp_path / "alone", settings)
    assert trial.n_estimates == alone["summary"]["n_estimates"]
    assert trial.shc_rmse == alone["summary"]["mean_shc_rmse"]
    assert trial.object_pixels == pytest.approx(alone["summary"]["object_pixels"])
    own = alone["comparison"]["projection"]
    assert {metric: getattr(trial, metric) for metric in own} == pytest.approx(own, rel=1e-5)
    assert renders_of_the_room(of_unit) == renders_of_the_room(of_run) and len(of_run) > N_FRAMES


@pytest.mark.slow
def test_a_unit_that_a_scheduler_finished_meanwhile_is_not_made_again(tmp_path, whole):
    write_json(result_file(tmp_path), as_json(whole[0]))
    (tmp_path / "work").mkdir()
    write_result(tmp_path / "gone.blend", SEED, tmp_path, SMALL, io.StringIO())
    assert read_result(tmp_path, tmp_path / "gone.blend") == whole[0] and (tmp_path / "work").is_dir()


@pytest.mark.slow
def test_a_unit_that_a_scheduler_finishes_while_it_is_made_again_is_done(tmp_path, fewer, file):
    class Shares(io.StringIO):
        def write(self, text):
            if list(tmp_path.rglob("compared_*.json")):
                write_json(result_file(tmp_path), as_json(fewer))
                shutil.rmtree(tmp_path / "work", ignore_errors=True)
            return super().write(text)

    write_result(file, SEED, tmp_path, FEWER, Shares())
    assert read_result(tmp_path, file) == fewer


@pytest.mark.slow
def test_a_unit_that_was_stopped_goes_on_and_comes_to_the_same(tmp_path, fewer, file):
    with contextlib.closing(unit_of(file, tmp_path, FEWER)) as job:
        while not list(tmp_path.rglob("compared_*.json")):
            next(job)
    there = files_below(tmp_path)
    assert run_blocking(unit_of(file, tmp_path, FEWER)).trials == fewer.trials
    captures = [name for name in there if "capture_" in name]
    assert captures and all(files_below(tmp_path)[name] == there[name] for name in captures)


@pytest.mark.parametrize(("read", "is_kept"), [(FilesRead(), True), (FilesRead(sha256="0f"), False)])
def test_renders_that_a_stopped_unit_made_from_other_files_go(tmp_path, file, read, is_kept):
    outputs = RunOutputs(tmp_path / "unit", "walk")
    write_json(outputs.settings, as_json(read))
    write_json(outputs.exposure, {})
    with contextlib.closing(unit_of(file, outputs.folder)) as job:
        survey(job)
    assert outputs.exposure.exists() == is_kept and from_json(FilesRead, read_json(outputs.settings)) == FilesRead()


@pytest.mark.slow
def test_truth_has_no_error_and_an_eager_trigger_never_asks_less_often(whole):
    truth, estimated = (trial_of(whole[0], "perfect", estimator) for estimator in ("truth", "projection"))
    assert truth.trigger_sweep == () and truth.frames[0].shc_rmse == 0
    rates = [one.per_minute for one in estimated.trigger_sweep]
    assert rates == sorted(rates, reverse=True) and rates[0] > rates[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "n_thetas", "theta", "fires"),
    [("every-frame", 1, 0.0, True), ("light", len(FACTORS), RULES["light"].light_theta, False)],
)
def test_trials_have_the_trigger_that_was_asked_for(tmp_path, file, rule, n_thetas, theta, fires):
    settings = replace(SMALL, trigger=rule, estimators=("projection",), phones=("perfect",), light="sh", samples=2)
    (trial,) = run_blocking(evaluate_unit(file, tmp_path, settings, SEED)).trials
    (own,) = (one for one in trial.trigger_sweep if one.factor == 1)
    assert (len(trial.trigger_sweep), own.theta) == (n_thetas, theta)
    assert all(frame.n_fired for frame in trial.frames) == fires
    assert own.per_minute == trial.estimates_per_minute
