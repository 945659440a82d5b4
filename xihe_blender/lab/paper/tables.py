"""Tables of the documentation's page: figures whose names have a colon stand in tables, and the others in a list.

"wifi: 2 positions, median" is in the line "wifi" and the column "2 positions, median". Lines that have a column in
common are in one table. Nothing is dropped: a cell has the figure, its interval and the paper's figure, and what all
cells of the table, of a column or of a line share (unit, cases, how they compare) is said once for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from xihe_blender.lab.paper.records import Row
from xihenet.formats import format_number

LIST_HEAD = ("what", "ours", "95 % interval", "cases", "the paper", "work")
NO_SPREAD = "no spread"
"""Stands for an interval without a width: of bytes, or of cases that are all alike."""

Table = Mapping[str, Mapping[str, Row]]
"""By line and column."""


def table_lines(rows: Sequence[Row], list_cells: Callable[[Row], Sequence[str]]) -> Iterator[str]:
    """Markdown of all rows; `list_cells` are those of one that is listed, as in LIST_HEAD."""
    for table in tables_of(rows):
        yield from _lines_of(table)
        yield ""
    listed = [row for row in rows if ": " not in row.what]
    if listed:
        yield from (f"| {' | '.join(LIST_HEAD)} |", "| --- " * len(LIST_HEAD) + "|")
        yield from (f"| {' | '.join(list_cells(row))} |" for row in listed)
        yield ""


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """Of the rows whose names have a colon; a name is cut at its last one."""
    lines: dict[str, dict[str, Row]] = {}
    for row in rows:
        line, colon, column = row.what.rpartition(": ")
        if colon:
            lines.setdefault(line, {})[column] = row
    tables: list[dict[str, dict[str, Row]]] = []
    for line, cells in lines.items():
        table = next((one for one in tables if any(cells.keys() & other.keys() for other in one.values())), None)
        if table is None:
            table = {}
            tables.append(table)
        table[line] = cells
    return list(tables)


def _lines_of(table: Table) -> Iterator[str]:
    shared = _same(row for cells in table.values() for row in cells.values())
    columns = dict.fromkeys(column for cells in table.values() for column in cells)
    of_column = {column: _same(cells[column] for cells in table.values() if column in cells) for column in columns}
    yield from (f"*{', '.join(shared)}*", "") if shared else ()
    yield f"| | {' | '.join(_named(column, facts, shared) for column, facts in of_column.items())} |"
    yield "| --- " * (1 + len(of_column)) + "|"
    for line, cells in table.items():
        of_line = _same(cells.values())
        in_columns = [fact for fact in of_line if all(fact in of_column[column] for column in cells)]
        told = [_cell(cells[column], of_line + facts) if column in cells else "" for column, facts in of_column.items()]
        yield f"| {_named(line, of_line, in_columns)} | {' | '.join(told)} |"


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
    around = [NO_SPREAD if row.low == row.high else f"{format_number(row.low)} to {format_number(row.high)}"]
    around += [] if row.paper is None else [f"paper {format_number(row.paper)}"]
    around += [fact for fact in _facts(row) if fact not in said]
    return f"{format_number(row.value)} ({'; '.join(around)})"
