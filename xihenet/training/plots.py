"""How does a line chart become a small SVG file without a plotting library?

One look for all: a white card, quiet axes, a legend below with a line and a mark for each series, marks of different
shapes so that colour is not needed. Text is placed with generous estimates of its width, as nothing here can measure
it. Rejected: labels at the ends of lines, which collide where predictors are alike, and that is where one looks.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

WIDTH, PLOT_HEIGHT = 720, 300
LEFT, RIGHT, TOP = 64, 28, 58
LEGEND_ROW, LETTER = 20, 7.2
COLOURS = ("#0072b2", "#c44f00", "#00805f", "#b04a88", "#9c6a00", "#4a4a4a", "#3aa4e0", "#7a2f60")
_FONT = "font-family=\"system-ui, -apple-system, 'Segoe UI', sans-serif\""
_MARKS = ("circle", "square", "triangle", "diamond")


@dataclass(frozen=True)
class Series:
    """One line. `points` are (x, y), `spread` half the height of a bar at each, if known; `is_limit` draws dashes."""

    name: str
    points: Sequence[tuple[float, float]]
    spread: Sequence[float | None] = ()
    is_limit: bool = False


@dataclass(frozen=True)
class Axis:
    """`label` under or above it; from `low` to `high`; a tick and its text each; logarithmic or not."""

    label: str
    low: float
    high: float
    ticks: Sequence[tuple[float, str]]
    is_log: bool = False

    def share(self, value: float) -> float:
        """0 at the low end, 1 at the high one."""
        change = math.log if self.is_log else float
        return (change(value) - change(self.low)) / (change(self.high) - change(self.low))


def line_chart(title: str, series: Sequence[Series], x: Axis, y: Axis) -> str:
    """A whole SVG file. Series without points are left out; ValueError if all are."""
    shown = [one for one in series if one.points]
    if not shown:
        raise ValueError(f"{title}: expected at least one series with points, got none")
    places = _legend_places([one.name for one in shown])
    height = TOP + PLOT_HEIGHT + 58 + (places[-1][1] + 1) * LEGEND_ROW
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        f'role="img" aria-label="{escape(title)}" {_FONT} font-size="13" fill="#5a5a5a">',
        f'<rect width="{WIDTH}" height="{height}" rx="8" fill="#ffffff"/>',
        f'<text x="16" y="26" font-size="16" font-weight="650" fill="#1c1c1c">{escape(title)}</text>',
        f'<text x="16" y="46">{escape(y.label)}</text>',
        *_grid(x, y),
    ]
    looks = map(series_look, itertools.count())
    for one, (left, row) in zip(shown, places, strict=True):
        colour, mark = ("#1c1c1c", "") if one.is_limit else next(looks)
        parts += _curve(one, x, y, colour, mark)
        parts += _legend_entry(one, 16 + left, TOP + PLOT_HEIGHT + 58 + row * LEGEND_ROW, colour, mark)
    return "\n".join([*parts, "</svg>", ""])


def series_look(index: int) -> tuple[str, str]:
    """Colour and mark of a series, others for each of the first 32."""
    return COLOURS[index % len(COLOURS)], _MARKS[(index + index // len(COLOURS)) % len(_MARKS)]


def axis_over(label: str, values: Sequence[float], *, from_zero: bool = True, is_percent: bool = False) -> Axis:
    """A linear axis with round ticks that holds all values; ValueError if there are none."""
    if not values:
        raise ValueError(f"{label}: expected values, got none")
    low, high = (0.0 if from_zero else min(values)), max(values)
    step = _round_step(max(high - low, abs(high) / 20, 1e-6) / 5)
    first = math.floor(low / step + 1e-9)
    last = max(math.ceil(high / step - 1e-9), first + 1)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    ticks = [
        (i * step, f"{i * step:.0%}" if is_percent else f"{i * step:.{decimals}f}") for i in range(first, last + 1)
    ]
    return Axis(label, first * step, last * step, ticks)


def numbers_axis(label: str, values: Sequence[int]) -> Axis:
    """A logarithmic axis with a tick at each of the given numbers, above 0."""
    low, high = min(values), max(values)
    margin = 1.1 if low < high else 2.0
    ticks = [(float(v), str(v)) for v in sorted(set(values))]
    return Axis(label, low / margin, high * margin, ticks, is_log=True)


def report_plots(report: Mapping[str, Any]) -> dict[str, str]:
    """SVG files by name, of `Report.as_dict()`: those for which there are figures."""
    plots = {}
    curves = _curve_series(report["curve"])
    if any(one.points for one in curves):
        values = _reached(curves)
        y = axis_over(
            "SHC RMSE / mean predictor's, clouds of one view and of all views", [*values, 1.0], from_zero=False
        )
        x = axis_over("share of the sphere that was seen", [1.0], is_percent=True)
        plots["coverage"] = line_chart("Error against coverage", curves, x, y)
    if report["learning"]:
        plots["rooms"] = _learning_plot(report)
    for row in report["calibration"]:
        plots[f"calibration_{_file_name(row['name'])}"] = _calibration_plot(row)
    return plots


def _curve_series(curve: Mapping[str, Any]) -> list[Series]:
    made = []
    for name, row in curve["rows"].items():
        known = [
            (x, y, s)
            for x, y, s in zip(curve["coverage"], row["ratio"], row["spread"], strict=True)
            if x is not None and y is not None
        ]
        is_limit = all(abs(y - 1) < 1e-9 for _, y, _ in known)
        made.append(Series(name, [(x, y) for x, y, _ in known], [s for *_, s in known], is_limit))
    return made


def _reached(series: Sequence[Series]) -> list[float]:
    """All heights that are drawn, the ends of bars included."""
    bars = [(y, s or 0.0) for one in series for (_, y), s in zip(one.points, one.spread, strict=True)]
    return [y + sign * spread for y, spread in bars for sign in (-1, 1)]


def _learning_plot(report: Mapping[str, Any]) -> str:
    learning = report["learning"]
    groups = [name for name, value in learning[0].items() if isinstance(value, dict)]
    series = []
    for group in groups:
        known = [p for p in learning if p[group]["ratio"] is not None]
        points = [(float(p["n_rooms"]), float(p[group]["ratio"])) for p in known]
        series.append(Series(group, points, [p[group]["spread"] for p in known]))
    values = _reached(series)
    x = numbers_axis("training rooms", [point["n_rooms"] for point in learning])
    y = axis_over("SHC RMSE / mean predictor's", values or [1.0], from_zero=False)
    return line_chart(f"Error against the number of training rooms, {learning[0]['estimator']}", series, x, y)


def _calibration_plot(row: Mapping[str, Any]) -> str:
    bins = row["figures"]["bins"]
    points = [(one["expected"], one["made"]) for one in bins]
    highest = max(value for point in points for value in point)
    right = Series("as promised", [(0.0, 0.0), (highest, highest)], is_limit=True)
    x = axis_over("expected SHC RMSE, calibrated on the validation rooms", [highest])
    y = axis_over("SHC RMSE that was made, mean of an eighth of the clouds", [highest])
    return line_chart(f"Expected and made error, {row['name']}", [right, Series(row["name"], points)], x, y)


def _grid(x: Axis, y: Axis) -> list[str]:
    bottom, right = TOP + PLOT_HEIGHT, WIDTH - RIGHT
    parts = []
    for value, text in y.ticks:
        at = _y(y, value)
        parts.append(f'<line x1="{LEFT}" x2="{right}" y1="{at:.1f}" y2="{at:.1f}" stroke="#e6e6e6"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{at + 4.5:.1f}" text-anchor="end">{escape(text)}</text>')
    parts.append(f'<line x1="{LEFT}" x2="{right}" y1="{bottom}" y2="{bottom}" stroke="#5a5a5a"/>')
    for value, text in x.ticks:
        at = _x(x, value)
        parts.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{bottom}" y2="{bottom + 4}" stroke="#5a5a5a"/>')
        parts.append(f'<text x="{at:.1f}" y="{bottom + 18}" text-anchor="middle">{escape(text)}</text>')
    parts.append(f'<text x="{right}" y="{bottom + 36}" text-anchor="end">{escape(x.label)}</text>')
    return parts


def _curve(one: Series, x: Axis, y: Axis, colour: str, mark: str) -> list[str]:
    places = [(_x(x, a), _y(y, b)) for a, b in one.points]
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in places)
    dashes = ' stroke-dasharray="4 4"' if one.is_limit else ""
    parts = [f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="2"{dashes}/>']
    for (a, _), (_, value), spread in zip(places, one.points, one.spread, strict=False):
        if spread:
            above, below = _y(y, value + spread), _y(y, value - spread)
            parts.append(f'<path d="M{a:.1f} {above:.1f}V{below:.1f}" stroke="{colour}" stroke-width="1.4"/>')
    return parts + [_mark(mark, a, b, colour) for a, b in places if mark]


def _legend_entry(one: Series, left: float, y: float, colour: str, mark: str) -> list[str]:
    dashes = ' stroke-dasharray="4 4"' if one.is_limit else ""
    line = f'<path d="M{left} {y}h28" fill="none" stroke="{colour}" stroke-width="2"{dashes}/>'
    text = f'<text x="{left + 36}" y="{y + 4.5}" fill="#1c1c1c">{escape(one.name)}</text>'
    return [line, *([_mark(mark, left + 14, y, colour)] if mark else []), text]


def _legend_places(names: Sequence[str]) -> list[tuple[float, int]]:
    """Left edge and row of each entry."""
    places, left, row = [], 0.0, 0
    for name in names:
        needed = 36 + LETTER * len(name) + 24
        if left and left + needed > WIDTH - 32:
            left, row = 0.0, row + 1
        places.append((left, row))
        left += needed
    return places


def _mark(kind: str, x: float, y: float, colour: str) -> str:
    shapes = {
        "circle": f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" fill="{colour}"/>',
        "square": f'<path d="M{x - 3.3:.1f} {y - 3.3:.1f}h6.6v6.6h-6.6z" fill="{colour}"/>',
        "triangle": f'<path d="M{x:.1f} {y - 4.4:.1f}l4.2 7.4h-8.4z" fill="{colour}"/>',
        "diamond": f'<path d="M{x:.1f} {y - 4.8:.1f}l4.8 4.8l-4.8 4.8l-4.8 -4.8z" fill="{colour}"/>',
    }
    return shapes[kind]


def _x(axis: Axis, value: float) -> float:
    return LEFT + (WIDTH - LEFT - RIGHT) * axis.share(value)


def _y(axis: Axis, value: float) -> float:
    return TOP + PLOT_HEIGHT * (1 - axis.share(value))


def _round_step(step: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten at or above `step`."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= step * (1 - 1e-9))


def _file_name(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)
