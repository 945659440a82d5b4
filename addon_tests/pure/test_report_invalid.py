"""The report's table of what was invalid, and why."""

import re

from hypothesis import given, settings
from hypothesis import strategies as st

from addon_tests.pure import runs
from xihe_blender.report.invalid import HEAD, invalid_otherwise, invalid_rows
from xihe_blender.report.plots import plots_section
from xihe_blender.report.tables import numbers_section
from xihenet.invalid import CLAMPED, LEFT_OUT, UNKNOWN

KINDS = ("pixels", "points", "lights", "metrics", "hues")
TITLE = ">What was invalid, and why<"


def frame(number, *, is_valid=True, reason=None, source=None, name="Ball"):
    return runs.frame(number, runs.probe(name, is_valid=is_valid, unknown_because=reason, light_frame=source))


def results(frames=(), n_followed=0, **counts):
    invalid = {kind: {} for kind in KINDS} | counts
    return runs.results(frames, summary={"invalid": invalid, "n_followed_anchors": n_followed})


def test_where_all_was_sound_one_line_says_so_and_there_is_no_table():
    sound = results([frame(1)])
    assert invalid_rows(sound) == []
    assert invalid_otherwise(sound.summary.invalid).endswith("Nothing was invalid.")
    page = numbers_section(sound)
    assert TITLE in page and "no value was clamped" in page


def test_each_reason_has_a_row_with_its_share_and_what_became_of_it():
    counts = {"no_surface": 25, "range": 10, "colour_not_finite": 1, "negative_colour": 5}
    rows = invalid_rows(results([frame(1), frame(2)], pixels=counts, points={**counts, "at_probe": 3}))
    shares = [re.sub(r"\s", " ", row[1]) for row in rows]
    assert shares == ["25 (12 %)", "10 (5.0 %)", "1 (0.5 %)", "5 (2.5 %)", "3"]
    assert [row[3] for row in rows] == [
        "light from far away", "light from far away", "gave no point", "used after clamping",
        "left out at that position",
    ]  # fmt: skip
    assert "<code>range</code>" in rows[1][2] and "no direction" in rows[4][2]


def test_a_light_that_was_kept_is_named_with_its_frames_and_its_source():
    blind = {"is_valid": False, "reason": "nothing_seen"}
    frames = [frame(1, **blind), frame(2), frame(3, **blind, source=2), frame(4, **blind, source=2)]
    (row,) = invalid_rows(results(frames, lights={"nothing_seen": 3}))
    assert row[0] == "light at Ball" and row[1] == "frames 1, 3, 4"
    assert row[3] == "the ambient light was used instead and the light of frame 2 was kept"
    plots = plots_section(results(frames))
    assert plots.count("last light kept: no surface was seen from there") >= 3
    assert "light unknown: the last estimate is kept" in plots


def test_directions_that_followed_a_change_of_the_light_are_told_as_a_guess():
    (row,) = invalid_rows(results([frame(1)], n_followed=1234))
    assert row[0] == "directions around positions" and row[1] == "1,234" and "a guess" in row[3]


words = st.sampled_from([*LEFT_OUT, *CLAMPED, *UNKNOWN, "dark_dropout", "<b>", ""])
counts = st.dictionaries(words, st.integers(0, 10**12), max_size=4)
kept = st.builds(
    frame, st.integers(-5, 5), is_valid=st.booleans(), reason=st.one_of(st.none(), words),
    source=st.one_of(st.none(), st.integers()), name=words,
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(invalid=st.dictionaries(st.sampled_from(KINDS), counts), frames=st.lists(kept, max_size=4))
def test_whatever_results_hold_the_page_shows_words(invalid, frames):
    given_results = results(frames, **invalid)
    assert all(len(row) == len(HEAD) for row in invalid_rows(given_results))
    page = numbers_section(given_results) + plots_section(given_results)
    assert TITLE in page
    assert "<b>:" not in page and not re.search(r"\b(None|nan|inf)\b", re.sub("<[^>]*>", " ", page))
