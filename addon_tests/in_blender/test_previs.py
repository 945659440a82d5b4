"""The main job: what it leaves, that it repeats itself, that it goes on after a stop, what it refuses."""

import hashlib
import json
import math
import shutil
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from previs_runs import (
    LOOKS_AWAY,
    N_FRAMES,
    SMALL,
    counted_renders,
    files_below,
    look_away,
    run,
    run_some_steps,
    unfinished_files,
    walk,
    with_renders_of,
)
from results_schema import read_strictly, without_times
from tiny_scenes import room_with_a_virtual_sphere, sphere

from xihe_blender.cli.previs import format_summary
from xihe_blender.errors import UserError
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.kept_files import DAMAGED, kept_record
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import ComparedFrame
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.compare_path import LIT_BY, OBJECTS, kept_comparison
from xihe_blender.previs.kept_session import OF_CHAIN, open_kept_session
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.prepare import PreparedRun, positive_exposure, prepare_run, survey_run
from xihe_blender.previs.previs import previs
from xihe_blender.previs.results import AS_SET
from xihe_blender.previs.settings import load_estimators
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet import estimators
from xihenet.formats import format_number


def entries(results):
    return {entry["frame"]: entry for entry in results["frames"]}


def test_the_walk_has_all_that_the_tests_look_at(finished):
    probes = [probe for entry in finished.results["frames"] for probe in entry["probes"]]
    assert {probe["name"] for probe in probes} == {"Ball", "Board 1", "Board 2"}
    assert {probe["reason"] for probe in probes} >= {"first", "colour", "none"}
    assert {len(entry["probes"]) for entry in finished.results["frames"]} >= {0, 2, 3}


def test_results_are_those_on_disk_and_every_file_that_they_name_is_there(finished):
    assert finished.results == read_strictly(finished.outputs.results)
    named = [path for entry in finished.results["frames"] for path in entry.get("pictures", {}).values()]
    assert len(named) == len(set(named)) > 0
    assert all((finished.outputs.folder / path).stat().st_size > 0 for path in named)
    assert finished.outputs.report.exists() and finished.outputs.lit_blend.exists()
    compared = [frame for frame, entry in entries(finished.results).items() if "comparison" in entry]
    assert compared[0] == 1 and compared[-1] == N_FRAMES


def test_metrics_follow_from_the_files(finished):
    outputs, results = finished.outputs, finished.results
    compared = [frame for frame in results["frames"] if frame.get("comparison")]
    for frame in compared:
        names = ("objects", "ground_truth", *frame["comparison"])
        share, true, *pictures = (read_radiance(outputs.radiance(name, frame["frame"])).astype(float) for name in names)
        assert share[..., 0].sum() == pytest.approx(frame["object_pixels"])
        for metrics, picture in zip(frame["comparison"].values(), pictures, strict=True):
            off = (picture - true) * results["settings"]["reference_exposure"]
            assert np.sqrt((share * off**2).sum() / share.sum()) == pytest.approx(metrics["rmse"], rel=1e-4)
    assert compared


def test_the_clamp_of_indirect_light_is_told_beside_white(finished):
    white = format_number(10 * finished.results["settings"]["reference_exposure"], 2)
    (said,) = (effect["reason"] for effect in finished.results["effects"] if effect["name"] == "indirect clamp")
    assert said == f"as the scene has it: 10, {white} times white at this exposure"


def test_a_frame_took_the_time_of_its_capture_and_of_its_reference_lights(finished):
    work = finished.outputs.folder / "work"
    for frame in (entry for entry in finished.results["frames"] if entry["captured"]):
        files = [*work.glob(f"times_{frame['frame']:04d}.json"), *work.glob(f"reference_*_{frame['frame']:04d}.json")]
        assert len(files) == 1 + len(frame["probes"])
        assert frame["render_s"] == pytest.approx(sum(read_strictly(file)["render_s"] for file in files))


