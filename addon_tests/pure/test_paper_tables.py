"""The page of the evaluation: figures stand in tables by the halves of their names, each once."""

import random

import pytest

from xihe_blender.lab.paper.records import Row
from xihe_blender.lab.paper.tables import arranged, table_lines


def row(what, value=1.0, unit="ms", n=3, work="same work", paper=None):
    return Row(what, unit, value, value - 0.5, value + 0.5, n, work, "Alike.", paper, "calls")


def cells_of(one):
    return [one.what, f"{one.value:g} {one.unit}", "", f"{one.n} {one.cases}", "", one.work]


def page(*rows):
    return list(table_lines(rows, cells_of))


def test_names_that_share_both_halves_are_a_table_and_the_rest_a_list():
    rows = [row(f"{place}: {what}", k) for k, place in enumerate(("hall", "attic")) for what in ("mean", "worst")]
    lines = page(*rows, row("all rooms together", 7.0))
    assert lines[0] == "*ms, 3 calls, same work*" and lines[2] == "| | mean | worst |"
    assert lines[4] == "| hall | 0 (-0.500 to 0.500) | 0 (-0.500 to 0.500) |"
    assert lines[-2] == "| all rooms together | 7 ms |  | 3 calls |  | same work |"


def test_what_only_one_half_shares_stands_with_it_and_what_nothing_shares_in_the_cell():
    made = [row("a, time", 1.0), row("b, time", 2.0, n=9), row("a, size", 3.0, "bytes"), row("b, size", 4.0, "bytes")]
    made[3] = row("b, size", 4.0, "bytes", n=9, work="other data", paper=5.0)
    text = "\n".join(page(*made))
    assert "| | time (ms, same work) | size (bytes) |" in text and "| b (9 calls) |" in text
    assert "4.00 (3.50 to 4.50; paper 5.00; other data)" in text


def test_names_are_cut_at_the_first_sign_where_the_last_brings_nothing_together():
    grids, listed = arranged([row(f"{net}, {k} positions, median") for net in ("wifi", "lte") for k in (1, 2, 4)])
    assert [grid.down for grid in grids] == [("wifi", "lte")] and not listed


def test_signs_in_brackets_cut_no_name():
    grids, listed = arranged([row(f"{net} (ours, {net}): {what}") for net in "abc" for what in ("mean", "worst")])
    assert grids[0].down == ("a (ours, a)", "b (ours, b)", "c (ours, c)") and not listed


@pytest.mark.parametrize("seed", range(20))
def test_no_figure_is_lost_or_shown_twice(seed):
    rng = random.Random(seed)
    names = {"".join(rng.choice("ab") + rng.choice((", ", ": ", "")) for _ in range(4)) + "end" for _ in range(30)}
    rows = [row(name, float(k)) for k, name in enumerate(sorted(names))]
    grids, listed = arranged(rows)
    shown = [*listed, *(one for grid in grids for one in grid.cells.values())]
    assert sorted(one.what for one in shown) == sorted(names)
    for grid in grids:
        assert all(one.what in (f"{head}, {tail}", f"{head}: {tail}") for (head, tail), one in grid.cells.items())
