"""From an open room, or a recording, to a lit object, and what an artist does then: a real Blender with a window."""

import numpy as np
import pytest
from blender_window import LONGEST_FREEZE_S, played

from addon_tests.pure.furnished import seen
from addon_tests.pure.recordings import looking
from xihenet.io.recording import SessionRecorder

pytestmark = pytest.mark.timeout(1200)
LONGEST_FOLLOW_S = 3.0
"""Six small frames: 0.3 s on a quiet machine, much of it for two draws of a view rendered in software."""

NO_BOXES = np.zeros((0, 2, 3))
KINDS = ("worlds", "images", "node_groups", "actions", "scenes", "meshes", "materials", "markers")


@pytest.fixture(scope="module")
def first_success(tmp_path_factory):
    return played("first_success", tmp_path_factory.mktemp("first_success"))


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
    assert facts["back"] == facts["back_by_menu"] == {"scene": "Scene", "shading": "SOLID", "floor": True}
    before, after = facts["from_aside"]
    assert before == after
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
    words, ball = first_success.facts["words_and_labels"]
    assert words[3] <= ball[1] or ball[3] <= words[1] or words[2] <= ball[0] or ball[2] <= words[0]
    assert first_success.facts["map_freeze_s"] < 2 * LONGEST_FREEZE_S


def test_the_comparison_is_shown_in_the_image_editor_that_is_open(first_success):
    assert first_success.facts["compared"] == ["Xihe Comparison"]
    assert first_success.facts["n_windows"] == 1


def test_the_comparison_begins_on_the_object(first_success):
    assert 0 < first_success.facts["wipe"] < 1 and first_success.facts["wipe"] != 0.5


def test_a_video_of_the_run_is_saved_by_a_click(first_success):
    facts = first_success.facts
    assert facts["saved"] == ["side_by_side.mp4"] and facts["saving"] == "saving the video"
    assert facts["save_freeze_s"] < 2 * LONGEST_FREEZE_S


def test_undo_takes_the_applied_light_back_and_redo_brings_it_again(first_success):
    facts = first_success.facts
    assert facts["undone"]["worlds"] == facts["before"]["worlds"] == []
    assert facts["undone"]["markers"] == facts["before"]["markers"]
    assert facts["redone"] == facts["after"]


def test_remove_leaves_nothing(first_success):
    assert first_success.facts["removed"] == first_success.facts["before"] == {kind: [] for kind in KINDS}


def test_undo_of_show_lit_and_remove_light_give_the_3d_view_back_and_redo_shows_the_light(first_success):
    before, lit, undone, redone, again, removed = first_success.facts["views"]
    assert lit == redone == ["Xihe Lit", "RENDERED", "CAMERA", False] != before
    assert undone == again == removed == before


@pytest.mark.parametrize("add_on", ["none", None], ids=["without the add-on", "with it again"])
def test_a_file_that_was_saved_with_results_opens(first_success, tmp_path, add_on):
    seen = played("look", tmp_path, blend=first_success.out / "saved.blend", add_on=add_on)
    assert "Xihe Ball" in seen.facts["worlds"]
    assert seen.facts["n_undefined_nodes"] == 0


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