@pytest.mark.slow
def test_another_estimator_beside_the_chosen_one_says_and_shows_what_it_does_when_it_is_chosen(finished, tmp_path):
    settings = replace(SMALL, estimator="projection", others=("lattice", "ambient", "projection"))
    beside = run(walk(), with_renders_of(finished.outputs.folder, tmp_path), settings)
    assert beside["settings"]["others"] == ["lattice"]
    assert list(beside["comparison"]) == ["projection", "lattice", "ambient", "truth"]
    for chosen, entry in zip(finished.results["frames"], beside["frames"], strict=True):
        for alone, probe in zip(chosen["probes"], entry["probes"], strict=True):
            assert probe["others"]["lattice"] == {name: alone[name] for name in ("sh", "shc_rmse")}
            assert probe["sh"] != alone["sh"] and alone["others"] == {}
        for kind in ("lattice", "ambient"):
            if path := chosen.get("pictures", {}).get(kind):
                assert (tmp_path / path).read_bytes() == (finished.outputs.folder / path).read_bytes()
    assert beside["comparison"]["lattice"] == finished.results["comparison"]["lattice"]
    mean = finished.results["summary"]["mean_shc_rmse"]
    assert beside["summary"]["others_shc_rmse"] == {"lattice": mean}
    times_ms = beside["summary"]["estimate_ms"]
    assert list(times_ms) == ["projection", "lattice"] and min(times_ms.values()) > 0
    assert f"{mean:.2f}"[:3] in RunOutputs(tmp_path, "untitled").report.read_text(encoding="utf-8")


def test_an_unknown_estimator_beside_the_chosen_one_is_refused():
    with pytest.raises(UserError, match="there is no estimator 'magic'"):
        replace(SMALL, others=("projection", "magic"))


def test_a_frame_without_a_position_in_view_is_captured_for_what_the_room_shows_there(finished):
    entry = entries(finished.results)[LOOKS_AWAY]
    assert entry["captured"] and entry["render_s"] > 0 and entry["stage_ms"]
    assert not entry["active"] and "comparison" not in entry
    # Three of them for metering, three for the pilot that chooses the number of samples.
    assert finished.renders.count("Xihe Capture") == 3 + 3 + N_FRAMES
    said = "1 frame had no estimation position in view and was captured for what the room shows there, in "
    assert any(note.startswith(said) for note in finished.results["notes"])
    assert said in finished.outputs.report.read_text(encoding="utf-8")
    summary = finished.results["summary"]
    assert (summary["n_captured_frames"], summary["n_active_frames"]) == (N_FRAMES, N_FRAMES - 1)


@pytest.mark.slow
def test_it_is_not_captured_where_only_what_is_in_view_is_wanted_and_nothing_is_learned_from_it(finished, tmp_path):
    results = run(walk(), tmp_path, replace(SMALL, captured="in-view"))
    entry = entries(results)[LOOKS_AWAY]
    assert not entry["captured"] and entry["render_s"] == 0
    assert not any(f"_{LOOKS_AWAY:04d}." in path for path in files_below(tmp_path))
    assert "1 frame had no estimation position in view and was not captured." in results["notes"]
    before, after = range(1, LOOKS_AWAY), LOOKS_AWAY + 1
    whole = entries(finished.results)
    assert [entries(results)[k]["probes"] for k in before] == [whole[k]["probes"] for k in before]
    pairs = list(zip(whole[after]["probes"], entries(results)[after]["probes"], strict=True))
    assert all(learned["coverage"] >= alone["coverage"] for learned, alone in pairs)
    assert any(learned["coverage"] > alone["coverage"] for learned, alone in pairs)


def test_the_session_of_a_run_gives_its_light_again_without_a_render(finished):
    with counted_renders() as renders:
        session = run_blocking(open_kept_session(finished.outputs.folder))
        probes = [probe for entry in finished.results["frames"] for probe in entry["probes"]]
        found = run_blocking(session.find_light({p["name"]: np.array(p["position_m"]) for p in probes}))
    assert renders == []
    for frame, entry in entries(finished.results).items():
        for probe in entry["probes"]:
            light = found[probe["name"]]
            assert np.array_equal(light.sh[frame], probe["sh"]) and light.coverage[frame] == probe["coverage"]
            assert light.expected_error[frame] == probe["expected_error"] and light.was_in_view


