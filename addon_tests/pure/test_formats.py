"""Numbers as text, and as places in a plot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from xihe_blender.cli.arguments import files, names
from xihenet import svg
from xihenet.formats import (
    as_spelled,
    format_bytes,
    format_count,
    format_duration,
    format_list,
    format_milliseconds,
    format_names,
    format_number,
    format_percent,
    format_position,
    format_runs,
    format_setting,
    format_signed,
)
from xihenet.svg import linear_axis, log_axis


def test_numbers_keep_their_value_when_they_become_text():
    rng = np.random.default_rng(7)
    for value in [*(10.0 ** rng.uniform(-12, 12, 200)), *(-(10.0 ** rng.uniform(-3, 3, 50))), 0.09996, 99.96, 0.0]:
        text = format_number(value).replace(",", "")
        assert float(text.replace("\N{MINUS SIGN}", "-")) == pytest.approx(value, rel=6e-3)
        assert text.startswith("\N{MINUS SIGN}") == (value < 0) and not text.startswith("-")
    assert (format_number(None), format_percent(None)) == ("\N{EN DASH}", "\N{EN DASH}")
    assert format_percent(0.31) == "31 %" and format_percent(0.004) == "0.4 %"
    assert format_percent(-0.31) == "\N{MINUS SIGN}31 %" and format_percent(-0.31, 1) == "\N{MINUS SIGN}31 %"
    assert format_position((0.5, -1.204, 2)) == "0.50, \N{MINUS SIGN}1.20, 2.00"
    assert format_position((-0.001, 0, -0.0)) == "0.00, 0.00, 0.00" and format_percent(-0.0004) == "0.0 %"
    assert format_runs([1, 2, 4, 5, 6, 9]) == "1, 2, 4\N{EN DASH}6, 9"


@pytest.mark.parametrize("digits", [1, 2, 3, 5])
def test_a_number_has_as_many_digits_whether_or_not_it_is_rounded_up_to_a_power_of_ten(digits):
    for exponent in (*range(-9, digits), 9):  # Above, whole numbers keep all of their digits.
        power = 10.0**exponent
        assert format_number(power * (1 - 10.0**-digits / 3), digits) == format_number(power, digits)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min"),
        (83, "1 min 23 s"),
        (600, "10 min"),
        (3599, "1 h"),
        (7500, "2 h 5 min"),
    ],
)
def test_a_time_to_wait_is_rounded(seconds, words):
    assert format_duration(seconds) == words


def test_amounts_have_their_units_and_nouns():
    assert [format_bytes(n) for n in (None, 0, 999, 1500, 2_340_000, 5e9)] == [
        "\N{EN DASH}", "0 bytes", "999 bytes", "1.50 kB", "2.34 MB", "5.00 GB",
    ]  # fmt: skip
    times_ms = (0.05, 4.1234, 999.4, 999.6, 1349, 12_600, 99_700, 128_400, 4e6)
    assert [format_milliseconds(time_ms) for time_ms in times_ms] == [
        "0.05 ms", "4.12 ms", "999 ms", "1 s", "1.3 s", "13 s", "100 s", "128 s", "4,000 s",
    ]  # fmt: skip
    assert format_percent(0.411, 2) == "41 %"
    assert [format_count(n, "frame") for n in (0, 1, 2)] == ["no frames", "1 frame", "2 frames"]
    assert format_list(["a", "b", "c"]) == "a, b and c" and format_list([]) == ""
    assert [format_setting(value) for value in (True, 8e6, 0.0019, "word")] == ["on", "8,000,000", "0.0019", "word"]
    assert [format_signed(value) for value in (0.0214, -3.0, 0)] == ["+0.021", "\N{MINUS SIGN}3.0", "0"]


def test_an_axis_covers_its_values_in_a_few_round_steps():
    for largest in [0.0, 5e-324, 1e-9, 0.049, 0.1, 0.2, 0.3, 1, 7, 8, 1234.5, 9.99e8]:
        axis = linear_axis(0, largest)
        assert axis.ticks[0] == 0 and axis.ticks[-1] == axis.high
        assert axis.high >= largest * (1 - 1e-9) and 2 <= len(axis.ticks) <= 6
        assert axis.y(0) > axis.y(axis.high) == 0
        assert len({axis.label(tick) for tick in axis.ticks}) == len(axis.ticks)


@given(st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=5))
def test_a_logarithmic_axis_holds_its_values_and_has_ticks_in_order(values):
    axis = log_axis(values, str)
    assert all(0 < axis.share(value) < 1 for value in values)
    places = [axis.share(tick) for tick in axis.ticks]
    assert places == sorted(places) and len(set(places)) == len(places) > 0


def test_a_line_has_a_gap_where_there_is_no_point():
    assert svg.line([], "s0") == svg.line([None], "s0") == ""
    assert 'd="M0.00 1.00L100.00 2.00M300.00 3.00"' in svg.line([(0, 1), (10, 2), None, (30, 3)], "s0")
    assert "&lt;b&gt;" in svg.dot(1, 2, "s0", "<b>")


@given(st.lists(st.text(min_size=1)))
def test_names_are_told_as_they_can_be_typed_again(found):
    assert names(format_names(found)) == tuple(found)


def test_names_that_are_typed_need_quotes_only_for_commas_and_spaces_at_their_ends():
    assert names(' Cup,, Chair "oak", 2" pipe , "Chair, oak"," lead ",') == (
        "Cup", 'Chair "oak"', '2" pipe', "Chair, oak", " lead ",
    )  # fmt: skip


def test_files_may_be_given_as_a_pattern_where_the_shell_leaves_it_as_it_is(tmp_path):
    made = [tmp_path / name for name in ("hall.blend", "room.blend", "[h]all.blend")]
    for path in made:
        path.touch()
    none = tmp_path / "*.usd"
    assert files([tmp_path / "[hr]*.blend", made[2], none]) == [*made, none]


def test_a_name_is_found_in_either_spelling_of_its_accents():
    one_sign, two_signs = "Caf\N{LATIN SMALL LETTER E WITH ACUTE}", "Cafe\N{COMBINING ACUTE ACCENT}"
    assert as_spelled([one_sign, "Nobody"], [two_signs, "Ball"]) == [two_signs, "Nobody"]
    assert as_spelled([two_signs], [one_sign]) == [one_sign]
    assert as_spelled([one_sign, two_signs], [two_signs, one_sign]) == [one_sign, two_signs]
