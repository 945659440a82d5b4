"""Do the report's parts hold on their own: chosen frames, the sentence, axes, numbers as text, colours?"""

import itertools
import re
from html import escape
from typing import get_args, get_type_hints

import numpy as np
import pytest

import xihe_blender.report.page as report
from addon_tests.pure import runs
from xihe_blender.cli.previs import format_summary
from xihe_blender.io.json_records import from_json
from xihe_blender.io.run_results import METRICS, Metrics, ProbeResult, RunResults
from xihe_blender.report import budget, tables
from xihe_blender.report.document import SCRIPT, STYLE, document, table
from xihe_blender.report.pictures import MAX_FRAMES, choose_frames, picture_kinds
from xihe_blender.report.tables import numbers_section
from xihe_blender.report.timeline import REASONS, Timeline
from xihe_blender.report.values import closeness, format_closeness, too_small_to_judge
from xihenet.formats import DASH, format_percent
from xihenet.records import TriggerReason


def test_every_metric_is_a_column_and_every_reason_to_estimate_has_words():
    assert [name for name, _, _ in tables.METRICS] == list(METRICS)
    assert set(REASONS) == {*get_args(TriggerReason)} - {"none"}
    assert get_type_hints(ProbeResult)["reason"] == TriggerReason


def test_a_table_has_a_heading_for_every_cell_and_a_cell_for_every_heading():
    for row in (["a", "1"], ["a", "1", "2", "3"]):
        with pytest.raises(ValueError, match=r"longer|shorter"):
            table(["name", "one", "two"], [row])


def test_a_page_runs_no_script_but_its_own():
    without, own = document("heading", "", []), document("heading", "", [], title="title", script=SCRIPT)
    assert "default-src 'none'" in without and "script" not in without and "<title>heading</title>" in without
    assert "script-src 'unsafe-inline'" in own and "<title>title</title>" in own
    assert f"<script>{SCRIPT.read_text()}</script>" in own and STYLE.read_text() in own


def test_a_number_stays_beside_its_unit_and_a_command_as_it_was_typed():
    page = document("heading", "<p>31 % in 4.12 ms</p>", [("a", "A", "<pre>xihe --out '3 s'</pre><p>3 seeds, 1 s</p>")])
    assert "31\u202f% in 4.12\u202fms" in page and "'3 s'" in page and "3 seeds, 1\u202fs" in page


@pytest.mark.parametrize("n_frames", [1, 15, 16, 17, 100, 301])
def test_chosen_frames_are_spread_over_the_run(n_frames):
    chosen = [frame.frame for frame in choose_frames(runs.results(map(runs.frame, range(n_frames))).frames)]
    assert len(chosen) == min(n_frames, MAX_FRAMES) == len(set(chosen))
    assert chosen[0] == 0 and chosen[-1] == n_frames - 1
    gaps = [b - a for a, b in itertools.pairwise(chosen)]
    assert max(gaps, default=1) <= 2 * n_frames / MAX_FRAMES + 1


def test_pictures_come_in_the_order_of_the_story():
    kinds = (["error_ambient", "error_lattice", "other", "truth", "ambient", "lattice"], ["captured", "ground_truth"])
    pictures = [dict.fromkeys(of_one, "") for of_one in kinds]
    expected = ["captured", "ground_truth", "lattice", "ambient", "truth", "other", "error_lattice", "error_ambient"]
    assert picture_kinds(pictures, "lattice") == expected


@pytest.mark.parametrize(
    ("own", "ambient", "expected"),
    [
        (0.69, 1.0, "are 31 % closer to the ground truth than with ambient"),
        (1.12, 1.0, "are 12 % further from the ground truth than with ambient"),
        (3.1, 1.0, "have 3.1 times the error that they have with ambient"),
        (1.0, 1.0, "are as close to the ground truth as with ambient"),
        (0.0, 1.0, "are 100 % closer to the ground truth than with ambient"),
        (0.0, 0.0, "match the ground truth exactly, as they do with ambient"),
        (0.1, 0.0, "differ from the ground truth, which they match with ambient"),
        (None, 1.0, "could not be measured"),
        (0.5, None, "differ from the ground truth by an rmse of 0.500"),
    ],
)
def test_the_sentence_tells_better_worse_and_undefined_apart(own, ambient, expected):
    results = runs.results(comparison={"projection": runs.metrics(own), "ambient": runs.metrics(ambient)})
    words = re.sub("<[^>]*>", "", report.format_result(results))
    assert expected in words


def test_only_a_command_that_can_be_typed_can_be_copied():
    for command, can_be in (("xihe previs a.blend --out out", True), ("Run in Blender's panel", False)):
        page = numbers_section(runs.results(software={"command": command}))
        assert escape(command) in page and ('id="copy"' in page) == can_be


def test_wide_tables_show_that_they_go_on_and_break_no_word():
    style = STYLE.read_text(encoding="utf-8")
    assert "overflow-x: auto" in style and "no-repeat local" in style
    assert not re.search(r"\.way\b[^{}]*\{[^}]*nowrap", style)
    assert ".words td code { overflow-wrap: break-word; }" in style


