"""What an artist does, in a real Blender with a window: each scenario once, then what it saw and left."""

import re
from pathlib import Path

import numpy as np
import pytest
from blender_window import run_in_window
from results_schema import without_times

from addon_tests.pure.furnished import seen
from addon_tests.pure.recordings import looking
from addon_tests.real_blender.whole_blender import MODULE
from xihenet.recording import SessionRecorder

ROOT = Path(__file__).resolve().parents[3]
pytestmark = pytest.mark.timeout(1200)
LONGEST_FREEZE_S = 0.6
"""Beside one plain draw of the window, which takes 0.1 s with OpenGL in software: twice what a quiet machine shows."""

LONGEST_FOLLOW_S = 3.0
"""Six small frames: 0.3 s on a quiet machine, much of it for two draws of a view rendered in software."""

NO_BOXES = np.zeros((0, 2, 3))
CORNELL_BOX = ROOT / "blend_scenes" / "cornell_box.blend"
LOWEST_PRIORITY = 19
KINDS = ("worlds", "images", "node_groups", "actions", "scenes", "meshes", "materials", "markers")


def played(scenario, out, **options):
    """What a scenario saw that came to its end without an error."""
    seen = run_in_window(scenario, out, **options)
    assert (seen.code, seen.complaints) == (0, []), seen.console
    return seen


@pytest.fixture(scope="module")
def first_success(tmp_path_factory):
    return played("first_success", tmp_path_factory.mktemp("first_success"))


@pytest.fixture(scope="module")
def cancel(tmp_path_factory):
    return played("cancel", tmp_path_factory.mktemp("cancel"))


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


def test_a_recording_becomes_a_lit_object_over_its_pictures(tmp_path, monkeypatch):
    session = SessionRecorder(tmp_path / "session")
    for number, azimuth in enumerate(np.linspace(-0.3, 0.3, 3), start=1):
        session.record(seen(looking(azimuth, -0.6, (-1.0, 0.0, 1.4)), NO_BOXES, number))
    monkeypatch.setenv("XIHE_RECORDING", str(session.folder))
    monkeypatch.setenv("XIHE_AT", "0.9,0.0,0.3")
    facts = played("phone_capture", tmp_path / "out").facts
    assert facts["imported"] == ["FINISHED"] and facts["error"] == ""
    assert facts["objects"] == ["Phone", "Phone Scan", "Xihe looked here first"]
    assert facts["stands_on"] == pytest.approx([0.9, 0.0, 0.0], abs=0.02)
    assert {"composited.mp4", "report.html", "results.json", "session.json"} <= set(facts["left"])
    assert facts["lit_scene"] == "Xihe Lit"


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


def test_a_few_clicks_lead_from_an_open_room_to_a_lit_object(first_success):
    facts = first_success.facts
    assert facts["virtual"] == ["Ball"]
    assert facts["under_way"]["doing"]
    assert facts["error"] == ""
    assert facts["after"]["worlds"] == ["Xihe Ball"]
    shown = {"scene": "Xihe Lit", "world": "Xihe Ball", "shading": "RENDERED", "view": "CAMERA", "floor": False}
    colours = facts["lit"].pop("colours")
    assert facts["lit"] == shown
    for on_screen, in_picture in colours.values():
        assert on_screen == pytest.approx(in_picture, abs=0.1), "the captured frame, and the ball under its light"
    assert facts["back"] == {"scene": "Scene", "shading": "SOLID", "floor": True}
    assert {"Xihe Comparison", "Xihe Light Ball"} <= set(facts["after"]["images"])
    assert any(name.startswith("Xihe trigger") for name in facts["after"]["markers"])
    assert facts["after"]["scenes"] == []


def test_light_follows_an_object_that_is_moved(first_success):
    ((coverage, expected_error),) = first_success.facts["live"].values()
    assert 0 < coverage < 1 and expected_error > 0
    assert first_success.facts["followed_s"] < LONGEST_FOLLOW_S


