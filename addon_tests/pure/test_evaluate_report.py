"""The report of a batch says what the trials say, no more, and in one file."""

import re
from dataclasses import replace

import pytest

from addon_tests.pure.batches import batch, folder_with_pictures, frontier, results, trial
from xihe_blender.lab.batch import answers
from xihe_blender.lab.batch.answers import (
    MEASURES,
    against_the_best,
    compared,
    laziest_as_good,
    ranked,
    trigger_points,
    worst_cases,
)
from xihe_blender.lab.batch.grid import BatchSettings
from xihe_blender.lab.batch.report import report_page
from xihe_blender.lab.batch.results import BatchFolder
from xihe_blender.lab.frontier.records import Answer, ComputeChoice, FrontierPoint, PointSettings
from xihenet.formats import DASH

ERROR, PICTURE = MEASURES


def plain(page):
    return re.sub(r"<[^>]*>", "", page)


def test_pairs_are_of_the_same_scene_seed_and_phone():
    found = compared(batch(), ERROR, "estimator", "projection", "lattice")
    assert found.difference.mean == pytest.approx(0.1) and found.difference.n_pairs == 32
    assert found.difference.n_groups == 8 and found.difference.is_clear


def test_a_trial_without_its_partner_is_left_out():
    trials = [*batch(), trial("room 99", 7, estimator="projection", error=50.0)]
    assert compared(trials, ERROR, "estimator", "projection", "lattice").difference.mean == pytest.approx(0.1)
    assert compared([trials[0]], ERROR, "estimator", "lattice", "projection") is None


def test_the_truth_is_never_shipped_and_still_told():
    names = ["truth", "ambient", "lattice", "projection"]
    assert ranked(batch(), ERROR, names) == ranked(batch(), PICTURE, names) == ["truth", *names[2:], "ambient"]
    assert plain(answers.which_estimator(batch())) == (
        "Ship lattice: its mean light error, 0.380, is the lowest, clearly below that of projection and ambient. "
        "It has the best pictures too."
    )
    assert [one.first for one in against_the_best(batch(), ERROR)] == ["truth", "projection", "ambient"]


def test_what_differs_by_chance_is_called_so():
    trials = [
        trial(
            f"room {k}", estimator=name, error=0.3 + (0.1 * (-1) ** k + 0.001) * (name == "projection"), psnr=20.0 + k
        )
        for k in range(8)
        for name in ("lattice", "projection")
    ]
    said = answers.which_estimator(trials)
    assert "Ship <code>lattice</code>" in said and "may be chance" in said and "clearly" not in said


def test_a_single_estimator_is_no_comparison():
    assert "more of --estimators" in answers.which_estimator([trial()])


def test_a_worse_phone_costs_what_it_costs():
    said = plain(answers.is_a_better_phone_worth_it(batch()))
    assert "perfect has 0.050 less" in said and "12 % of it, and that is clear" in said and "+0.050" in said
    spoilt = [
        replace(one, shc_rmse=9.0) if one.estimator == "ambient" and one.phone == "cheap" else one for one in batch()
    ]
    assert plain(answers.is_a_better_phone_worth_it(spoilt)) == said
    assert "One phone was tried" in answers.is_a_better_phone_worth_it(batch(phones=("perfect",)))


def test_the_trigger_that_is_as_good_asks_least():
    points = trigger_points(batch(), "lattice")
    assert [point.per_minute for point in points] == [60.0, 48.0, 30.0, 12.0]
    assert laziest_as_good(points).per_minute == 12.0
    worse = [*points[:-1], replace(points[-1], error=1.06 * points[0].error)]
    assert laziest_as_good(worse).per_minute == 30.0
    assert trigger_points([trial(trigger_sweep=())], "lattice") == []
    equal = [points[0], *(replace(point, per_minute=30.0) for point in points[1:])]
    assert laziest_as_good(equal).factor == 1


def test_how_often_is_answered_where_the_ambient_light_is_best():
    best = trial(estimator="ambient", error=0.05, trigger_sweep=())
    assert answers.how_often([best, trial(error=0.1)]).startswith(
        "With <code>lattice</code>, the trigger as it is asks"
    )
    assert answers.how_often([best]).startswith("No estimator that looks at the room")


