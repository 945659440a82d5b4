"""How are the plots of a batch drawn? Strips with boxes, intervals around 0, and curves, as inline SVG.

Like the report of a run: horizontal places are percentages and vertical ones pixels, so that one drawing fits every
width. Each row's name stands above its drawing, so that long names need no margin.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from xihe_blender.report.svg import Axis, axis_below, axis_up_to, figure, grid, nice_step, stretched, tick_label
from xihe_blender.report.values import MINUS, escape, significant
from xihenet.paired import PairedDifference

ROW_PX = 54
_DOTS_Y, _SPREAD_PX = 34, 7
_GOLDEN = 0.618034

STYLE = """
.rows .name { fill: var(--ink); font-size: 13.5px; paint-order: stroke; stroke: var(--card); stroke-width: 5px; }
.rows .value { fill: var(--quiet); text-anchor: end; }
.box { fill: var(--c); fill-opacity: .18; stroke: var(--c); }
.median { stroke: var(--c); stroke-width: 2.5; }
.span { stroke: var(--c); stroke-width: 2; }
.strip-dot { fill: var(--c); fill-opacity: .75; }
.zero { stroke: var(--ink); stroke-dasharray: 5 4; }
.axes .axis-y { text-anchor: start; }
.cases { display: grid; gap: 28px; }
.cases .strip { grid-template-columns: repeat(3, minmax(0, 320px)); margin-top: 8px; }
.answer { font-size: 18px; line-height: 1.5; max-width: 74ch; }
"""


@dataclass(frozen=True)
class Row:
    """One row of a strip plot: its name, (value, words for hovering) of each dot, and which of the colours it has."""

    name: str
    colour: int
    dots: Sequence[tuple[float, str]]


@dataclass(frozen=True)
class Interval:
    """One row of a plot of differences."""

    name: str
    colour: int
    difference: PairedDifference
    words: str


@dataclass(frozen=True)
class Curve:
    """(x, y, words for hovering) of each point, in order."""

    name: str
    colour: int
    points: Sequence[tuple[float, float, str]]


def strips(rows: Sequence[Row], *, title: str, about: str, axis_name: str) -> str:
    """A row of dots per entry, with a box from the lower to the upper quartile and a line at the median."""
    known = [row for row in rows if row.dots]
    if not known:
        return ""
    axis = _axis([value for row in known for value, _ in row.dots])
    drawn = "".join(_strip(row, place, axis) for place, row in enumerate(known))
    return _rows(drawn, len(known), axis, axis_name, title=title, about=about)


def _strip(row: Row, place: int, axis: _Span) -> str:
    values = [value for value, _ in row.dots]
    low, middle, high = np.percentile(values, [25, 50, 75])
    y = place * ROW_PX + _DOTS_Y
    box = ""
    if len(values) > 2:
        box = (
            f'<rect class="box" x="{axis.x(low):.2f}%" width="{axis.x(high) - axis.x(low):.2f}%" y="{y - 10}" '
            f'height="20" rx="3"/>'
        )
    median = f'<line class="median" x1="{axis.x(middle):.2f}%" x2="{axis.x(middle):.2f}%" y1="{y - 10}" y2="{y + 10}"/>'
    # Dots beside each other where values are equal, and always in the same places.
    dots = "".join(
        f'<circle class="strip-dot" cx="{axis.x(value):.2f}%" '
        f'cy="{y + _SPREAD_PX * (2 * (_GOLDEN * (k + 1) % 1) - 1):.1f}" r="3.2"><title>{escape(words)}</title></circle>'
        for k, (value, words) in enumerate(row.dots)
    )
    name = f'<text class="name" x="0" y="{y - 16}">{escape(row.name)}</text>'
    told = f'<text class="value" x="100%" y="{y - 16}">median {significant(float(middle))}</text>'
    return f'<g class="s{row.colour % 6}">{box}{median}{dots}{name}{told}</g>'


def differences(rows: Sequence[Interval], *, title: str, about: str, axis_name: str) -> str:
    """A row per difference: its mean as a dot, its interval as a line, and 0."""
    if not rows:
        return ""
    spans = [row.difference for row in rows]
    ends = [end for span in spans for end in (span.mean, span.low, span.high) if end is not None]
    axis = _axis([*ends, 0.0])
    drawn = "".join(_interval(row, place, axis) for place, row in enumerate(rows))
    height = len(rows) * ROW_PX
    zero = f'<line class="zero" x1="{axis.x(0):.2f}%" x2="{axis.x(0):.2f}%" y1="0" y2="{height}"/>'
    return _rows(zero + drawn, len(rows), axis, axis_name, title=title, about=about)


def _interval(row: Interval, place: int, axis: _Span) -> str:
    y, span = place * ROW_PX + _DOTS_Y, row.difference
    line = ""
    if span.low is not None and span.high is not None:
        line = f'<line class="span" x1="{axis.x(span.low):.2f}%" x2="{axis.x(span.high):.2f}%" y1="{y}" y2="{y}"/>'
    dot = (
        f'<circle class="dot" cx="{axis.x(span.mean):.2f}%" cy="{y}" r="5"><title>{escape(row.words)}</title></circle>'
    )
    name = f'<text class="name" x="0" y="{y - 16}">{escape(row.name)}</text>'
    return f'<g class="s{row.colour % 6}">{line}{dot}{name}</g>'


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
    known = [line for line in lines if line.points]
    if not known:
        return ""
    across = axis_up_to(max(x for line in known for x, _, _ in line.points))
    up = axis_up_to(max(y for line in known for _, y, _ in line.points), y_label)
    drawn = "".join(_curve(line, across, up, is_joined=is_joined) for line in known)
    legend = "".join(f'<li><span class="swatch s{line.colour % 6}"></span>{escape(line.name)}</li>' for line in known)
    below = axis_below((100 * tick / across.top for tick in across.ticks), map(across.label, across.ticks), x_name)
    body = f'{grid(up)}{below}<text class="axis-y" x="4" y="-6">{y_name}</text>{drawn}'
    return figure(body, title=title, about=about, legend=f'<ul class="legend">{legend}</ul>')


def _curve(line: Curve, across: Axis, up: Axis, *, is_joined: bool) -> str:
    path = "".join(
        f"{'L' if k else 'M'}{1000 * x / across.top:.2f} {up.y(y):.2f}" for k, (x, y, _) in enumerate(line.points)
    )
    joined = stretched(f'<path class="line s{line.colour % 6}" d="{path}"/>') if is_joined else ""
    return joined + "".join(
        f'<circle class="dot s{line.colour % 6}" cx="{100 * x / across.top:.2f}%" cy="{up.y(y):.2f}" r="4">'
        f"<title>{escape(words)}</title></circle>"
        for x, y, words in line.points
    )


@dataclass(frozen=True)
class _Span:
    """A horizontal axis between two ticks."""

    low: float
    high: float
    ticks: tuple[float, ...]
    label: Callable[[float], str]

    def x(self, value: float) -> float:
        """Percent of the plot's width."""
        return 100 * (value - self.low) / (self.high - self.low)


