"""The choices that `xihe frontier` measured, as points: which are on a front, which differ in one choice, how drawn."""

import re
from dataclasses import replace

import pytest

from xihe_blender.lab.frontier.answers import LAST_TENTH, answers
from xihe_blender.lab.frontier.points import Measured, family, group, groups, points_of
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice, RenderChoice
from xihe_blender.lab.frontier.report import pareto_plot
from xihenet.formats import DASH


def measured(label, error, ms, preset=None):
    choice = ChoiceSettings(rendering=RenderChoice((8, 6), int(ms)))
    return Measured(label, choice, {"coefficients": (error**2,) * 3}, (ms, ms, ms), preset)


def test_points_are_judged_within_scene_front_and_kind():
    fronts = {
        "render": [measured("a", 0.1, 10), measured("b", 0.2, 20, "draft"), measured("c", 0.0, 30)],
        "compute": [replace(measured("b", 0.2, 20), square_errors={"coefficients": (0.04,), "irradiance": (0.01,)})],
    }
    points = points_of("room", fronts, seed=0)
    fronts_and_kinds = (("render", "coefficients"), ("compute", "coefficients"), ("compute", "irradiance"))
    assert groups(points) == [("room", *each) for each in fronts_and_kinds]
    told = {p.label: (p.on_front, p.instead, p.preset) for p in group(points, *groups(points)[0])}
    assert told == {"a": (True, None, None), "b": (False, "a", "draft"), "c": (True, None, None)}
    assert all(p.on_front for p in points if p.front == "compute")


def test_a_round_that_was_disturbed_makes_no_choice_flicker_and_equal_errors_have_no_spread():
    disturbed = replace(measured("a", 0.1, 10), times_ms=(10, 10, 10, 10, 1000))
    steady = replace(measured("b", 0.2, 20), times_ms=(20,) * 5)
    first, second = points_of("room", {"render": [disturbed, steady]}, seed=0)
    assert second.front_share < 0.2 and first.front_share == 1
    assert first.error_spread == pytest.approx(0) == second.error_spread


def test_a_plot_has_a_mark_for_every_choice_and_escapes_its_words():
    points = points_of("room", {"render": [measured("<a>", 0.1, 10, "draft"), measured("zero", 0, 30)]}, seed=0)
    drawn = pareto_plot(points, "title", "about")
    assert drawn.count("<title>") == 2 and "<a>" not in drawn and ">draft<" in drawn
    assert ">error<" in drawn and ">processor time of a frame<" in drawn
    assert "nan" not in drawn and "inf" not in drawn.replace("infinite", "")


def test_marks_that_are_close_are_numbered_together():
    front = [(1, 0.5), (1.01, 0.495), (1.02, 0.49), (1.5, 0.4), (5, 0.3), (5.1, 0.29)]
    points = points_of("room", {"render": [measured(f"{ms}", error, ms) for ms, error in front]}, seed=0)
    drawn = pareto_plot(points, "title", "about")
    assert re.findall('class="number"[^>]*>([^<]*)<', drawn) == [f"1{DASH}3", "4", "5, 6"]


def test_a_family_differs_in_one_choice_and_no_other():
    other = replace(measured("other", 0.1, 9), settings=ChoiceSettings(rendering=RenderChoice((4, 3), 8)))
    points = points_of("room", {"render": [*(measured(f"{n}", 0.1, n) for n in (4, 2, 1)), other]}, seed=0)
    assert [p.settings.rendering.samples for p in family(points, ("samples",))] == [1, 2, 4]
    kinds = [ChoiceSettings(rendering=RenderChoice((8, 6), 4, n)) for n in (None, 12, 2)]
    bounces = [replace(measured(f"{n}", 0.1, n + 1), settings=kind) for n, kind in enumerate(kinds)]
    found = family(points_of("room", {"render": bounces}, seed=0), ("max_bounces",))
    assert [p.settings.rendering.max_bounces for p in found] == [2, 12, None]
    assert family(points, ("max_bounces",)) == family(points[:1], ("samples",)) == []


def test_answers_are_sentences_with_units():
    estimators = [ChoiceSettings(computing=ComputeChoice(estimator=name)) for name in ("lattice", "projection")]
    errors = {"coefficients_truth": (0.09,)}, {"coefficients_truth": (0.16,)}
    pairs = zip(estimators, errors, strict=True)
    compute = [Measured(own.computing.label, own, squares, (4.0,)) for own, squares in pairs]
    total = [measured(f"{n} samples", 0.4 / n, 2000 * n, name) for n, name in ((1, "draft"), (4, "balanced"))]
    points = points_of("room", {"render": total, "compute": compute, "total": total}, seed=0)
    told = {one.question: one.answer for one in answers(["room"], points)}
    assert told["Which estimator?"] == (
        "lattice is closest to the rendered light probe on this walk, of light clipped at white. Error and time of a "
        "frame, by estimator: lattice: 30.0 % in 4 ms; projection: 40.0 % in 4 ms."
    )
    assert "draft (1 samples): 40.0 % in 2 s; balanced (4 samples): 10.0 % in 8 s." in told["What do the presets cost?"]
    assert told[LAST_TENTH].strip() == (
        "Rendering: only balanced (4 samples), which takes 8 s a frame, lowers the error from 40.0 % to 10.0 %."
    )


def test_the_last_tenth_of_the_error_and_the_least_error_of_each_frame_size_are_told():
    whole = [measured(f"{ms}", error, ms) for ms, error in ((10, 0.5), (20, 0.145), (100, 0.12), (1000, 0.1))]
    small = [ChoiceSettings(rendering=RenderChoice((4, 3), n)) for n in (1, 2)]
    small = [replace(measured(f"{n}", 0.6 - n / 100, 2000), settings=one) for n, one in enumerate(small)]
    told = " ".join(one.answer for one in answers(["room"], points_of("room", {"render": whole + small}, seed=0)))
    assert "to 10.0 %. Nine tenths of that cost 100 ms a frame, with 100; all of it costs 10.0 times" in told
    assert "8x6 pixels: 10.0 %; 4x3 pixels: 59.0 %" in told


@pytest.mark.parametrize(
    ("errors", "said"), [((0.5, 0.3), "2048 anchors, the most that"), ((0.3, 0.299), "512 anchors are enough")]
)
def test_as_many_anchors_as_were_measured_are_not_called_enough(errors, said):
    choices = [ChoiceSettings(computing=ComputeChoice(n_anchors=n), estimates=1, steps=3) for n in (512, 2048)]
    pairs = zip(choices, errors, strict=True)
    own = [Measured(one.computing.label, one, {"coefficients_truth": (e**2,)}, (4.0,)) for one, e in pairs]
    (answer,) = [one.answer for one in answers(["room"], points_of("room", {"compute": own}, seed=0))]
    assert answer.startswith(said)