@pytest.mark.parametrize(
    ("as_good", "words"),
    [(0, "No lazier trigger stays within 5 % of that."), (1, "It is the laziest that stays within")],
)
def test_lazier_triggers_that_are_worse_are_not_advised(as_good, words):
    sweep = [replace(one, shc_rmse=0.1 if one.factor <= as_good else 0.2) for one in trial().trigger_sweep]
    assert words in answers.how_often([trial(trigger_sweep=tuple(sweep))])


def test_a_rule_without_thresholds_says_what_every_frame_gives_and_how_to_hear_of_others():
    (own,) = (one for one in trial().trigger_sweep if one.factor == 1)
    words = answers.how_often([trial(trigger_sweep=(own,))])
    assert "an estimate in every frame is 30 times a minute" in words and "Leave out --trigger" in words


def test_the_page_says_how_it_was_made(tmp_path):
    made = part(report_page(BatchFolder(tmp_path), results(batch()), None), "made")
    assert "<span>256x192, or upright where the scene is</span>" in made
    assert '<code>--trigger</code></th><td data-column="value"><span>split</span>' in made


def test_thetas_that_differ_from_scene_to_scene_are_told_from_least_to_greatest():
    quiet = trial("room", estimator="lattice")
    noisy = replace(
        quiet,
        unit="dim_0",
        scene="dim",
        trigger_sweep=tuple(replace(t, theta=1.35 * t.theta) for t in quiet.trigger_sweep),
    )
    assert [point.theta for point in trigger_points([quiet, noisy], "lattice")][2:] == [
        "0.0200 to 0.0270",
        "0.0800 to 0.108",
    ]
    assert trigger_points([quiet], "lattice")[2].theta == "0.0200"


def test_so_few_scenes_say_how_little_they_hold():
    assert "One scene says nothing about others" in answers.what_it_stands_on(batch(1))
    assert "With 4 trials of each estimator no difference is called clear" in answers.what_it_stands_on(batch(1))
    assert "is called clear" not in answers.what_it_stands_on(batch(1, seeds=(0, 1, 2)))
    assert "at most 75" in answers.what_it_stands_on(batch(3))
    assert "at most" not in answers.what_it_stands_on(batch(8))
    pixels = {"<far>": 27.4, "near": 2000.0, "small": 99.0, "hidden": None}
    trials = [trial(scene, object_pixels=n) for scene, n in pixels.items()]
    blind = trial("<far>", 1, object_pixels=None)  # Of a phone that delivered no frame with an object.
    words = answers.what_it_stands_on([*trials, blind])
    assert "In &lt;far&gt; and small virtual objects cover fewer than 100 pixels" in words


def test_worst_cases_are_one_per_scene_and_estimator_and_never_the_truth():
    cases = worst_cases(batch(), 100)
    assert len(cases) == 8 * 3 and [frame.psnr for _, frame in cases] == sorted(frame.psnr for _, frame in cases)
    assert all(frame.frame == 3 and trial.estimator != "truth" for trial, frame in cases)
    assert cases[0][0].scene == "room 7" and cases[0][0].estimator == "ambient"


def test_the_page_is_one_file_with_its_pictures(tmp_path):
    trials = batch()
    folder = folder_with_pictures(tmp_path, trials)
    page = report_page(folder, results(trials), None)
    assert "Error in sRGB (black: none, brightest: 25" in page
    assert page.count("data:image/png") == 18 and not re.findall(r'(?:src|href)="(?!data:|#)', page)
    questions = ("Which estimator", "better phone", "How often", "How many anchors", "last 10\u202f%", "Worst cases")
    assert all(question in page for question in questions)
    assert not re.search(r"\bnan\b", plain(page)) and page == report_page(folder, results(trials), None)


def test_the_error_of_each_estimator_is_told_by_phone(tmp_path):
    said = plain(part(report_page(BatchFolder(tmp_path), results(batch()), None), "phone"))
    assert re.search(r"lattice\s*0\.355\s*0\.405", said), said


def test_the_time_of_a_step_stands_beside_the_error_of_each_estimator(tmp_path):
    trials = [replace(trial(estimator=name, error=0.25), number=k) for k, name in enumerate(("lattice", "ambient"))]
    whole = results(trials)
    units = tuple(replace(unit, step_ms=(4.25, None)) for unit in whole.units)
    page = report_page(folder_with_pictures(tmp_path, trials), replace(whole, units=units), None)
    told = re.findall(r'"time of a step, median"><span>(.*?)</span>', page)
    assert told == ["4.25\u202fms", DASH]


