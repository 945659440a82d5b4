"""The error budget from the panel: its button gives what the library gives, and its bars say what budget.json says."""

from dataclasses import replace
from pathlib import Path

import bpy
import pytest
from addon_runs import registered_addon, small_panel_runs, walk_for_the_panel
from previs_runs import SMALL

from xihe_blender.addon.error_budget import budget_rows, shown_object
from xihe_blender.addon.runs_folder import last_budget, shown_runs
from xihe_blender.io.budget_results import PARTS, BudgetPart, ObjectBudget
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.error_budget import error_budget
from xihe_blender.report.budget import _of_object


@pytest.fixture(autouse=True)
def addon():
    with registered_addon(), small_panel_runs():
        yield


@pytest.mark.slow
def test_the_button_brings_what_the_function_measures_and_the_panel_shows_the_active_object(tmp_path, monkeypatch):
    # More seeds and moments, which take as many times as long, are tested in `test_error_budget`.
    for name in ("n_seeds", "n_moments"):
        monkeypatch.setitem(error_budget.__kwdefaults__, name, 1)
    scene = walk_for_the_panel(tmp_path / "runs", use_own_frames=True, frame_start=4, frame_end=4)
    assert last_budget(scene.xihe.budget_folder) is None
    assert bpy.ops.xihe.measure_budget() == {"FINISHED"}
    folder = Path(scene.xihe.budget_folder)
    assert folder.parent == tmp_path / "runs" and (folder / "report.html").is_file() and folder in shown_runs()
    job = error_budget(scene, tmp_path / "function", replace(SMALL, frames=(4,)))
    shown, by_function = last_budget(str(folder)), run_blocking(job)
    assert shown.objects == by_function.objects and shown.exposure == by_function.exposure
    assert {item.name for item in shown.objects} == {"Ball", "Board"}
    assert shown_object(shown, "Board").name == "Board" and shown_object(shown, "Room") == shown.objects[0]


def test_a_budget_that_cannot_be_measured_leaves_no_folder(tmp_path):
    scene = walk_for_the_panel(tmp_path / "runs", estimator="truth")
    with pytest.raises(RuntimeError, match="choose another"):
        bpy.ops.xihe.measure_budget()
    assert scene.xihe.budget_folder == "" and list((tmp_path / "runs").iterdir()) == []


def test_bars_are_shares_of_the_error_and_the_largest_comes_first():
    item = item_of(clipping=0.3, network=-0.1, order_2=0.1)
    not_simulated = BudgetPart(name="delay", state="not simulated", error=0.5, gain=0.0)
    item = replace(item, parts=(*item.parts, not_simulated))
    labels = [PARTS[name].label for name in ("clipping", "order_2", "network")]
    assert budget_rows(item) == list(zip(labels, [0.6, 0.2, 0.0], ["60% off", "20% off", "20% more"], strict=True))
    assert PARTS["clipping"].perfect in item.advice and "from 50 % to 20 %" in item.advice


def item_of(**gains):
    """A ball with an error of 0.5 of its brightness; of each part the gain, or its interval."""
    parts = []
    for name, of in gains.items():
        interval = of if isinstance(of, tuple) else None
        gain = sum(interval) / 2 if interval else of
        parts.append(BudgetPart(name=name, state="measured", error=0.5 - gain, gain=gain, interval=interval))
    return ObjectBudget(name="Ball", moments=(1,), brightness=1.0, error=0.5, parts=tuple(parts))


def test_parts_whose_intervals_overlap_are_named_together():
    item = item_of(field_of_view=(0.10, 0.20), coverage=(0.15, 0.27), clipping=(0.02, 0.09))
    assert [part.name for part in item.best] == ["coverage", "field_of_view"]
    assert PARTS["coverage"].perfect in item.advice and PARTS["field_of_view"].perfect in item.advice
    assert "from 50 % to 29 % or 35 % of" in item.advice and "Which of them helps more is not certain" in item.advice
    assert PARTS["clipping"].perfect not in item.advice


def test_a_part_that_may_help_or_harm_has_no_place_in_the_order():
    item = item_of(network=(-0.1, 0.3), order_2=(0.05, 0.09), sampling=(-0.03, -0.01))
    assert [part.name for part in item.largest_first] == ["order_2", "sampling", "network"]
    assert [part.name for part in item.best] == ["order_2"]
    assert "Whether network would help more is not certain" in item.advice
    assert budget_rows(item)[-1] == (PARTS["network"].label, 0.0, "not certain")
    three = item_of(order_2=(0.05, 0.09), network=(-0.1, 0.3), coverage=(-0.1, 0.3), sampling=(-0.1, 0.3)).advice
    assert "Whether network, coverage or sampling would help more" in three
    assert item_of(network=(-0.1, 0.3)).advice.startswith("No single part would surely help Ball much")
    assert item_of(network=(-0.1, 0.01)).advice.startswith("No single part would help Ball much")


def test_an_object_that_nothing_would_help_is_told():
    assert item_of(network=0.001).advice.startswith("No single part would help Ball much")
    assert "never in view" in ObjectBudget(name="Ball", moments=()).advice


def test_an_object_in_the_dark_is_told_so_and_has_no_bars():
    item = replace(item_of(network=(0.0, 0.0)), brightness=0.0, error=0.0)
    assert item.advice == "No light reaches Ball, so that its light has no error to divide."
    assert budget_rows(item) == [] and _of_object(item) == f"<p>{item.advice}</p>"
