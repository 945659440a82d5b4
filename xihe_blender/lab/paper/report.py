"""The evaluation as a page, and as Markdown: by study what the paper did, the drawing, and every figure beside its own.

Made from results alone, so that both say the same; the Markdown leaves details to the page. A drawing has a line per
series with its intervals, and the paper's figures as hollow marks on it.

In Markdown figures whose names have a colon stand in tables, and the others in a list. "wifi: 2 positions, median" is
in the line "wifi" and the column "2 positions, median". Lines that have a column in common are in one table. Nothing is
dropped: a cell has the figure, its interval and the paper's figure, and what all cells of the table, of a column or of
a line share (unit, cases, how they compare) is said once for them.
"""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from xihe_blender.lab.paper.records import Row, Study, StudyResult, Work
from xihe_blender.report.document import block, document, png_url, table
from xihe_blender.report.values import code, escape
from xihenet import svg
from xihenet.formats import DASH, format_count, format_duration, format_list, format_number

LAB_STYLE = Path(__file__).parents[1] / "lab.css"
LIST_HEAD = ("what", "ours", "95 % interval", "cases", "the paper", "work")
HEAD = (*LIST_HEAD, "what is the same")
NO_SPREAD = "no spread"
"""Stands for an interval without a width: of bytes, or of cases that are all alike."""

Table = Mapping[str, Mapping[str, Row]]
"""By line and column."""

SHAPES = tuple(svg.SHAPES)
HEIGHT_PX = 260
WORDS: dict[Work, str] = {
    "same work": "of the same work",
    "other data": "on other data",
    "other machine": "on another machine",
    "cannot be compared": "that cannot be compared",
}
TITLE = "The paper's evaluation, repeated"
BESIDE = "differences.md"
LINK = f" [How this differs from the paper]({BESIDE})."
FEW_ROOMS = (
    "Over two rooms an interval can hold the true figure in at most 50 % of all cases, over three in 75 %, over five "
    "in 94 %."
)
ALIKE = f"Where all cases are alike there is {NO_SPREAD}."
N_COLOURS = 6


def report_page(studies: Sequence[Study], results: Sequence[StudyResult], pictures: Path, command: str) -> str:
    by_name = {one.name: one for one in results}
    sections = [
        (study.name, escape(study.title), _section(study, by_name[study.name], pictures / study.name))
        for study in studies
        if study.name in by_name
    ]
    opening = f'<p class="lead">{escape(_lead(results))}</p>{block("How it was made", _how(results, command))}'
    return document(TITLE, opening, sections, style=LAB_STYLE)


def _lead(results: Sequence[StudyResult]) -> str:
    rows = [row for one in results for row in one.rows]
    works = Counter(row.work for row in rows if row.paper is not None)
    counts = format_list([f"{n} {WORDS[work]}" for work, n in works.items()])
    made = f"{format_count(len(rows), 'figure')} for {len(results)} of its tables and figures"
    return f"{made}. The paper gives {sum(works.values())} of them: {counts}." if works else f"{made}."


def _how(results: Sequence[StudyResult], command: str) -> str:
    seconds = format_duration(sum(one.elapsed_s for one in results))
    return (
        f"<p>{escape(_when_and_where(results))}, in {seconds} without recording. "
        "The paper: Xihe, a 3D vision-based lighting estimation framework for mobile augmented reality, Zhao and Guo, "
        f"MobiSys 2021. {FEW_ROOMS} {ALIKE}</p><pre>{escape(command)}</pre>"
    )


def _when_and_where(results: Sequence[StudyResult]) -> str:
    days, machines = (sorted({getattr(one, name) for one in results}) for name in ("measured_on", "machine"))
    return f"Measured on {format_list(days)} on {format_list(machines)}"


def _section(study: Study, result: StudyResult, pictures: Path) -> str:
    told = f"<p>{escape(study.paper_did)}</p>"
    if result.failed_because:
        return told + f"<p><strong>Could not be measured:</strong> {escape(result.failed_because)}.</p>"
    shown = "".join(
        f'<figure><img src="{png_url(file.read_bytes())}" alt="{escape(study.caption)}">'
        f"<figcaption>{code(file.stem)}. {escape(study.caption)}</figcaption></figure>"
        for file in sorted(pictures.glob("*.png"))
    )
    rows = [[escape(cell) for cell in _cells(row)] for row in result.rows]
    for before, row in reversed(list(itertools.pairwise(rows))):
        row[-1] = "as above" if row[-1] == before[-1] else row[-1]
    shown = f'<div class="plots">{shown}</div>' if shown else ""
    return f'{told}<div class="plots">{drawing(study, result.rows)}</div>{shown}{table(HEAD, rows, "stacking words")}'


def _cells(row: Row) -> tuple[str, ...]:
    """As in HEAD."""
    of_paper = DASH if row.paper is None else f"{format_number(row.paper)} {row.unit}"
    return (
        row.what,
        f"{format_number(row.value)} {row.unit}",
        NO_SPREAD if row.low == row.high else f"{format_number(row.low)} to {format_number(row.high)}",
        f"{row.n:,} {row.cases}",
        of_paper,
        row.work,
        row.sentence,
    )


