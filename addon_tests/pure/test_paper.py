"""The evaluation of the paper: figures have intervals, a study that was measured is kept, and what is wrong is said."""

from __future__ import annotations

import contextlib
import itertools
import json
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from addon_tests.pure.commands import assert_refused, xihe_here
from xihe_blender.errors import UserError
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.paper import run as paper
from xihe_blender.lab.paper.records import Place, Row, Session, Study, StudyOptions, measured
from xihe_blender.lab.paper.report import paper_markdown, report_page
from xihe_blender.lab.paper.studies.anchors_uniform import GridAnchors
from xihe_blender.lab.paper.studies.probes import inside_rim, spheres_error
from xihenet import estimators, metrics
from xihenet.edge.bench import seen_frame

ROOT = Path(__file__).parents[2]
SETTINGS = paper.PaperSettings(quick=True)


def rows_of_mean(sessions, options):
    for session in sessions:
        values = options.rng.normal(5.0, 1.0, 40)
        what = f"mean in {session.name}"
        yield Row(what, "ms", *measured(values, options.rng), "same work", "Alike.", 5.5, "draws", "all", 1.0)


STUDY = Study("mean", "A mean", 1, "The paper took a mean.", rows_of_mean, "room", "Mean, ms")
SESSION = Session("room", (), 1.0, ())


def test_intervals_hold_the_mean_in_nineteen_of_twenty_cases():
    rng, n_held = np.random.default_rng(1), 0
    for _ in range(30):
        found = measured(rng.normal(3.0, 2.0, 20), rng)
        n_held += found.low <= 3.0 <= found.high
    assert n_held >= 25


def test_rooms_are_drawn_whole_so_that_frames_alike_add_no_certainty():
    rooms = np.repeat(np.random.default_rng(2).normal(size=8), 50)
    by_room = measured(rooms, np.random.default_rng(3), groups=np.repeat(range(8), 50).tolist())
    by_frame = measured(rooms, np.random.default_rng(3))
    assert by_room.high - by_room.low > 4 * (by_frame.high - by_frame.low)


@pytest.mark.parametrize("statistic", [np.mean, np.median, np.std])
def test_all_draws_at_once_give_what_each_gives_alone(statistic):
    values = np.random.default_rng(4).normal(size=150)
    alone = measured(values, np.random.default_rng(5), statistic=lambda drawn: statistic(drawn))
    assert measured(values, np.random.default_rng(5), statistic=statistic) == alone


WRONG = {"unit": "", "n": 0, "low": 2.0, "high": float("nan"), "series": "without a place"}


@pytest.mark.parametrize("wrong", [{name: value} for name, value in WRONG.items()])
def test_a_figure_without_unit_interval_or_cases_is_refused(wrong):
    whole = {"what": "time", "unit": "ms", "value": 1.0, "low": 0.5, "high": 1.5, "n": 3}
    with pytest.raises(ValueError, match="Row 'time'"):
        Row(**({**whole, "work": "same work", "sentence": "Alike."} | wrong))


def test_one_case_has_no_interval():
    with pytest.raises(ValueError, match="two cases"):
        measured([1.0], np.random.default_rng(0))


def test_a_study_is_measured_once_and_again_for_another_seed(tmp_path):
    calls = []

    def measure(sessions, options):
        calls.append(options.seed)
        yield from rows_of_mean(sessions, options)

    study = Study("mean", "A mean", 1, "The paper took a mean.", measure)
    for seed, inputs in ((0, "a"), (0, "a"), (1, "b")):
        settings = paper.PaperSettings(quick=True, seed=seed)
        run_blocking(paper.measure_studies([study], [SESSION], tmp_path, settings, inputs))
    assert calls == [0, 1]
    assert (tmp_path / "mean.csv").read_text().count("\n") == 2


