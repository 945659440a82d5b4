"""What goes on beside a run, in a real Blender with a window: edits, Undo, another file, Cancel."""

import re

import pytest
from blender_window import LONGEST_FREEZE_S, played, run_in_window
from results_schema import without_times

pytestmark = pytest.mark.timeout(1200)
LOWEST_PRIORITY = 19


@pytest.fixture(scope="module")
def cancel(tmp_path_factory):
    return played("cancel", tmp_path_factory.mktemp("cancel"))


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
    assert facts["resumed"]["same"] and facts["kept_while_asking"] and facts["discarded"]


def test_escape_during_playback_stops_only_that(cancel):
    assert cancel.facts["after_playback"] == {"plays": False, "runs": True}


@pytest.mark.parametrize("way", ["stopped_with_escape", "stopped_with_button"])
def test_a_run_that_is_cancelled_leaves_nothing_in_the_file(cancel, way):
    assert cancel.facts[way]["same"], cancel.facts[way]
