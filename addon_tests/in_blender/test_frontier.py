"""`xihe frontier`: how it measures, what it judges, and a small one from end to end."""

import shutil
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from results_schema import read_strictly
from scene_snapshot import differences, snapshot
from tiny_scenes import room_with_a_virtual_sphere
from xihe_process import assert_refused, xihe_here

from xihe_blender.capture.reference_probe import ProbeSettings
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json, from_json, json_schema
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.frontier.choices import EXHAUSTIVE, compute_choices
from xihe_blender.lab.frontier.compute import ChoiceBackend, Walk, padded, square_errors, walk_through, with_every_pixel
from xihe_blender.lab.frontier.points import Measured, family, group, groups, points_of
from xihe_blender.lab.frontier.records import (
    ChoiceSettings,
    ComputeChoice,
    Frontier,
    FrontierSettings,
    RenderChoice,
    StudySize,
)
from xihe_blender.lab.frontier.report import pareto_plot
from xihe_blender.lab.frontier.study import frontier
from xihe_blender.lab.frontier.timing import Quartiles, interleaved
from xihenet.camera import unproject_frame
from xihenet.pareto import on_front
from xihenet.records import Intrinsics, RgbdFrame

TINY = StudySize(2, 1, 1, 2, 1, 2, 4, (1, 2), 1)
SMALL = FrontierSettings(is_quick=True, size=(32, 24), study_size=TINY)


# ------------------------------------------------------------------------------------------------------------ measuring


def drained(steps):
    """What a generator returns, and what it yielded."""
    yielded = []
    while True:
        try:
            yielded.append(next(steps))
        except StopIteration as finished:
            return finished.value, yielded


@given(st.integers(0, 5), st.integers(0, 4), st.integers(0, 99))
def test_candidates_take_turns_and_the_first_round_does_not_count(n_candidates, n_rounds, seed):
    calls = []

    def candidate(number):
        calls.append(number)
        return 100 * number + calls.count(number)

    candidates = [lambda number=number: candidate(number) for number in range(n_candidates)]
    measured, yielded = drained(interleaved(candidates, n_rounds, np.random.default_rng(seed)))
    assert yielded == list(range(n_rounds + 1))
    for start in range(0, len(calls), max(1, n_candidates)):
        assert sorted(calls[start : start + n_candidates]) == list(range(n_candidates))
    assert measured == [[100 * number + turn for turn in range(2, n_rounds + 2)] for number in range(n_candidates)]


def test_rounds_have_different_orders():
    calls = []
    candidates = [lambda number=number: float(calls.append(number) or 0) for number in range(6)]
    drained(interleaved(candidates, 5, np.random.default_rng(0)))
    assert len({tuple(calls[start : start + 6]) for start in range(0, 36, 6)}) > 3


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=9), st.floats(0, 100))
def test_spread_moves_with_no_shift_and_one_outlier_does_not_rule_the_median(values, shift):
    one, shifted = Quartiles.of(values), Quartiles.of([value + shift for value in values])
    assert shifted.median == pytest.approx(one.median + shift) and shifted.spread == pytest.approx(one.spread, abs=1e-6)
    assert min(values) <= one.median <= max(values) and one.spread >= 0
    assert Quartiles.of([*values, *values, 1e9]).median <= max(values)


def test_no_measurement_has_no_spread():
    with pytest.raises(ValueError, match="expected a measurement"):
        Quartiles.of([])


# --------------------------------------------------------------------------------------------------------- light errors


def test_the_error_of_a_light_is_its_share_of_the_light_and_bands_that_it_lacks_are_none():
    light = np.random.default_rng(6).normal(1, 0.3, (25, 3))
    errors = square_errors([1.1 * light[:9], light[:9]], [light[:9], light[:9]])
    assert np.sqrt([errors["coefficients"], errors["irradiance"]]) == pytest.approx(np.array([[0.1, 0.0]] * 2))
    missing = (light[9:] ** 2).sum() / (light**2).sum()
    assert square_errors([light[:9]], [light])["coefficients"] == pytest.approx([missing])
    assert padded(light[:4])[4:].max() == 0