def test_the_map_shows_the_place_under_the_mouse_and_is_made_without_a_freeze(first_success):
    found, wanted = first_success.facts["under_mouse"]
    assert found == wanted
    assert first_success.facts["map_freeze_s"] < 2 * LONGEST_FREEZE_S


def test_the_comparison_is_shown_in_the_image_editor_that_is_open(first_success):
    assert first_success.facts["compared"] == ["Xihe Comparison"]
    assert first_success.facts["n_windows"] == 1


def test_the_comparison_begins_on_the_object(first_success):
    assert 0 < first_success.facts["wipe"] < 1 and first_success.facts["wipe"] != 0.5


def test_a_video_of_the_run_is_saved_by_a_click(first_success):
    assert first_success.facts["saved"] == ["side_by_side.mp4"]


def test_undo_takes_the_applied_light_back_and_redo_brings_it_again(first_success):
    facts = first_success.facts
    assert facts["undone"]["worlds"] == facts["before"]["worlds"] == []
    assert facts["undone"]["markers"] == facts["before"]["markers"]
    assert facts["redone"] == facts["after"]


def test_remove_leaves_nothing(first_success):
    assert first_success.facts["removed"] == first_success.facts["before"] == {kind: [] for kind in KINDS}


@pytest.mark.parametrize("add_on", ["none", None], ids=["without the add-on", "with it again"])
def test_a_file_that_was_saved_with_results_opens(first_success, tmp_path, add_on):
    seen = played("look", tmp_path, blend=first_success.out / "saved.blend", add_on=add_on)
    assert "Xihe Ball" in seen.facts["worlds"]
    assert seen.facts["n_undefined_nodes"] == 0


@pytest.fixture(scope="module")
def free_window(tmp_path_factory):
    return run_in_window("free_window", tmp_path_factory.mktemp("free_window"))


def test_the_window_stays_free_during_a_run(free_window):
    assert (free_window.code, free_window.complaints) == (0, []), free_window.console
    assert free_window.facts["is_free"] and free_window.facts["niceness"] == LOWEST_PRIORITY
    assert free_window.facts["longest_s"] < LONGEST_FREEZE_S + free_window.facts["draw_s"]


@pytest.mark.parametrize("way", ["edited", "found_again", "resumed"])
def test_a_run_that_is_disturbed_has_the_results_of_one_that_is_not(free_window, way):
    disturbed, undisturbed = free_window.facts[way], free_window.facts["undisturbed"]
    assert disturbed["error"] == undisturbed["error"] == ""
    assert without_times(disturbed["results"]) == without_times(undisturbed["results"])


def test_undo_during_a_run_takes_an_edit_back(free_window):
    assert free_window.facts["undone"]


def test_the_panel_says_that_the_scene_was_changed_during_the_run(free_window):
    assert re.fullmatch(r"\d\d:\d\d", free_window.facts["edited"]["made_of"])


def test_a_run_goes_on_while_another_file_is_open_and_is_found_again(free_window):
    facts = free_window.facts
    assert facts["goes_on"] and facts["said_elsewhere"] == "" and facts["found"] and facts["found_when_enabled"]
    assert facts["found_again"]["same"] and facts["left"] == ""


def test_a_stopped_run_resumes_or_is_discarded(free_window):
    facts = free_window.facts
    assert facts["stopped"] == {"is_locked": False, "progress": 0.0, "has_ended": False}
    assert facts["resumed"]["same"] and facts["discarded"]


@pytest.mark.parametrize("way", ["stopped_with_escape", "stopped_with_button"])
def test_a_run_that_is_cancelled_leaves_nothing_in_the_file(cancel, way):
    assert cancel.facts[way]["same"], cancel.facts[way]


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
    assert re.fullmatch(r"draft \S+ s, balanced \S+ s, accurate \S+ s a frame, measured on small_room", said), said
    assert said in calibrate.facts["drawn"]


def test_the_next_blender_still_knows_what_the_presets_cost(calibrate, tmp_path):
    seen = played("calibrated_before", tmp_path, blend=calibrate.out / "small_room.blend")
    assert seen.facts["said"] == calibrate.facts["said"] in seen.facts["drawn"]
