"""Tables of the documentation's page: figures whose names share their words stand in one table, not in a row each.

A row is named "wifi, 2 positions, median" or "float32: mean time". Its name is cut in two, at the last comma or colon
or, where that brings nothing together, at the first; rows that share both halves with others are the cells of a table
with one half down and the other across. What is left over is listed. Nothing is dropped: a cell has the figure, its
interval and the paper's figure, and what all cells share (unit, cases, how they compare) is said once above them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from xihe_blender.lab.paper.records import Row
from xihenet.formats import format_number

LIST_HEAD = ("what", "ours", "95 % interval", "cases", "the paper", "work")
LEAST_FILLED = 0.6
LEAST_DOWN = 3
"""Names in a table of one column, or it is a list."""

Cells = dict[tuple[str, str], Row]


@dataclass(frozen=True)
class Grid:
    """Rows by the two halves of their names, those that are `down` first."""

    down: tuple[str, ...]
    across: tuple[str, ...]
    cells: Cells


def table_lines(rows: Sequence[Row], list_cells: Callable[[Row], Sequence[str]]) -> Iterator[str]:
    """Markdown of all rows; `list_cells` are those of one that is listed, as in LIST_HEAD."""
    grids, listed = arranged(rows)
    for grid in grids:
        yield from _grid_lines(grid)
        yield ""
    if listed:
        yield from (f"| {' | '.join(LIST_HEAD)} |", "| --- " * len(LIST_HEAD) + "|")
        yield from (f"| {' | '.join(list_cells(row))} |" for row in listed)
        yield ""


def arranged(rows: Sequence[Row]) -> tuple[list[Grid], list[Row]]:
    """Tables in the order of their first rows, and the rows that belong to none."""
    grids: list[Grid] = []
    left = list(rows)
    for is_last, n_across in ((True, 2), (False, 2), (True, 1)):
        for grid in _grids(left, is_last):
            if len(grid.across) >= n_across and len(grid.down) >= (2 if n_across > 1 else LEAST_DOWN):
                grids.append(grid)
                left = [row for row in left if row not in grid.cells.values()]
    place = {row.what: number for number, row in enumerate(rows)}
    return sorted(grids, key=lambda grid: min(place[row.what] for row in grid.cells.values())), left


def _grids(rows: Sequence[Row], is_last: bool) -> list[Grid]:
    """Of names that are cut at the last sign, or at the first: those with the same second halves, or some of them."""
    halves: dict[str, dict[str, Row]] = {}
    for row in rows:
        signs = list(re.finditer(r"[,:] (?![^(]*\))", row.what))
        if signs:
            sign = signs[-1 if is_last else 0]
            halves.setdefault(row.what[: sign.start()], {})[row.what[sign.end() :]] = row
    grids: list[tuple[list[str], list[str]]] = []
    for head, tails in sorted(halves.items(), key=lambda item: -len(item[1])):
        for heads, across in grids:
            if tails.keys() <= set(across) and len(tails) >= LEAST_FILLED * len(across):
                heads.append(head)
                break
        else:
            grids.append(([head], list(tails)))
    order = list(halves)
    return [
        Grid(
            tuple(sorted(heads, key=order.index)),
            tuple(across),
            {(head, tail): halves[head][tail] for head in heads for tail in across if tail in halves[head]},
        )
        for heads, across in grids
    ]


def _grid_lines(grid: Grid) -> Iterator[str]:
    shared = _same(grid.cells.values())
    of_tail = {tail: _same(row for (_, t), row in grid.cells.items() if t == tail) for tail in grid.across}
    of_head = {head: _same(row for (h, _), row in grid.cells.items() if h == head) for head in grid.down}
    cells = {(head, tail): _cell(row, of_head[head] + of_tail[tail]) for (head, tail), row in grid.cells.items()}
    in_tails = [fact for facts in of_tail.values() for fact in facts]
    down = {head: _named(head, facts, in_tails) for head, facts in of_head.items()}
    across = {tail: _named(tail, facts, shared) for tail, facts in of_tail.items()}
    if len(down) < len(across):
        down, across = across, down
        cells = {(tail, head): cell for (head, tail), cell in cells.items()}
    yield from (f"*{', '.join(shared)}*", "") if shared else ()
    yield f"| | {' | '.join(across.values())} |"
    yield "| --- " * (1 + len(across)) + "|"
    yield from (
        f"| {words} | {' | '.join(cells.get((name, of), '') for of in across)} |" for name, words in down.items()
    )


def _named(half: str, facts: Sequence[str], said: Sequence[str]) -> str:
    """Half a name with the facts that are not `said` elsewhere."""
    new = [fact for fact in facts if fact not in said]
    return f"{half} ({', '.join(new)})" if new else half


def _same(rows: Iterable[Row]) -> list[str]:
    """Unit, cases and work, of which those that all rows have."""
    of_rows = [_facts(row) for row in rows]
    return [facts[0] for facts in zip(*of_rows, strict=True) if len(set(facts)) == 1]


def _facts(row: Row) -> tuple[str, str, str]:
    return row.unit, f"{row.n:,} {row.cases}", row.work


def _cell(row: Row, said: Sequence[str]) -> str:
    """The figure and what is known of it, but for what is `said` already."""
    around = ["counted" if row.low == row.high else f"{format_number(row.low)} to {format_number(row.high)}"]
    around += [] if row.paper is None else [f"paper {format_number(row.paper)}"]
    around += [fact for fact in _facts(row) if fact not in said]
    return f"{format_number(row.value)} ({'; '.join(around)})"