def test_every_setting_of_a_run_decides_its_light_again_or_is_known_not_to():
    """What was seen is kept, so that what decided it matters no more; `trigger` and `following` are records."""
    of_what_was_seen = {"effect_choices", "frames", "metering", "noise_target", "phone", "preset", "samples", "size"}
    of_others, as_records = {"backend", "others"}, {"following", "trigger"}
    assert {*OF_CHAIN} | of_what_was_seen | of_others | as_records == AS_SET


def test_a_network_that_the_run_left_out_delays_nothing_in_its_session(finished, tmp_path):
    shutil.copytree(finished.outputs.folder, tmp_path, dirs_exist_ok=True)
    results = json.loads((tmp_path / "results.json").read_text())
    assert ("network", "off") in [(effect["name"], effect["state"]) for effect in results["effects"]]
    results["settings"]["network"] = "lte"
    (tmp_path / "results.json").write_text(json.dumps(results))
    entry = finished.results["frames"][0]
    first = entry["probes"][0]
    session = run_blocking(open_kept_session(str(tmp_path)))
    found = run_blocking(session.find_light({"it": np.array(first["position_m"])}))
    assert np.array_equal(found["it"].sh[entry["frame"]], first["sh"])


@pytest.mark.slow
def test_the_session_gives_the_light_that_a_run_finds_with_the_object_elsewhere(finished, tmp_path):
    scene = walk()
    ball, board = (virtual_collection(scene).objects[name] for name in ("Ball", "Board"))
    ball.location = (0.5, 0.4, 1.1)
    board.hide_render = True
    settings = replace(SMALL, exposure=finished.results["settings"]["reference_exposure"])
    elsewhere = run(scene, tmp_path, settings)
    place = np.array(elsewhere["frames"][0]["probes"][0]["position_m"])
    session = run_blocking(open_kept_session(finished.outputs.folder))
    found = run_blocking(session.find_light({"Ball": place}))["Ball"]
    for frame, entry in entries(elsewhere).items():
        for probe in entry["probes"]:
            if probe["name"] == "Ball":
                np.testing.assert_allclose(found.sh[frame], probe["sh"], rtol=0, atol=1e-6)


def test_what_the_phone_saw_and_is_gone_is_told_and_the_capture_not_taken_in_its_place(finished, tmp_path):
    shutil.copytree(finished.outputs.folder, tmp_path, dirs_exist_ok=True)
    outputs, content = RunOutputs(tmp_path), json.loads((tmp_path / "session.json").read_text())
    name = outputs.relative(outputs.seen(2))
    shutil.copy(outputs.capture(2), outputs.seen(2))
    content["files"][content["files"].index(outputs.relative(outputs.capture(2)))] = name
    (tmp_path / "session.json").write_text(json.dumps(content))
    assert run_blocking(open_kept_session(tmp_path)).frames
    outputs.seen(2).unlink()
    with pytest.raises(UserError, match=f"gone or damaged .there is no {name}.: run again"):
        run_blocking(open_kept_session(tmp_path))


def test_captures_that_are_gone_are_told(finished, tmp_path):
    shutil.copytree(finished.outputs.folder, tmp_path, dirs_exist_ok=True)
    RunOutputs(tmp_path).capture(2).write_bytes(b"cut short")
    with pytest.raises(UserError, match=r"the captures of the last run are gone or damaged .*: run again"):
        run_blocking(open_kept_session(tmp_path))


