"""A run with a phone that is not perfect: what it sees, which effects it plans, when its estimates arrive."""

import shutil
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from previs_runs import IPAD, SMALL, counted_renders, files_below, finished_run, run, walk, with_renders_of
from results_schema import without_times
from tiny_scenes import room_with_a_virtual_sphere

from xihe_blender.compare.side_by_side import read_picture
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import made_of, plan_previs
from xihe_blender.previs.settings import load_estimators
from xihe_blender.previs.simulated_phone import choose_phone, simulate_phone
from xihe_blender.previs.survey import survey_path
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import ControllerSettings, XiheController
from xihenet.estimators import EstimateContext
from xihenet.io.recording import load_frame
from xihenet.phone import EFFECTS, LINKS
from xihenet.phone.session import PhoneSession
from xihenet.records import UnitSphereCloud
from xihenet.trigger import RULES

FAST = replace(SMALL, estimator="projection", n_anchors=320)


@pytest.fixture(scope="module")
def over_lte(finished, tmp_path_factory):
    out = with_renders_of(finished.outputs.folder, tmp_path_factory.mktemp("lte") / "out")
    return finished_run(out, replace(SMALL, network="lte"))


def rows(results):
    return {effect["name"]: effect for effect in results["effects"]}


def steps(results):
    """(frame, probe) of every probe entry."""
    return [(entry, probe) for entry in results["frames"] for probe in entry["probes"]]


def test_a_perfect_phone_gives_what_the_plain_chain_gives(finished):
    """The reference is the controller alone, fed with the captures that the run kept."""
    estimator = load_estimators(SMALL)[0]
    exposure = finished.results["settings"]["reference_exposure"]
    settings = ControllerSettings(SMALL.trigger_in_use, reference_exposure=exposure, learns_out_of_view=True)
    chain = XiheController(LocalBackend(estimator), settings)
    for _, probe in steps(finished.results):
        if probe["name"] not in chain.positions:
            chain.add_position(probe["name"], probe["position_m"])
    ambient = estimators.load("ambient", SMALL.n_anchors, SMALL.target)
    for entry in finished.results["frames"]:
        frame = load_frame(finished.outputs.capture(entry["frame"]))
        reports = chain.step(frame)
        sensed = ambient.estimate(UnitSphereCloud.empty(SMALL.n_anchors), EstimateContext(frame=frame))
        for probe in entry["probes"]:
            light = chain.light(probe["name"])
            assert np.array_equal(probe["sh"], sensed if light is None else light.sh_radiance)
            assert probe["fired"] == reports[probe["name"]].decision.fire


def test_a_perfect_phone_costs_nothing(finished, ipad):
    # Even a phone with flaws renders nothing more.
    assert Counter(finished.renders) == Counter(ipad.renders)
    kept = files_below(finished.outputs.folder)
    assert not any("surfaces_" in path or path.startswith("radiance/captured") for path in kept)
    assert finished.results["phone"]["shc_rmse"] is None
    assert {rows(finished.results)[effect]["state"] for effect in (*EFFECTS, "network")} == {"off"}
    arrivals = [(entry["frame"], probe) for entry, probe in steps(finished.results) if probe["fired"]]
    assert all((probe["arrival_frame"], probe["latency_ms"]) == (frame, 0) for frame, probe in arrivals)


def test_the_phone_changes_the_light_and_leaves_the_captures_perfect(finished, ipad):
    for entry in finished.results["frames"]:
        if entry["active"]:
            frames = [load_frame(run.outputs.capture(entry["frame"])) for run in (finished, ipad)]
            assert np.array_equal(frames[0].plane_depth_m, frames[1].plane_depth_m)
            assert np.array_equal(frames[0].srgb_u8, frames[1].srgb_u8)
            shown = np.rint(255 * read_picture(ipad.outputs.picture("captured", entry["frame"])))
            assert np.array_equal(shown, load_frame(ipad.outputs.seen(entry["frame"])).srgb_u8)
            assert not np.array_equal(shown, frames[1].srgb_u8)
    lights = [[probe["sh"] for _, probe in steps(run.results)] for run in (finished, ipad)]
    assert not np.array_equal(*lights)
    assert [probe["sh_truth"] for _, probe in steps(finished.results)] == [
        probe["sh_truth"] for _, probe in steps(ipad.results)
    ]