def test_estimates_that_the_server_did_not_answer_are_said_first():
    whole = runs.content(
        [runs.frame(1, runs.probe())],
        settings={"estimator": "lattice", "network": None},
        summary={
            "n_estimates": 38,
            "n_unknown_lights": 36,
            "invalid": runs.SUMMARY["invalid"] | {"lights": {"no_answer": 35, "nothing_seen": 1}},
            "rmse_against_ambient": {"lattice": 1.92},
            "object_pixels": 1e4,
        },
    )
    said = "38 estimates of the light around 1 virtual object, 35 of which the edge service did not answer."
    assert report.format_result(from_json(RunResults, whole)).startswith(f"Over 1 frame the phone asked for {said}")
    assert ", 38 estimates, 35 of which the edge service did not answer, the last" in format_summary(whole)
    assert "the phone made no estimates of" in report.format_result(runs.results([runs.frame(1, runs.probe())]))


def test_the_time_of_rendering_holds_the_compared_pictures_and_the_choice_of_samples():
    summary = {"render_s": 24.0, "comparison_render_s": 122.0, "pilot_s": 6.9}
    page = re.sub("<[^>]*>", " ", report._key_figures(runs.results(summary=summary)))
    parts = "24.0 s for captures and light probes, 122 s for compared pictures, 6.90 s for choosing the samples"
    assert f"of rendering: {parts}" in page and " 153 s " in page


def test_the_time_of_each_estimator_stands_beside_its_errors():
    comparison = {name: runs.metrics(0.1) for name in ("lattice", "projection", "ambient")}
    page = numbers_section(
        runs.results(comparison=comparison, summary={"estimate_ms": {"lattice": 1.25, "pointar": 5}})
    )
    rows = re.findall(r"<tr>.*?</tr>", page)
    times = [re.findall(r'"time of an estimate"><span>(.*?)</span>', row) for row in rows[1:4]]
    assert times == [["1.25 ms"], [DASH], [DASH]]


def test_one_estimate_is_an_estimate():
    summary = {"n_active_frames": 4, "n_frames": 4, "n_estimates": 1, "n_unknown_lights": 0}
    summary |= {"rmse_against_ambient": {}, "object_pixels": None}
    whole = runs.content(summary=summary, settings={"network": None})
    assert format_summary(whole) == "4 of 4 frames, 1 estimate"
    off = {"name": "network", "state": "off", "reason": "chosen"}
    left_out = {"settings": whole["settings"] | {"network": "lte"}, "effects": [off]}
    assert format_summary(whole | left_out) == "4 of 4 frames, 1 estimate"


@pytest.mark.parametrize(
    ("pixels", "said"), [(None, ""), (0.0, ""), (0.3, "only 1 pixel of"), (99.4, "only 99 pixels of"), (100, "")]
)
def test_objects_of_few_pixels_are_said_to_be_too_small_to_judge_by(pixels, said):
    assert said in (too_small_to_judge(pixels) or "") and bool(said) == (too_small_to_judge(pixels) is not None)


def test_closeness_is_one_for_a_match_and_undefined_without_a_yardstick():
    errors = {"a": 0.0, "ambient": 0.5, "b": 1.0, "c": None}
    comparison = {method: from_json(Metrics, runs.metrics(rmse)) for method, rmse in errors.items()}
    assert [closeness(comparison, m) for m in ("a", "ambient", "b", "c", "d")] == [1.0, 0.0, -1.0, None, None]
    assert closeness({"b": comparison["b"], "ambient": comparison["a"]}, "b") is None
    assert format_closeness(-1.0) == f"{format_percent(1.0)} further"


def test_columns_of_frames_cover_the_axis_and_hold_their_centres():
    rng = np.random.default_rng(3)
    for n_frames in (1, 2, 3, 50):
        numbers = np.sort(rng.choice(500, n_frames, replace=False)).tolist()
        timeline = Timeline.of(runs.results(map(runs.frame, reversed(numbers))))
        edges, centres = timeline.edges_percent, timeline.centres_percent
        assert (edges[0], edges[-1]) == (0, pytest.approx(100)) and len(edges) == n_frames + 1
        assert all(a < c < b for a, c, b in zip(edges[:-1], centres, edges[1:], strict=True))
        assert np.ptp(np.diff(centres) / np.diff(numbers)) < 1e-9 if n_frames > 1 else centres == (50,)


@pytest.mark.parametrize(("low", "high"), [(-47, 47), (-3, 40), (0, 12), (-400, 40)])
def test_bars_of_a_budget_have_several_ticks(low, high):
    ticks = budget._axis(low, high).ticks
    assert len(ticks) >= 3 and 0 in ticks and all(low <= tick <= high for tick in ticks)


def luminance(colour: str) -> float:
    """Relative luminance of "#rrggbb", as WCAG 2 defines it."""
    encoded = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(first: str, second: str) -> float:
    dark, light = sorted(map(luminance, (first, second)))
    return (light + 0.05) / (dark + 0.05)


def test_text_and_lines_stand_out_in_light_and_dark():
    themes = [
        dict(re.findall(r"(--\w+): (#\w{6})", block))
        for block in re.findall(r":root \{(.*?)\}", STYLE.read_text(), re.S)
    ]
    assert len(themes) == 2
    for theme in themes:
        for ground in ("--paper", "--card"):
            assert all(contrast(theme[text], theme[ground]) >= 4.5 for text in ("--ink", "--quiet", "--accent"))
        assert all(contrast(theme[c], theme["--card"]) >= 3 for c in theme if re.fullmatch(r"--[kb]\d", c))