@pytest.mark.slow
def test_a_ball_of_a_few_pixels_is_said_to_be_too_small_to_judge_by(tmp_path):
    scene = room_with_a_virtual_sphere(1)
    results = run(scene, tmp_path / "out")
    (frame,), focal_px = results["frames"], 16 / math.tan(scene.camera.data.angle_x / 2)
    away_m = math.dist(scene.camera.location, bpy.data.objects["Ball"].location)
    # The disc that a sphere of 12 cm covers in the middle of a picture of 32 pixels across.
    disc = math.pi * focal_px**2 * 0.12**2 / (away_m**2 - 0.12**2)
    assert disc * 0.85 < frame["object_pixels"] < disc * 1.1
    assert results["summary"]["object_pixels"] == frame["object_pixels"]
    said = f"the virtual objects cover only {round(frame['object_pixels'])} pixels of a picture, too few to judge by"
    assert any(said[1:] in note for note in results["notes"])
    assert [said[1:] in warning for warning in results["warnings"]] == [True]
    assert said in format_summary(results) and said in (tmp_path / "out" / "report.html").read_text("utf-8")


def run_first_frame(finished, scene, folder, **changes):
    """The results of frame 1 alone, at the exposure and with the samples of the finished run."""
    outputs = RunOutputs(folder, "untitled")
    outputs.exposure.parent.mkdir()
    for name in ("exposure", "sample_count"):
        shutil.copy(getattr(finished.outputs, name), getattr(outputs, name))
    return entries(run(scene, folder, replace(SMALL, frames=(1,), **changes)))[1]["probes"]


@pytest.mark.slow
def test_another_seed_gives_another(finished, tmp_path):
    other = run_first_frame(finished, walk(), tmp_path, seed=1)
    for light in ("sh", "sh_truth"):
        assert entries(finished.results)[1]["probes"][0][light] != other[0][light]


@pytest.mark.slow
def test_a_run_stopped_at_every_step_ends_as_an_undisturbed_one(finished, tmp_path):
    out, scene, n_stops = tmp_path / "out", walk(), 0
    with counted_renders() as renders:
        # One step further at every start: what is done takes a step too, but no rendering.
        while not run_some_steps(scene, out, n_stops + 2):
            n_stops += 1
            assert not (out / "results.json").exists()
            assert not unfinished_files(out)
        results = run(scene, out)
    assert n_stops >= N_FRAMES
    assert without_times(results) == without_times(finished.results)
    assert sorted(renders) == sorted(finished.renders)


def run_again(outputs):
    """The results of one more run into a folder, and what it rendered."""
    scene = walk()
    with counted_renders() as renders:
        results = run(scene, outputs.folder)
    return results, Counter(renders)


@pytest.fixture
def copied(finished, tmp_path):
    """The finished run's files in a folder of their own."""
    shutil.copytree(finished.outputs.folder, tmp_path / "out")
    return RunOutputs(tmp_path / "out", "untitled")


def cut_short(file):
    file.write_bytes(file.read_bytes()[:-100])


@pytest.mark.parametrize("damage", [lambda o: cut_short(o.results), lambda o: o.report.unlink()])
def test_what_a_finished_run_has_lost_is_made_again_without_rendering(finished, copied, damage):
    damage(copied)
    again, renders = run_again(copied)
    assert not renders and copied.report.exists()
    assert without_times(again) == without_times(finished.results) == without_times(read_strictly(copied.results))


@pytest.mark.parametrize("exposure", [0, -1.0, float("nan"), float("inf"), "bright", [1.0]])
def test_a_kept_exposure_is_a_positive_number(exposure):
    assert positive_exposure({"exposure": 0.5}) == 0.5
    with pytest.raises(DAMAGED):
        positive_exposure({"exposure": exposure})


@pytest.mark.slow
def test_every_json_of_a_run_that_is_damaged_is_made_again(finished, copied, caplog):
    damaged = {copied.results, *copied.settings.parent.glob("*.json")} - {copied.settings}
    assert len(damaged) > 4 + 3 * (N_FRAMES - 1)
    for path in damaged:
        path.write_bytes(b'{"frames": [{}]}')
    again, _ = run_again(copied)
    assert without_times(again) == without_times(finished.results) == without_times(read_strictly(copied.results))
    told = (copied.results, copied.survey, copied.exposure, copied.effects, copied.sample_count, copied.times(1))
    assert {f"{path} is damaged and is made again" for path in told} <= set(caplog.messages)