@pytest.mark.slow
def test_the_errors_of_the_report_are_those_of_whole_sessions(finished, ipad, tmp_path):
    errors = ipad.results["phone"]["shc_rmse"]
    assert errors["all_on"] == ipad.results["summary"]["mean_shc_rmse"]
    assert errors["perfect"] == finished.results["summary"]["mean_shc_rmse"]
    quiet = run(
        walk(), with_renders_of(ipad.outputs.folder, tmp_path), replace(IPAD, effect_choices={"edge_bleeding": "off"})
    )
    assert quiet["summary"]["mean_shc_rmse"] == errors["without"]["edge_bleeding"] != errors["all_on"]
    text = ipad.outputs.report.read_text(encoding="utf-8")
    assert f"{errors['all_on']:.4f}" in text and f"{errors['without']['edge_bleeding']:.4f}" in text


def test_what_stands_beside_a_capture_is_made_again_where_it_is_damaged(ipad, tmp_path):
    shutil.copytree(ipad.outputs.folder, tmp_path / "out")
    outputs = RunOutputs(tmp_path / "out", "untitled")
    outputs.results.unlink()
    for piece in (outputs.surfaces(1), outputs.radiance("captured", 4)):
        piece.write_bytes(piece.read_bytes()[:300])
    scene = walk()
    with counted_renders() as renders:
        again = run(scene, outputs.folder, IPAD)
    assert without_times(again) == without_times(ipad.results)
    assert renders == ["Xihe Capture"] * 2


def test_another_seed_is_another_phone(ipad):
    settings = replace(IPAD, seed=1)
    frames = [load_frame(ipad.outputs.capture(1))] * 2
    scene = walk()
    seen = []
    for frame, chosen in zip(frames, (IPAD, settings), strict=True):
        survey = run_blocking(survey_path(scene, plan_previs(scene, chosen)))
        phone = simulate_phone(choose_phone(scene, survey, chosen), {}, frame.exposure)
        seen.append(replace(phone, of_camera=frozenset({"noise"})).see(frame, ipad.outputs)[0].plane_depth_m)
    assert not np.array_equal(*seen)


def test_a_scene_faster_than_the_phone_loses_frames(tmp_path):
    scene = room_with_a_virtual_sphere(4)
    scene.render.fps = 120
    results = run(scene, tmp_path, replace(FAST, phone="ipad_pro_lidar"))
    assert [entry["is_delivered"] for entry in results["frames"]] == [True, False, True, False]
    assert results["phone"]["shc_rmse"]["without"]["frame_rate"] is None
    assert any("2 of 4 frames" in note for note in results["notes"])


PROFILE = """
name = "My phone"
summary = "Sees one metre"

[range]
source = "measured on the kitchen table"
nearest_m = 0.0
farthest_m = {farthest}
"""


