"""Plots of the training's report, each an SVG file of its own, drawn as those of the other reports are.

A white card with a legend below it, since a README shows the file as it is. Marks have different shapes, so that colour
is not needed. Rejected: labels at the ends of lines, which collide where predictors are alike, and that is where one
looks.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from xihenet import svg
from xihenet.svg import Axis, linear_axis
from xihenet.training.calibration import CalibrationRow
from xihenet.training.report import LearningPoint, Report

WIDTH, HEIGHT = 720, 300
LEFT, RIGHT, TOP = 64, 28, 58
LEGEND_TOP, LEGEND_ROW, LETTER = TOP + HEIGHT + 58, 20, 7.2
"""Text is placed with a generous width of a letter, as nothing here can measure it."""

COLOURS = ("#0072b2", "#c44f00", "#00805f", "#b04a88", "#9c6a00", "#4a4a4a", "#3aa4e0", "#7a2f60")
STYLE = (
    "text{fill:#5a5a5a}.title{fill:#1c1c1c;font-size:16px;font-weight:650}.name{fill:#1c1c1c}.grid{stroke:#e6e6e6}"
    ".base{stroke:#5a5a5a}.tick-x{text-anchor:middle}.tick-y{text-anchor:end;dominant-baseline:central}"
    ".axis-x{text-anchor:end}.line{fill:none;stroke-width:2;vector-effect:non-scaling-stroke}.bar{stroke-width:1.4}"
    ".mark{stroke:#fff;transform:scale(.75)}svg svg{overflow:visible}.limit{stroke:#1c1c1c;stroke-dasharray:4 4}"
    + "".join(f".c{i}{{stroke:{colour}}}.mark.c{i}{{fill:{colour}}}" for i, colour in enumerate(COLOURS))
)

Series = tuple[str, Sequence[tuple[float, float, float | None]]]
"""Name, and points: x, y, and half the height of a bar there, if known."""

RATIO = "SHC RMSE / mean predictor's"


def line_chart(
    title: str, series: Sequence[Series], x: Axis, y: Axis, names: tuple[str, str], limits: Sequence[str] = ()
) -> str:
    """A whole SVG file; `names` are of the axes, and series named in `limits` are drawn dashed, without marks.

    Series without points are left out; ValueError if all are.
    """
    shown = [one for one in series if one[1]]
    if not shown:
        raise ValueError(f"{title}: expected at least one series with points, got none")
    body = svg.grid_across(y, HEIGHT) + svg.straight(0, HEIGHT, 100, HEIGHT, "base") + svg.axis_of(x, names[0], HEIGHT)
    legend, left, row = "", 16.0, 0
    looks = (series_look(index) for index in range(len(shown)))
    for name, points in shown:
        classes, shape = ("limit", "") if name in limits else next(looks)
        places = [(x.x(a), y.y(b, HEIGHT)) for a, b, _ in points]
        body += svg.line(places, classes, HEIGHT)
        for (a, b), (_, value, half) in zip(places, points, strict=True):
            if half:
                low, high = (y.y(value + side * half, HEIGHT) for side in (-1, 1))
                body += svg.straight(a, low, a, high, f"bar {classes}")
            body += svg.mark(a, b, shape, f"mark {classes}") if shape else ""
        needed = 36 + LETTER * len(name) + 24
        left, row = (16.0, row + 1) if left > 16 and left + needed > WIDTH - 16 else (left, row)
        entry = f'<path class="line {classes}" d="M0 0h28"/>'
        if shape:
            entry += f'<g transform="translate(14)"><path class="mark {classes}" d="{svg.SHAPES[shape]}"/></g>'
        entry += f'<text class="name" x="36" y="4.5">{escape(name)}</text>'
        legend += f'<g transform="translate({left:.1f} {LEGEND_TOP + row * LEGEND_ROW})">{entry}</g>'
        left += needed
    width, height = WIDTH - LEFT - RIGHT, LEGEND_TOP + (row + 1) * LEGEND_ROW
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        f'role="img" aria-label="{escape(title)}" font-family="system-ui, sans-serif" font-size="13">\n'
        f'<style>{STYLE}</style>\n<rect width="{WIDTH}" height="{height}" rx="8" fill="#fff"/>\n'
        f'<text class="title" x="16" y="26">{escape(title)}</text><text x="16" y="46">{escape(names[1])}</text>\n'
        f'<svg x="{LEFT}" y="{TOP}" width="{width}" height="{HEIGHT}" overflow="visible">{body}</svg>\n'
        f"{legend}\n</svg>\n"
    )


def series_look(index: int) -> tuple[str, str]:
    """Class of the colour, and shape of the marks, of a series: others for each of the first 40."""
    shapes = list(svg.SHAPES)
    return f"c{index % len(COLOURS)}", shapes[(index + index // len(COLOURS)) % len(shapes)]


def report_plots(report: Report) -> dict[str, str]:
    """SVG files by name, of the report's figures: those for which there are any."""
    plots, curve = {}, report.curve
    curves: list[Series] = [
        (name, _known(zip(curve.coverage, row.ratio, row.spread, strict=True))) for name, row in curve.rows.items()
    ]
    if any(points for _, points in curves):
        # The mean predictor's own curve is the 1 that all others are ratios to.
        ones = [name for name, points in curves if points and all(abs(y - 1) < 1e-9 for _, y, _ in points)]
        seen = linear_axis(0, 1, n_steps=5, label=lambda share: f"{share:.0%}")
        names = "share of the sphere that was seen", f"{RATIO}, clouds of one view and of all views"
        plots["coverage"] = line_chart("Error against coverage", curves, seen, _up(curves, 1.0), names, ones)
    if report.learning:
        plots["rooms"] = _learning_plot(report.learning)
    for row in (one for one in report.calibration if one.figures.bins):
        name = "".join(letter if letter.isalnum() else "_" for letter in row.name)
        plots[f"calibration_{name}"] = _calibration_plot(row)
    return plots