def test_damaged_pieces_of_frames_cost_those_pieces_alone(finished, copied):
    copied.results.unlink()
    for file in (copied.capture(1), copied.reference(0, "Ball", 1), copied.compared(5)):
        cut_short(file)
    again, renders = run_again(copied)
    assert without_times(again) == without_times(finished.results)
    # All pictures of one light, which is one of five.
    assert 0 < renders.pop("Xihe Reference Probe") == finished.renders.count("Xihe Reference Probe") / 5
    # The board has two positions, and is lit at each.
    assert renders == {"Xihe Capture": 1, "Xihe Ground Truth": 1, "Xihe Lit": 2}


def test_panoramas_of_the_reference_light_that_are_gone_or_damaged_are_made_again(finished, copied):
    copied.results.unlink()
    rendered, taken_over = copied.probe(0, "Ball", 1), copied.probe(0, "Ball", 2)
    cut_short(rendered)
    taken_over.unlink()
    again, renders = run_again(copied)
    assert without_times(again) == without_times(finished.results)
    assert renders == {"Xihe Reference Probe": finished.renders.count("Xihe Reference Probe") / 5}
    assert np.array_equal(read_radiance(rendered), read_radiance(taken_over))


def test_comparisons_of_other_lights_than_an_edge_service_gives_after_a_stop_are_made_again(finished, copied):
    copied.results.unlink()
    for frame, change in ((1, 0.01), (5, 2e-5)):  # Another computer rounds differently.
        kept = json.loads(copied.compared(frame).read_text())
        kept["comparison"]["lattice"]["rmse"] += 9.0 * (frame == 1)
        kept[LIT_BY]["lattice Ball"][0][0] += change
        copied.compared(frame).write_text(json.dumps(kept))
    again, renders = run_again(copied)
    assert without_times(again) == without_times(finished.results)
    assert renders == {"Xihe Ground Truth": 1, "Xihe Lit": 2}


def test_a_comparison_is_made_again_where_its_radiance_is_gone_or_of_before_it_had_the_share_of_objects(copied):
    assert kept_comparison(copied, 1) == kept_record(ComparedFrame, copied.compared(1)) is not None
    copied.radiance(OBJECTS, 1).unlink()
    assert kept_comparison(copied, 1) is None


@pytest.mark.parametrize(
    "change",
    [
        *({"seed": 1}, {"preset": "balanced"}, {"estimator": "ambient"}, {"frames": (1, 2)}, {"exposure": 2.0}),
        *({"phone": "iphone_lidar"}, {"network": "lte"}, {"effect_choices": {"volumes": "on"}}),
    ],
)
def test_a_folder_of_another_run_is_refused(finished, change):
    before = files_below(finished.outputs.folder)
    with pytest.raises(UserError, match="another folder"):
        run(walk(), finished.outputs.folder, replace(SMALL, **change))
    assert files_below(finished.outputs.folder) == before


def test_a_run_of_before_presets_had_words_is_taken_up(finished):
    numbers = {"noise_target", "max_samples", "min_samples", "probe_samples", "comparison_samples", "comparison_step"}
    assert json.loads(finished.outputs.settings.read_text("utf-8"))["preset"].keys() == numbers


def test_a_run_of_the_same_estimator_with_other_weights_is_refused(copied):
    made = json.loads(copied.settings.read_text("utf-8"))
    shipped = Path(estimators.__file__).parents[1] / "weights" / "lattice_hdr.npz"
    assert made["weights"] == {"lattice": hashlib.sha256(shipped.read_bytes()).hexdigest()}
    copied.settings.write_text(json.dumps(made | {"weights": {"lattice": "of another training"}}), "utf-8")
    with pytest.raises(UserError, match="another training"):
        run(walk(), copied.folder)