def test_studies_are_measured_again_with_networks_of_another_training(monkeypatch):
    before = paper.study_inputs({}, paper.QUICK_WALK)
    monkeypatch.setattr(paper, "weights_sha256", lambda names, target: {"lattice": f"{target}, trained anew"})
    assert paper.study_inputs({}, paper.QUICK_WALK) != before


def test_studies_are_kept_where_another_package_offers_an_estimator(monkeypatch):
    before = paper.study_inputs({}, paper.QUICK_WALK)
    evenly = EntryPoint("evenly", "evenly:Evenly", estimators.OUTSIDE)
    monkeypatch.setattr(estimators, "_outside", lambda: {"evenly": evenly})
    assert estimators.names()[-1] == "evenly" and paper.study_inputs({}, paper.QUICK_WALK) == before


def test_a_study_that_is_stopped_leaves_nothing_and_the_next_run_measures_it(tmp_path):
    sessions, result = [SESSION, Session("other", (), 1.0, ())], tmp_path / "results" / "mean.json"
    with contextlib.closing(paper.measure_studies([STUDY], sessions, tmp_path, SETTINGS, "a")) as job:
        next(job), next(job)
    assert not result.exists()
    run_blocking(paper.measure_studies([STUDY], sessions, tmp_path, SETTINGS, "a"))
    assert len(json.loads(result.read_text())["rows"]) == 2


def test_a_study_is_measured_anew_when_what_all_studies_share_has_changed(monkeypatch, tmp_path):
    run_blocking(paper.measure_studies([STUDY], [SESSION], tmp_path, SETTINGS, "a"))
    assert paper.kept_result(tmp_path, STUDY, "a") is not None
    monkeypatch.setattr(paper, "clouds", metrics)
    assert paper.kept_result(tmp_path, STUDY, "a") is None


def test_a_study_that_cannot_be_measured_says_why_and_is_tried_again(tmp_path):
    def measure(sessions, options):
        raise UserError("torch is missing")
        yield

    run_blocking(paper.measure_studies([Study("net", "Net", 1, "It ran.", measure)], [], tmp_path, SETTINGS, "a"))
    study = Study("net", "Net", 1, "It ran.", measure)
    assert paper.kept_result(tmp_path, study, "a").failed_because == "torch is missing"


def test_report_and_page_show_every_figure_beside_the_papers(tmp_path):
    run_blocking(paper.measure_studies([STUDY], [SESSION], tmp_path, SETTINGS, "a"))
    results = [paper.kept_result(tmp_path, STUDY, "a")]
    page = report_page([STUDY], results, tmp_path / "pictures", "xihe paper --quick")
    words = paper_markdown([STUDY], results, "xihe paper --quick", tmp_path)
    for text in (page.replace("\N{NARROW NO-BREAK SPACE}", " "), words):
        assert all(said in text for said in ("mean in room", "5.50 ms", "40 draws", "same work", "xihe paper --quick"))
    assert "<svg" in page and "://" not in page


def test_the_page_of_the_documentation_has_no_details_and_says_a_sentence_once(tmp_path):
    def row(what, sentence, is_detail=False):
        return Row(what, "ms", 1.0, 0.5, 1.5, 3, "same work", sentence, is_detail=is_detail)

    rows = (row("all", "Alike. Of 95 % or more."), row("few", "Alike. Few."), row("curve", "Alike.", is_detail=True))
    results = [paper.StudyResult("mean", "", "2021-06-24", 1.0, "one machine", rows)]
    words = paper_markdown([STUDY], results, "xihe paper", tmp_path)
    assert words.count("Alike.") == 1 and "- Few.\n" in words and "| curve |" not in words
    assert "2 figures" in words and "`report.html` has 1 more.\n" in words
    assert "(differences.md)" in paper_markdown([STUDY], results, "xihe paper", ROOT / "docs") and "](" not in words
    assert "curve" in report_page([STUDY], results, Path("nowhere"), "xihe paper")


