"""The page of the evaluation: a figure stands in a table by the two parts of its name, or in a list, and once."""

import random

import pytest

from xihe_blender.lab.paper.records import Row
from xihe_blender.lab.paper.report import table_lines, tables_of
from xihenet.formats import MINUS


def row(what, value=1.0, unit="ms", n=3, work="same work", paper=None):
    return Row(what, unit, value, value - 0.5, value + 0.5, n, work, "Alike.", paper, "calls")


def cells_of(one):
    return [one.what, f"{one.value:g} {one.unit}", "", f"{one.n} {one.cases}", "", one.work]


def page(*rows):
    return list(table_lines(rows, cells_of))


def test_names_with_a_colon_are_a_table_and_the_rest_a_list():
    rows = [row(f"{place}: {what}", k) for k, place in enumerate(("hall", "attic")) for what in ("mean", "worst")]
    lines = page(*rows, row("all rooms together", 7.0))
    assert lines[0] == "*ms, 3 calls, same work*" and lines[2] == "| | mean | worst |"
    assert lines[4] == f"| hall | 0 ({MINUS}0.500 to 0.500) | 0 ({MINUS}0.500 to 0.500) |"
    assert lines[-2] == "| all rooms together | 7 ms |  | 3 calls |  | same work |"


def test_what_only_one_half_shares_stands_with_it_and_what_nothing_shares_in_the_cell():
    made = [row("a: time", 1.0), row("b: time", 2.0, n=9), row("a: size", 3.0, "bytes"), row("b: size", 4.0, "bytes")]
    made[3] = row("b: size", 4.0, "bytes", n=9, work="other data", paper=5.0)
    text = "\n".join(page(*made))
    assert "| | time (ms, same work) | size (bytes) |" in text and "| b (9 calls) |" in text
    assert "4.00 (3.50 to 4.50; paper 5.00; other data)" in text


def test_what_a_line_shares_is_said_where_one_of_its_columns_alone_says_it():
    made = [row(f"{net}: {what}", work="same work") for net in ("wifi", "lte") for what in ("median", "ratio")]
    made += [row("loopback: median", work="other machine"), row("loopback: ratio")]
    lines = page(*made)
    assert "| | median | ratio (same work) |" in lines and "| wifi (same work) |" in "\n".join(lines)
    assert "| loopback | 1.00 (0.500 to 1.50; other machine) | 1.00 (0.500 to 1.50) |" in lines


def test_a_line_without_a_column_has_an_empty_cell_and_lines_of_other_columns_are_another_table():
    lines = page(row("a: time"), row("a: size"), row("b: size"), row("c: share"))
    assert lines[2] == "| | time | size |" and lines[5] == "| b |  | 1.00 (0.500 to 1.50) |"
    assert lines[9] == "| | share |"


def test_a_name_is_cut_at_its_last_colon():
    assert tables_of([row("ours: none of it: over random")]) == [
        {"ours: none of it": {"over random": row("ours: none of it: over random")}}
    ]


@pytest.mark.parametrize("seed", range(20))
def test_no_figure_is_lost_or_shown_twice(seed):
    rng = random.Random(seed)
    names = {"".join(rng.choice("ab") + rng.choice((", ", ": ", "")) for _ in range(4)) + "end" for _ in range(30)}
    rows = [row(name, float(k)) for k, name in enumerate(sorted(names))]
    lines = [(line, cells) for table in tables_of(rows) for line, cells in table.items()]
    shown = [f"{line}: {column}" for line, cells in lines for column in cells]
    assert sorted(shown) == sorted(name for name in names if ": " in name)
    assert all(one.what == f"{line}: {column}" for line, cells in lines for column, one in cells.items())
    text = "\n".join(page(*rows))
    assert all(text.count(f" {one.value:g} {one.unit} ") == 1 for one in rows if ": " not in one.what)