@pytest.mark.parametrize("name", ["results.json", "report.html", "untitled_lit.blend"])
def test_a_file_of_the_users_is_not_written_over(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(UserError, match="another folder"):
        run(walk(), tmp_path)
    assert files_below(tmp_path).keys() == {name}
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.slow
def test_what_a_window_waits_between_two_pictures_of_the_light_is_no_work_of_a_frame(monkeypatch, tmp_path):
    waited, clock = [], time.perf_counter
    monkeypatch.setattr(time, "perf_counter", lambda: clock() + 1000 * len(waited))
    settings = replace(SMALL, frames=(1,), estimator="ambient")
    job = previs(room_with_a_virtual_sphere(1), tmp_path, settings)
    results = run_blocking(job, lambda *_: waited.append(1))
    assert results["frames"][0]["work_s"] < 1000 < 1000 * len(waited)


def test_a_path_that_never_sees_a_position_gives_results_and_a_report(tmp_path):
    scene = room_with_a_virtual_sphere(2)
    for frame in (1, 2):
        look_away(scene.camera, frame)
    results = run(scene, tmp_path)
    assert results["summary"]["n_active_frames"] == 0 and results["comparison"] == {}
    assert results["summary"]["n_captured_frames"] == 2
    assert "No virtual object was in view" in results["warnings"][0] and "no virtual object" in format_summary(results)
    assert "2 frames had no estimation position in view" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_an_object_that_is_never_in_view_changes_nothing_for_the_others(finished, tmp_path):
    scene = walk()
    sphere(scene, "Unseen", (0, -1.9, 2.9), 0.05, None, virtual_collection(scene))
    assert run_first_frame(finished, scene, tmp_path) == entries(finished.results)[1]["probes"]


def test_following_is_said_and_can_be_switched_off(finished):
    """The lamp of the walk falls to a sixth while the phone looks away."""
    results = finished.results
    when = {entry["frame"] for entry in results["frames"] if any(p["n_followed_anchors"] for p in entry["probes"])}
    assert when == {LOOKS_AWAY + 1}
    assert any(f"At frame {LOOKS_AWAY + 1} the light in view changed as a whole" in n for n in results["notes"])
    assert results["settings"]["following"]["smallest_stops"] == SMALL.chain(1.0).following.smallest_stops == 0.5
    assert replace(SMALL, following=None).chain(1.0).following is None


def test_how_far_a_run_is_is_said_without_another_look_at_all_of_its_frames(tmp_path, monkeypatch):
    """A run of 2,000 frames with 60 positions says so 120,000 times, and such a look took 40 ms."""
    scene, outputs = room_with_a_virtual_sphere(4), RunOutputs(tmp_path, "room")
    settings = replace(SMALL, frames=None, size=(32, 24), samples=2, exposure=1.0)
    plan = plan_previs(scene, settings)
    survey = run_blocking(survey_run(scene, plan, outputs))
    run = run_blocking(prepare_run(scene, plan, survey, outputs, settings, load_estimators(settings)))
    looked, in_view = [], PreparedRun.probes_in_view
    monkeypatch.setattr(PreparedRun, "probes_in_view", lambda of, frame: looked.append(frame) or in_view(of, frame))
    done = [run.progress(stage, k / 10, "at work").done for stage in ("capture", "methods") for k in range(10)]
    assert done == sorted(done) and len(set(done)) == len(done)
    assert sorted(looked) == list(plan.frames)


def test_the_chain_can_be_stopped_at_each_of_its_frames_and_says_where_it_is(finished, tmp_path):
    outputs = RunOutputs(shutil.copytree(finished.outputs.folder, tmp_path / "out"), finished.outputs.scene)
    outputs.results.unlink()
    said = [progress for progress in previs(walk(), outputs.folder, SMALL) if "estimating" in progress.doing]
    assert [one.doing for one in said] == [f"estimating the light from frame {k}" for k in range(1, N_FRAMES + 1)]
    assert len({one.done for one in said}) == 1
