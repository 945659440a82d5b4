"""The tab, the preferences and what costs no run, in a real Blender with a window: each scenario once."""

import re
from pathlib import Path

import pytest
from blender_window import played

from addon_tests.real_blender.whole_blender import MODULE

ROOT = Path(__file__).resolve().parents[3]
CORNELL_BOX = ROOT / "blend_scenes" / "cornell_box.blend"
pytestmark = pytest.mark.timeout(1200)


@pytest.fixture(scope="module")
def calibrate(tmp_path_factory):
    """Of a user who has a folder of their own, which the next Blender finds again."""
    folder = tmp_path_factory.mktemp("calibrate")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BLENDER_USER_RESOURCES", str(folder / "user"))
        yield played("calibrate", folder)


def test_the_tab_draws_without_an_error_in_a_fresh_scene(tmp_path):
    assert played("look", tmp_path).facts["width"] > 0


@pytest.mark.parametrize("scenario", ["unfolded", "long_words"])
def test_all_of_the_tab_draws_without_an_error_in_a_room(tmp_path, scenario):
    played(scenario, tmp_path, blend=CORNELL_BOX)


def test_where_to_look_is_said_after_a_run_and_a_camera_does_it(tmp_path):
    facts = played("look_where", tmp_path).facts
    assert f"at frame {facts['frame']}" in facts["said"]
    assert facts["cameras"] == ["Phone", "Xihe Better Path"]


def test_the_time_of_a_run_is_measured_by_a_click_and_one_that_would_see_nothing_is_refused(tmp_path):
    facts = played("how_long", tmp_path).facts
    assert facts["refused"].startswith("No virtual object is in view") and not facts["unshown_run"]
    assert facts["said"].startswith("about ") and not facts["error"]


def test_enabling_and_disabling_ten_times_leaves_nothing_behind(tmp_path):
    seen = played("ten_times", tmp_path)
    enabled, disabled = seen.facts["enabled"], seen.facts["disabled"]
    assert seen.facts["enabled_again"] == enabled
    assert disabled["types"] == disabled["operators"] == []
    assert disabled["properties"] == [False, False]
    assert sum(disabled["handlers"].values()) < sum(enabled["handlers"].values())


def test_old_runs_are_removed_from_the_preferences_after_asking(blender, tmp_path, monkeypatch):
    monkeypatch.setenv("BLENDER_USER_RESOURCES", str(blender.user))
    seen = played("preferences", tmp_path, add_on=MODULE)
    assert len(seen.facts["kept_while_asking"]) == 3
    assert seen.facts["kept"] == seen.facts["kept_while_asking"][:1]


def test_the_tab_works_in_another_language_where_the_build_has_one(tmp_path):
    seen = played("other_language", tmp_path)
    assert seen.facts["language"] is None or seen.facts["virtual"] == 3


@pytest.mark.parametrize("way", ["stopped_with_escape", "stopped_with_button"])
def test_calibration_that_is_stopped_leaves_no_answer_and_the_scene_as_it_was(calibrate, way):
    facts = calibrate.facts[way]
    assert (facts["changed"], facts["new"], facts["error"]) == ({}, [], "")
    assert not facts["is_remembered"]


def test_calibration_shows_how_far_it_is_and_leaves_the_scene_as_it_was(calibrate):
    facts = calibrate.facts["left_alone"]
    assert (facts["changed"], facts["new"], facts["error"]) == ({}, [], "")
    shares, doing = zip(*facts["steps"], strict=True)
    assert len(shares) >= 2 and list(shares) == sorted(shares) and 0 < shares[-1] < 1
    assert "timing a few samples" in doing


def test_the_panel_says_what_the_presets_cost(calibrate):
    assert calibrate.facts["left_alone"]["is_remembered"]
    said = calibrate.facts["said"]
    costs = r"\S+ s at draft, \S+ s at balanced and \S+ s at accurate quality"
    assert re.fullmatch(rf"Capturing a frame of small_room took {costs}", said), said
    assert said in calibrate.facts["drawn"]


def test_the_next_blender_still_knows_what_the_presets_cost(calibrate, tmp_path):
    seen = played("calibrated_before", tmp_path, blend=calibrate.out / "small_room.blend")
    assert seen.facts["said"] == calibrate.facts["said"] in seen.facts["drawn"]