def drawing(study: Study, rows: Sequence[Row]) -> str:
    """SVG of the rows that belong to a series; empty where there is none."""
    drawn = [row for row in rows if row.series and row.at is not None]
    if not drawn:
        return ""
    numbers = [number for row in drawn for number in (row.low, row.high, row.paper) if number is not None]
    upright = svg.linear_axis(min(0.0, *numbers), max(numbers))
    places = sorted({row.at for row in drawn if row.at is not None})
    across = {place: 100 * (number + 0.5) / len(places) for number, place in enumerate(places)}
    names = list(dict.fromkeys(row.series for row in drawn))
    body = svg.grid_across(upright, HEIGHT_PX)
    body += svg.axis_below(across.values(), [f"{place:g}" for place in places], study.across, HEIGHT_PX)
    for number, name in enumerate(names):
        body += _series([row for row in drawn if row.series == name], across, upright, number)
    icons = [
        f"{svg.icon(SHAPES[k % len(SHAPES)], f'choice s{k % N_COLOURS}')} {escape(n)}" for k, n in enumerate(names)
    ]
    if any(row.paper is not None for row in drawn):
        icons.append(f"{svg.icon('circle', 'choice aside')} the paper's figure, hollow in the shape of the series")
    title, about, below = escape(study.title), escape(study.up), svg.legend(icons)
    return svg.figure(body, title=title, about=about, below=below, height_px=HEIGHT_PX, is_wide=True)


def _series(rows: Sequence[Row], across: dict[float, float], upright: svg.Axis, number: int) -> str:
    shape, colour = SHAPES[number % len(SHAPES)], f"s{number % N_COLOURS}"
    rows = sorted(rows, key=lambda row: row.at or 0.0)
    spots = [(across[row.at or 0.0], row) for row in rows]
    parts = [svg.line([(x, upright.y(row.value, HEIGHT_PX)) for x, row in spots], colour, HEIGHT_PX)]
    for x, row in spots:
        low, high, y = (upright.y(v, HEIGHT_PX) for v in (row.low, row.high, row.value))
        told = escape(" ".join(_cells(row)[:4]))
        parts += [svg.straight(x, low, x, high, f"span {colour}"), svg.mark(x, y, shape, f"choice {colour}", told)]
        if row.paper is not None:
            told = f"the paper: {format_number(row.paper)} {escape(row.unit)}"
            parts.append(svg.mark(x, upright.y(row.paper, HEIGHT_PX), shape, "choice aside", told))
    return "".join(parts)


def paper_markdown(studies: Sequence[Study], results: Sequence[StudyResult], command: str, folder: Path) -> str:
    """The same as a page of the documentation; in another `folder` it does not link to the page beside it."""
    link = LINK if (folder / BESIDE).exists() else ""
    return "\n".join(_markdown_lines(studies, {one.name: one for one in results}, command, link)) + "\n"


def _markdown_lines(
    studies: Sequence[Study], results: dict[str, StudyResult], command: str, link: str
) -> Iterator[str]:
    yield from (f"# {TITLE}", "")
    n_details = sum(row.is_detail for one in results.values() for row in one.rows)
    results = {
        name: replace(one, rows=tuple(row for row in one.rows if not row.is_detail)) for name, one in results.items()
    }
    left_out = f" `report.html` has {n_details} more." if n_details else ""
    yield from (
        "This page has what a simulation can repeat of the evaluation in Xihe (Zhao and Guo, MobiSys 2021), with our "
        f"rooms, networks and server: {_lead(list(results.values()))}{left_out}{link}",
        "",
    )
    yield from ("```sh", command, "```", "")
    when_and_where = _when_and_where(list(results.values()))
    yield from (f"That command makes this page; `--only NAME` measures one study. {when_and_where}.", "")
    yield from (
        "Brackets hold the 95 % interval, by bootstrap over cases, or over rooms where cases of a room are alike, "
        f"and the paper's figure. {FEW_ROOMS} {ALIKE} Above a table, in italics, is what all of its figures share: "
        "unit, number of cases, and how they compare with the paper's (*same work*; the same on *other data* or an "
        "*other machine*; *cannot be compared*).",
        "",
    )
    for study in studies:
        if study.name in results:
            yield from _markdown_of(study, results[study.name])


def _markdown_of(study: Study, result: StudyResult) -> Iterator[str]:
    yield from (f"## {study.title}", "", f"`{study.name}`. {study.paper_did}", "")
    if result.failed_because:
        yield from (f"Could not be measured: {result.failed_because}.", "")
        return
    yield from table_lines(result.rows, lambda row: _cells(row)[:-1])
    yield from (f"- {words}" for words in _said_once([row.sentence for row in result.rows]))
    yield ""


def _said_once(remarks: Sequence[str]) -> Iterator[str]:
    """The remarks without the sentences of those before."""
    said: set[str] = set()
    for remark in dict.fromkeys(remarks):
        new = [sentence for sentence in re.split(r"(?<=\.) (?=[A-Z])", remark) if sentence not in said]
        said.update(new)
        if new:
            yield " ".join(new)


# ------------------------------------------------------------------------------------------ tables in Markdown


def table_lines(rows: Sequence[Row], list_cells: Callable[[Row], Sequence[str]]) -> Iterator[str]:
    """Markdown of all rows; `list_cells` are those of one that is listed, as in LIST_HEAD."""
    for one in tables_of(rows):
        yield from _lines_of(one)
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