def test_studies_have_names_of_their_own_in_the_order_of_the_paper():
    names = [study.name for study in paper.all_studies()]
    assert len(set(names)) == len({study.place for study in paper.all_studies()}) == len(names) > 0
    assert [study.name for study in paper.chosen_studies([names[-1]])] == names[-1:]


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        (["--only", "nonsense"], "no study 'nonsense'"),
        (["--scenes", "missing.blend"], "no such file"),
        (["--seed", "-1"], "--seed -1"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, typed, said):
    assert_refused(xihe_here("paper", "--out", tmp_path / "out", *typed), said)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_acceleration_grid_is_the_papers_to_a_fifth_of_a_per_cent(tmp_path):
    study = paper.chosen_studies(["acceleration_grid"])[0]
    rows = list(itertools.islice(study.measure([], StudyOptions(True, 0, Path(tmp_path))), 5))
    assert max(abs(row.value - row.paper) for row in rows if row.paper is not None) < 0.2
    assert [row.value for row in rows if row.paper is None] == [0]


@pytest.fixture(scope="module")
def walk():
    """A look around in a room of plain walls, with two places in view and a light that is known."""
    light = np.zeros((9, 3))
    light[0], light[1:] = 1.5, 0.2
    places = [Place(f"place {k}", np.array([x, 0.4, -0.3]), light, light) for k, x in enumerate((0.6, -0.6))]
    return Session("walls", [seen_frame(k) for k in range(0, 30, 3)], 1.0, places)


def test_bytes_are_counted_on_the_clouds_of_a_walk(walk, tmp_path):
    study = paper.chosen_studies(["encodings"])[0]
    rows = {row.what: row for row in study.measure([walk], StudyOptions(True, 0, tmp_path))}
    assert rows["float32: mean"].value == rows["float32: mean"].paper == 20480
    n_set = rows["uint8_float16_stripped: mean"].value / 7
    assert 0 < n_set < 1280 and rows["float32_stripped: mean"].value == pytest.approx(18 * n_set)


@pytest.mark.slow
def test_even_anchors_share_the_sphere_and_those_of_a_grid_do_not(walk, tmp_path):
    study = paper.chosen_studies(["anchors_uniform"])[0]
    rows = {row.what: row.value for row in study.measure([walk], StudyOptions(True, 0, tmp_path))}
    # By Voronoi's cells 0.01515; of the grid, between its circles of latitude, 0.4824.
    assert rows["even: spread of area over mean"] == pytest.approx(0.01515, rel=0.03)
    assert rows["grid: spread of area over mean"] == pytest.approx(0.4824, rel=0.005)
    assert rows["even: all seen, equal weights"] < 0.002 < rows["grid: all seen, equal weights"]


def test_anchors_of_a_grid_are_found_as_the_largest_cosine_says():
    anchors, directions = GridAnchors(), np.random.default_rng(4).normal(size=(5_000, 3))
    assert (anchors.nearest(directions) == (directions @ anchors.directions.T).argmax(axis=1)).all()


@pytest.mark.parametrize("name", ["encodings", "anchors_uniform", "anchor_count", "estimators", "probes", "materials"])
def test_studies_of_rooms_say_what_they_lack(tmp_path, name):
    study = paper.chosen_studies([name])[0]
    with pytest.raises(UserError, match="fewer than two"):
        list(study.measure([SESSION], StudyOptions(True, 0, tmp_path)))


def test_the_rim_of_each_sphere_is_left_out_of_its_picture():
    inside = inside_rim(64)
    assert not inside[0].any() and inside[32, 32] and inside.mean() == pytest.approx(np.pi / 4 * 0.95**2, abs=0.01)
    beside = np.concatenate([np.where(inside, error, 9.0) for error in (0, 0.3, 0.4)], axis=1)[..., None]
    assert spheres_error(beside, np.zeros_like(beside)) == pytest.approx(0.5 / 3**0.5)