def _known(points: Iterable[Sequence[float | None]]) -> list[tuple[float, float, float | None]]:
    return [(float(x), float(y), half) for x, y, half in points if x is not None and y is not None]


def _up(series: Sequence[Series], *more: float) -> Axis:
    """An upright axis that holds all points, the ends of their bars and `more`."""
    ends = [y + side * (half or 0.0) for _, points in series for _, y, half in points for side in (-1, 1)]
    values = [*ends, *more] or [1.0]
    return linear_axis(min(values), max(values), n_steps=5)


def _learning_plot(learning: Sequence[LearningPoint]) -> str:
    series = [(g, _known((point.n_rooms, *point.groups[g]) for point in learning)) for g in learning[0].groups]
    numbers = sorted({float(point.n_rooms) for point in learning})
    margin = 1.1 if len(numbers) > 1 else 2.0
    x = Axis(numbers[0] / margin, numbers[-1] * margin, tuple(numbers), lambda n: f"{n:.0f}", is_log=True)
    title = f"Error against the number of training rooms, {learning[0].estimator}"
    return line_chart(title, series, x, _up(series), ("training rooms", RATIO))


def _calibration_plot(row: CalibrationRow) -> str:
    points = [(one.expected, one.made, None) for one in row.figures.bins]
    highest = max(max(one.expected, one.made) for one in row.figures.bins)
    promise: Series = ("as promised", [(0.0, 0.0, None), (highest, highest, None)])
    axis = linear_axis(0, highest, n_steps=5)
    names = (
        "expected SHC RMSE, calibrated on the validation rooms",
        "SHC RMSE that was made, mean of an eighth of the clouds",
    )
    title = f"Expected and made error, {row.name}"
    return line_chart(title, [promise, (row.name, points)], axis, axis, names, promise[:1])