def test_the_page_says_with_which_settings_it_was_made(tmp_path):
    settings = BatchSettings(size=(64, 48), frames=(1, 2, 3, 9), samples=4)
    made = replace(results(batch(1)), settings=settings, software={"xihe": "0.1.0", "blender": "4.5.15"})
    page = report_page(BatchFolder(tmp_path), made, None)
    assert page == report_page(BatchFolder(tmp_path), made, None)
    said = plain(part(page, "made"))
    assert all(words in said for words in ("--size64x48", "--frames1\u20133, 9", "--samples4", "--seeds0, 1", "4.5.15"))


def test_a_resumed_unit_says_why_it_rendered_longer_than_it_took(tmp_path):
    whole = results(batch(1))
    resumed = replace(whole, units=(replace(whole.units[0], elapsed_s=15.6, render_s=36.0), *whole.units[1:]))
    pages = [plain(report_page(BatchFolder(tmp_path), one, None)) for one in (whole, resumed)]
    assert ["stopped and resumed" in page for page in pages] == [False, True]


def test_names_of_scenes_cannot_break_the_page(tmp_path):
    trials = [trial("<b>\"'&", estimator=name, psnr=18.0) for name in ("lattice", "projection")]
    page = report_page(BatchFolder(tmp_path), results(trials, [("a<b", "c<d")]), None)
    assert "<b>\"'&" not in page and "a&lt;b" in page and "is missing" in page


def test_a_batch_whose_best_estimator_has_no_psnr_has_its_answer():
    perfect = trial(psnr=None, frames=())
    words = answers.which_estimator([perfect, trial(estimator="projection", error=0.2)])
    assert words.endswith("they are as the ground truth, or show no object.")


def test_trials_without_any_value_make_a_page_too(tmp_path):
    empty = trial(psnr=None, shc_rmse=None, frames=(), trigger_sweep=(), estimates_per_minute=None)
    assert "No picture was compared" in plain(report_page(BatchFolder(tmp_path), results([empty]), None))
    assert "No trial could be done" in report_page(BatchFolder(tmp_path), results([], [("x.blend", "gone")]), None)


def measured(error, n_anchors, *, kind="coefficients_truth", scene="room", theta=0.01):
    """A point of frontier.json."""
    settings = PointSettings(error_kind=kind, computing=ComputeChoice(n_anchors=n_anchors, theta=theta))
    return FrontierPoint(
        scene=scene, front="compute", settings=settings, label=f"{n_anchors} anchors, theta {theta}", error=error,
        error_spread=0.0, time_ms=1.0, spread_ms=0.1, on_front=True, front_share=1.0, preset=None, instead=None,
    )  # fmt: skip


def part(page, name):
    return page.split(f'<section id="{name}">')[1].split("</section>")[0]


def test_a_frontier_answers_what_takes_measured_times(tmp_path):
    answer = Answer(scene="room", question="How many anchors?", answer="512 are within 1 %.")
    given = frontier([measured(0.02, 512), measured(0.01, 2048)], [answer])
    page = report_page(BatchFolder(tmp_path), results(batch()), given)
    assert "512 are within 1\u202f%." in page and "2048 anchors" in page and "has no answer to that" in page
    assert "xihe frontier" in report_page(BatchFolder(tmp_path), results(batch()), None)


def test_anchors_are_plotted_by_what_their_answer_speaks_of(tmp_path):
    """Off the rendered light probe, scene by scene, and nothing but the anchors differs."""
    told = [(0.31, 512, "room"), (0.32, 2048, "room"), (0.33, 512, "hall"), (0.34, 2048, "hall")]
    points = [measured(error, n_anchors, scene=scene) for error, n_anchors, scene in told]
    points += [measured(0.07, n_anchors, kind="coefficients") for n_anchors in (512, 2048)]
    points += [measured(0.39, 512, theta=0.6), measured(0.36, 512, scene="alone")]
    page = report_page(BatchFolder(tmp_path), results(batch()), frontier(points))
    anchors, last = part(page, "anchors"), part(page, "last")
    dots = re.findall(r"<title>(\w+), (\d+) anchors.*?: ([\d.]+)\s%", anchors)
    assert sorted((float(error) / 100, int(n_anchors), scene) for scene, n_anchors, error in dots) == sorted(told)
    assert "against the rendered light probe" in anchors and "exhaustive" not in anchors
    assert (
        "against the exhaustive setting" in last
        and last.count(": 7.00\u202f% in") == 2
        and ": 31.0\u202f% in" not in last
    )