def test_darkness_is_a_finite_reference():
    errors = square_errors([np.full((9, 3), 0.01)], [np.zeros((9, 3))])
    assert all(0 < value < 1 for values in errors.values() for value in values)


# ---------------------------------------------------------------------------------------------------------------- chain


def room_frame(width=48, height=36, shift=0.0):
    """Looking along +Y at a wall with coloured stripes, 3 m away."""
    rng = np.random.default_rng(2)
    stripes = rng.integers(20, 255, (1, width, 3), dtype=np.uint8)
    pose = np.array([[1.0, 0, 0, shift], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    seen = Intrinsics(width, height, fx=30.0, fy=30.0, cx=width / 2, cy=height / 2)
    plane_depth_m = np.full((height, width), 3.0, np.float32)
    ambient = np.full(3, 0.4)
    return RgbdFrame(np.tile(stripes, (height, 1, 1)), plane_depth_m, seen, pose, 1.0, ambient, 0.0, 1)


def room_walk(n_frames=3):
    frames = [replace(room_frame(shift=0.2 * k), time_s=k / 10, frame=k + 1) for k in range(n_frames)]
    names = ["a", "b"]
    positions = {"a": np.array([0.0, 2.0, 0.0]), "b": np.array([0.3, 2.4, 0.1])}
    return Walk(frames, [names] * n_frames, positions, [{n: np.ones((25, 3)) for n in names}] * n_frames, 1.0)


def lights_of(choice, walk=None):
    return np.array(walk_through(choice, ChoiceBackend(choice), walk or room_walk()).lights)


@pytest.mark.parametrize("step", [1, 2, 3, 5])
def test_a_frame_of_fewer_pixels_sees_the_same_points(step):
    whole, fewer = room_frame(), with_every_pixel(room_frame(), step)
    points, few = unproject_frame(whole), unproject_frame(fewer)
    grid = points.points_m.reshape(36, 48, 3)[::step, ::step].reshape(-1, 3)
    assert few.points_m == pytest.approx(grid, abs=1e-6)


def test_every_way_to_compute_gives_a_finite_light_at_every_place():
    walk = room_walk(2)
    for choice in compute_choices(is_quick=True):
        if choice.estimator in ("xihenet", "pointar"):
            continue
        lights = lights_of(choice, walk)
        assert lights.shape == (walk.n_places, 25, 3) and np.isfinite(lights).all(), choice.label


def test_brute_force_gives_the_light_of_exact_and_a_finer_table_is_nearer_to_it():
    exact = lights_of(ComputeChoice())
    assert lights_of(ComputeChoice(nearest="brute")) == pytest.approx(exact, abs=1e-6)
    coarse, fine = (lights_of(ComputeChoice(nearest="table", table_size=size)) for size in ((32, 16), (4096, 2048)))
    assert np.abs(fine - exact).max() < np.abs(coarse - exact).max()


def test_a_trigger_at_zero_estimates_wherever_something_changes():
    walk = room_walk(4)
    eager, base = (
        walk_through(choice, ChoiceBackend(choice), walk).n_estimates
        for choice in (ComputeChoice(theta=0.0), ComputeChoice(theta=10.0))
    )
    assert eager == walk.n_places > base >= len(walk.positions)


def test_projection_of_a_higher_order_begins_with_the_same_job_as_the_estimator():
    walk, choice = room_walk(1), ComputeChoice(estimator="projection", order=4)
    assert np.abs(lights_of(choice, walk)[:, 9:]).max() > 0
    assert np.abs(lights_of(replace(choice, order=2), walk)[:, 9:]).max() == 0


def test_only_the_steps_are_timed():
    ticks = iter(range(100))
    walked = walk_through(ComputeChoice(), ChoiceBackend(ComputeChoice()), room_walk(3), clock=lambda: next(ticks))
    assert walked.frame_ms == 1000


def test_choices_are_told_apart_by_their_words():
    for is_quick in (True, False):
        choices = compute_choices(is_quick=is_quick)
        labels = [choice.label for choice in choices]
        assert len(set(labels)) == len(labels) and labels[0] == "base" and choices[-1] == EXHAUSTIVE


# --------------------------------------------------------------------------------------------------------------- points


def measured(label, error, ms, preset=None):
    choice = ChoiceSettings(rendering=RenderChoice((8, 6), int(ms)))
    return Measured(label, choice, {"coefficients": (error**2,) * 3}, (ms, ms, ms), preset)


def test_points_are_judged_within_scene_front_and_kind():
    fronts = {
        "render": [measured("a", 0.1, 10), measured("b", 0.2, 20, "draft"), measured("c", 0.0, 30)],
        "compute": [replace(measured("b", 0.2, 20), square_errors={"coefficients": (0.04,), "irradiance": (0.01,)})],
    }
    points = points_of("room", fronts, seed=0)
    assert groups(points) == [(*("room", "render"), "coefficients"), *(("room", "compute", k) for k in KINDS)]
    told = {p.label: (p.on_front, p.instead, p.preset) for p in group(points, *groups(points)[0])}
    assert told == {"a": (True, None, None), "b": (False, "a", "draft"), "c": (True, None, None)}
    assert all(p.on_front for p in points if p.front == "compute")


KINDS = ("coefficients", "irradiance")


def test_a_plot_has_a_mark_for_every_choice_and_escapes_its_words():
    points = points_of("room", {"render": [measured("<a>", 0.1, 10, "draft"), measured("zero", 0, 30)]}, seed=0)
    drawn = pareto_plot(points, "title", "about")
    assert drawn.count("<title>") == 2 and "<a>" not in drawn and ">draft<" in drawn
    assert "nan" not in drawn and "inf" not in drawn.replace("infinite", "")
    assert "Nothing was measured" in pareto_plot([], "title", "about")


def test_a_family_differs_in_one_choice_and_no_other():
    other = replace(measured("other", 0.1, 9), settings=ChoiceSettings(rendering=RenderChoice((4, 3), 8)))
    points = points_of("room", {"render": [*(measured(f"{n}", 0.1, n) for n in (4, 2, 1)), other]}, seed=0)
    assert [p.settings.rendering.samples for p in family(points, ("samples",))] == [1, 2, 4]
    assert family(points, ("max_bounces",)) == family(points[:1], ("samples",)) == []


# ----------------------------------------------------------------------------------------------------------- end to end


@pytest.fixture(scope="module", autouse=True)
def small_light_probes():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("xihe_blender.lab.frontier.study.ProbeSettings", partial(ProbeSettings, size=48))
        yield


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A frontier of a tiny scene; its folder and its files."""
    folder = tmp_path_factory.mktemp("frontier")
    room_with_a_virtual_sphere()
    file = folder / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    run_blocking(frontier([file], folder / "out", SMALL, command="as typed"))
    return folder


def read(folder):
    """A frontier.json as a record; AssertionError where it is not what its schema and design promise."""
    content = read_strictly(folder / "out" / "frontier.json")
    Draft202012Validator(json_schema(Frontier)).validate(content)
    found = from_json(Frontier, content)
    assert as_json(found) == content and {"error_kind", "size", "samples"} <= set(content["points"][0]["settings"])
    for point in found.points:
        assert point.error >= 0 and point.time_ms > 0 and point.spread_ms >= 0
        assert point.preset in {None, "draft", "balanced", "accurate"} and 0 <= point.front_share <= 1
    for each in groups(found.points):
        own = group(found.points, *each)
        assert [p.on_front for p in own] == on_front([p.error for p in own], [p.time_ms for p in own]).tolist()
        labels = {p.label for p in own if p.on_front}
        assert all((p.instead in labels) != p.on_front for p in own)
    return found


def test_a_small_frontier_keeps_its_contract(done):
    found = read(done)
    kinds = {(front, kind) for _, front, kind in groups(found.points)}
    against = ("coefficients", "irradiance")
    assert {(front, kind) for front in ("render", "compute", "total") for kind in against} <= kinds
    assert {("compute", "coefficients_truth"), ("render", "picture"), ("compute", "picture_truth")} <= kinds
    for front in ("render", "total"):
        for kind in ("coefficients", "picture"):
            named = [p.preset for p in group(found.points, "room", front, kind) if p.preset]
            assert sorted(named) == ["accurate", "balanced", "draft"]
    assert found.software["command"] == "as typed" and found.answers


def test_table_and_report_hold_all_and_ask_for_nothing_else(done):
    lines = (done / "out" / "frontier.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(read(done).points) and lines[0].startswith("scene,front,error_kind,label")
    page = (done / "out" / "report.html").read_text(encoding="utf-8")
    assert "How many anchors?" in page and page.count('class="plot wide"') >= 8
    assert "http://" not in page and "src=" not in page


def test_a_frontier_that_is_done_is_not_measured_again(done):
    before = (done / "out" / "work" / "room" / "measured.json").read_bytes()
    assert run_blocking(frontier([done / "room.blend"], done / "out", SMALL, command="as typed")) == read(done)
    assert (done / "out" / "work" / "room" / "measured.json").read_bytes() == before


@pytest.mark.slow
def test_a_frontier_that_was_stopped_leaves_the_scene_alone_and_goes_on_without_rendering_again(done, tmp_path):
    work = tmp_path / "out" / "work"
    skipped = shutil.ignore_patterns("prepared.json", "measured.json", "exhaustive_*", "round_*", "picture*")
    shutil.copytree(done / "out" / "work", work, ignore=skipped)
    job = frontier([done / "room.blend"], tmp_path / "out", SMALL)
    next(job)
    before = snapshot()
    for progress in job:
        if "exhaustively" in progress.doing and "comparing" in progress.doing:
            break
    job.close()
    assert differences(before, snapshot()) == ({}, [])
    kept = {file: file.stat().st_mtime_ns for file in (work / "room").iterdir()}
    assert {file.name.partition("_")[0] for file in kept} == {"walk", "probes", "exhaustive", "round", "prepared.json"}
    run_blocking(frontier([done / "room.blend"], tmp_path / "out", SMALL))
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    first, again = (read(folder).points for folder in (done, tmp_path))
    assert [(p.label, p.error) for p in first] == [(p.label, p.error) for p in again]


def test_a_folder_of_another_frontier_and_two_scenes_of_one_name_are_refused(done, tmp_path):
    with pytest.raises(UserError, match="holds a frontier with another seed"):
        run_blocking(frontier([done / "room.blend"], done / "out", replace(SMALL, seed=1)))
    with pytest.raises(UserError, match="two scenes are named 'room'"):
        run_blocking(frontier([done / "room.blend"] * 2, tmp_path / "out", SMALL))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.blend"], "no such file"),
        (["README.md"], "is not a .blend file"),
        ([], "SCENE.blend"),
        (["README.md", "--seed", "-1"], "seed of -1"),
    ],
)
def test_wrong_input_gets_one_line_and_leaves_nothing(arguments, words, tmp_path):
    assert_refused(xihe_here("frontier", *arguments, "--out", tmp_path / "out"), words)
    assert not (tmp_path / "out").exists()


def test_a_scene_without_a_camera_is_refused_before_anything_is_measured(done, tmp_path):
    room_with_a_virtual_sphere()
    bpy.data.objects.remove(bpy.context.scene.camera)
    bad = tmp_path / "blind.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(bad))
    with pytest.raises(UserError, match="has no camera"):
        run_blocking(frontier([done / "room.blend", bad], tmp_path / "out", SMALL))
    assert not (tmp_path / "out").exists() and read(done)