def test_a_users_own_profile_works_and_a_changed_one_is_another_run(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(PROFILE.format(farthest=2.0))
    settings = replace(FAST, phone=str(file))
    results = run(room_with_a_virtual_sphere(2), tmp_path / "out", settings)
    assert results["phone"]["name"] == "My phone" and rows(results)["range"]["state"] == "on"
    for entry in results["frames"]:
        plane_depth_m = load_frame(RunOutputs(tmp_path / "out", "untitled").capture(entry["frame"])).plane_depth_m
        assert entry["n_lost_pixels"] == {"range": np.count_nonzero(plane_depth_m > 2)} != {"range": 0}
        assert entry["n_invalid_pixels"] == np.count_nonzero((plane_depth_m > 2) | (plane_depth_m == 0))
    file.write_text(PROFILE.format(farthest=1.5))
    with pytest.raises(UserError, match="another phone"):
        run(room_with_a_virtual_sphere(2), tmp_path / "out", settings)


@pytest.mark.slow
def test_an_estimate_is_applied_at_the_first_frame_after_its_arrival(finished, over_lte):
    frames = over_lte.results["frames"]
    times_s = {entry["frame"]: entry["time_s"] for entry in frames}
    by_itself = {(e["frame"], p["name"]): p for e, p in steps(finished.results)}
    fired = [(entry, probe) for entry, probe in steps(over_lte.results) if probe["fired"]]
    assert {(e["frame"], p["name"]) for e, p in fired} == {key for key, probe in by_itself.items() if probe["fired"]}
    for entry, probe in fired:
        there_s = entry["time_s"] + 1e-3 * probe["latency_ms"]
        assert probe["arrival_frame"] == next((f for f, t in times_s.items() if t >= there_s), None)
    for entry, probe in steps(over_lte.results):
        there = [
            e["frame"] for e, p in fired if p["name"] == probe["name"] and (p["arrival_frame"] or 99) <= entry["frame"]
        ]
        if there:
            assert probe["sh"] == by_itself[max(there), probe["name"]]["sh"]
        else:
            assert np.count_nonzero(np.any(probe["sh"], axis=1)) == 1  # the ambient light, l = 0 alone
    summary = over_lte.results["summary"]
    assert summary["mean_latency_ms"] == pytest.approx(np.mean([p["latency_ms"] for _, p in fired]))
    assert rows(over_lte.results)["network"]["state"] == "on" and summary["n_lost"] == 0


@pytest.mark.slow
def test_errors_without_the_network_are_those_of_estimates_that_are_there_at_once(finished, over_lte):
    errors, at_once = over_lte.results["phone"]["shc_rmse"], finished.results["summary"]["mean_shc_rmse"]
    assert errors["without"] == {"network": at_once} and errors["perfect"] == at_once != errors["all_on"]


@pytest.mark.slow
def test_the_timeline_is_keyed_where_estimates_arrive(finished, over_lte):
    arrivals = {p["arrival_frame"] for _, p in steps(over_lte.results) if p["name"] == "Ball"} - {None}
    assert set(over_lte.keys["Xihe Ball"]) >= arrivals > set()
    assert min(arrivals) > 1 and over_lte.keys != finished.keys


def test_estimates_that_are_lost_never_light_anything(finished):
    plan = plan_previs(walk(), SMALL)
    exposure = finished.results["settings"]["reference_exposure"]
    link = replace(LINKS["wifi"], loss=1.0)
    session = PhoneSession(plan.probes, SMALL.chain(exposure), load_estimators(SMALL)[0], link, seed=0)
    for entry in finished.results["frames"]:
        if not entry["active"]:
            continue
        names = [probe["name"] for probe in entry["probes"]]
        _, requests = session.step(load_frame(finished.outputs.capture(entry["frame"])), {}, names)
        assert all(request.latency_s is None for request in requests.values())
        for name in names:
            assert np.array_equal(session.light(name, entry["time_s"]), session.ambient_sh)


def made(scene, **named):
    """What a run with such settings is made of."""
    settings = replace(SMALL, **named)
    return made_of("a run", scene, Path("no.blend"), settings, plan_previs(scene, settings))


def test_a_run_goes_on_however_its_objects_and_its_trigger_are_named():
    scene = walk(2)
    scene.objects["Ball"].name = "Caf\u00e9"
    assert made(scene, objects=("Caf\u00e9",)) == made(scene, objects=("Cafe\u0301",), trigger=RULES["split"])
    assert made(scene, objects=("Caf\u00e9",)) != made(scene)


def test_a_run_goes_on_where_a_phone_of_the_users_own_was_moved_and_not_where_it_changed(tmp_path):
    scene, cheap = walk(2), tmp_path / "cheap.toml"
    cheap.write_text('name = "Cheap"\nsummary = "none"\nmetering = "key"\n')
    before = made(scene, phone=str(cheap))
    (tmp_path / "moved").mkdir()
    moved = cheap.rename(tmp_path / "moved" / "cheap.toml")
    assert made(scene, phone=str(moved)) == before
    moved.write_text(moved.read_text().replace("key", "highlights"))
    assert made(scene, phone=str(moved)) != before
