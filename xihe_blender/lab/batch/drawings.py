"""Plots of a batch: strips with boxes, intervals around 0, and curves, each from its values and words for hovering.

Each row's name stands above its drawing, so that long names need no margin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_number
from xihenet.paired import PairedDifference
from xihenet.svg import Axis, linear_axis

ROW_PX = 54
_DOTS_Y, _SPREAD_PX = 34, 7
_GOLDEN = 0.618034

Strip = tuple[str, int, Sequence[tuple[float, str]]]
"""Name, which of the colours, and (value, words) of each dot."""

Interval = tuple[str, int, PairedDifference, str]
"""Name, which of the colours, the difference, and its words."""

Curve = tuple[str, int, Sequence[tuple[float, float, str]]]
"""Name, which of the colours, and (x, y, words) of each point, in order."""


def strips(rows: Sequence[Strip], *, title: str, about: str, axis_name: str) -> str:
    """A row of dots per entry, with a box from the lower to the upper quartile and a line at the median."""
    known = [row for row in rows if row[2]]
    if not known:
        return ""
    axis = _row_axis([value for *_, dots in known for value, _ in dots])
    drawn = "".join(_strip(row, index * ROW_PX + _DOTS_Y, axis) for index, row in enumerate(known))
    return _rows(drawn, len(known), axis, axis_name, title=title, about=about)


def _strip(row: Strip, y: float, axis: Axis) -> str:
    name, colour, dots = row
    low, middle, high = map(axis.x, np.percentile([value for value, _ in dots], [25, 50, 75]))
    place = f'x="{low:.2f}%" width="{high - low:.2f}%" y="{y - 10}" height="20" rx="3"'
    box = f'<rect class="box" {place}/>' if len(dots) > 2 else ""
    # Dots beside each other where values are equal, and always in the same places.
    heights = [y + _SPREAD_PX * (2 * (_GOLDEN * (k + 1) % 1) - 1) for k in range(len(dots))]
    drawn = "".join(
        svg.dot(axis.x(value), height, "strip-dot", words, radius=3.2)
        for height, (value, words) in zip(heights, dots, strict=True)
    )
    median = svg.straight(middle, y - 10, middle, y + 10, "median")
    words = f"median {format_number(float(np.median([value for value, _ in dots])))}"
    value = f'<text class="value" x="100%" y="{y - 16}">{words}</text>'
    return _row(box + median + drawn + value, name, colour, y)


def differences(rows: Sequence[Interval], *, title: str, about: str, axis_name: str) -> str:
    """A row per difference: its mean as a dot, its interval as a line, and 0."""
    if not rows:
        return ""
    ends = [end for _, _, d, _ in rows for end in (d.mean, d.low, d.high) if end is not None]
    axis = _row_axis([*ends, 0.0])
    drawn = svg.straight(axis.x(0), 0, axis.x(0), len(rows) * ROW_PX, "zero")
    for index, (name, colour, difference, words) in enumerate(rows):
        y = index * ROW_PX + _DOTS_Y
        dot = svg.dot(axis.x(difference.mean), y, "dot", words, radius=5)
        if difference.low is not None and difference.high is not None:
            dot = svg.straight(axis.x(difference.low), y, axis.x(difference.high), y, "span") + dot
        drawn += _row(dot, name, colour, y)
    return _rows(drawn, len(rows), axis, axis_name, title=title, about=about)


def curves(
    lines: Sequence[Curve],
    *,
    title: str,
    about: str,
    x_name: str,
    y_name: str,
    y_label: Callable[[float], str] | None = None,
    is_joined: bool = True,
) -> str:
    """Curves, or clouds of dots, over an axis from 0 to the right and one from 0 upwards."""
    known = [line for line in lines if line[2]]
    if not known:
        return ""
    across = linear_axis(0, max(x for *_, points in known for x, _, _ in points))
    up = linear_axis(0, max(y for *_, points in known for _, y, _ in points), label=y_label)
    body = f'{svg.grid_across(up)}{svg.axis_of(across, x_name)}<text class="axis-y" x="4" y="-6">{y_name}</text>'
    for _, colour, points in known:
        places = [(across.x(x), up.y(y), words) for x, y, words in points]
        body += svg.line([(x, y) for x, y, _ in places], f"s{colour % 6}") if is_joined else ""
        body += "".join(svg.dot(x, y, f"dot s{colour % 6}", words) for x, y, words in places)
    entries = [f'<span class="swatch s{colour % 6}"></span>{escape(name)}' for name, colour, _ in known]
    return svg.figure(body, title=title, about=about, below=svg.legend(entries))


def _row_axis(values: Sequence[float]) -> Axis:
    """From 0 where all are positive and 0 is near."""
    low, high = min(values), max(values)
    return linear_axis(0.0 if 0 < low < 0.75 * high else low, high, n_steps=5)


def _row(drawn: str, name: str, colour: int, y: float) -> str:
    return f'<g class="s{colour % 6}">{drawn}<text class="name" x="0" y="{y - 16}">{escape(name)}</text></g>'


def _rows(body: str, n_rows: int, axis: Axis, axis_name: str, *, title: str, about: str) -> str:
    height = n_rows * ROW_PX
    drawn = svg.axis_of(axis, axis_name, height, grid=True) + body
    return svg.figure(drawn, title=title, about=about, classes="axes rows", height_px=height)
