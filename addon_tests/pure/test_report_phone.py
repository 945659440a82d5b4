"""The report's table of what a phone does to the light, whatever of it could not be measured."""

import pytest

from addon_tests.pure import runs
from xihe_blender.report.tables import format_phone, numbers_section, phone_rows
from xihenet.formats import MINUS


def results(**changes):
    errors = {
        "all_on": 0.2,
        "perfect": 0.16,
        "without": {"noise": 0.21, "frame_rate": None, "range": 0.16, "glossy_dropout": 0.20001},
    }
    phone = {"name": "A <phone>", "summary": "of 2026", "shc_rmse": errors}
    given = {"settings": {"network": "lte"}, "phone": phone, "summary": {"mean_latency_ms": 81.0, "n_lost": 2}}
    return runs.results(**given | changes)


def test_each_effect_that_is_on_has_a_row_with_what_it_adds():
    noise, rate, cut, mirrors, everything = phone_rows(results().phone)
    assert mirrors[3] == "nothing"
    assert noise[1:3] == ["0.2000", "0.2100"] and noise[3].startswith(f"{MINUS}0.0100") and "less" in noise[3]
    assert cut[3].startswith("+0.0400") and "25" in cut[3] and "more" in cut[3]
    assert rate[2:] == ["\N{EN DASH}"] * 2
    assert everything[0] == "all of them" and everything[2] == "0.1600"


def test_the_session_is_told_in_words_and_escaped():
    words = format_phone(results())
    assert "A &lt;phone&gt;" in words and "<code>lte</code>" in words and "81.0" in words and "2 were lost" in words
    left_out = [{"name": "network", "state": "off", "reason": "nothing changes", "parameters": {}, "origin": "auto"}]
    assert "lte" not in format_phone(results(effects=left_out))


@pytest.mark.parametrize(
    "changes",
    [
        {"phone": {"name": "Perfect", "summary": "s", "shc_rmse": None}},
        {"summary": {"mean_latency_ms": None, "n_lost": 0}},
        {"settings": {"network": None}},
        {"phone": {"name": "P", "summary": "s", "shc_rmse": {"all_on": None, "perfect": None, "without": {"a": None}}}},
    ],
)
def test_what_is_not_known_is_no_error(changes):
    page = numbers_section(results(**changes))
    assert "None" not in page and "nan" not in page