def _axis(values: Sequence[float]) -> _Span:
    """From the tick below the smallest to the tick above the largest; from 0 where all are positive and 0 is near."""
    low, high = min(values), max(values)
    if 0 < low < 0.75 * high:
        low = 0.0
    span = high - low or abs(high) or 1.0
    step = nice_step(span, 5)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    last = max(last, first + 1)
    ticks = tuple(k * step for k in range(first, last + 1))
    return _Span(first * step, last * step, ticks, tick_label(step))


def _x_axis(axis: _Span, n_rows: int, name: str) -> str:
    height = n_rows * ROW_PX
    ticks = "".join(
        f'<line class="grid" x1="{axis.x(t):.2f}%" x2="{axis.x(t):.2f}%" y1="0" y2="{height}"/>'
        f'<text class="tick-x" x="{axis.x(t):.2f}%" y="{height + 16}">{axis.label(t).replace("-", MINUS)}</text>'
        for t in axis.ticks
    )
    return ticks + f'<text class="axis-x" x="100%" y="{height + 34}">{name}</text>'


def _rows(body: str, n_rows: int, axis: _Span, axis_name: str, *, title: str, about: str) -> str:
    drawn = _x_axis(axis, n_rows, axis_name) + body
    return figure(drawn, title=title, about=about, classes="axes rows", height_px=n_rows * ROW_PX)
