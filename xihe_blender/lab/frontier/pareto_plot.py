"""Pareto plot: error against time, both over powers of ten.

Every choice is a mark with its spread in both directions; the front is a staircase through its choices, since what lies
right of it and above is no better; presets have their names. An error of 0, the exhaustive setting's own, has no place
on such an axis and is drawn at its foot, below a gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xihe_blender.lab.frontier.records import FrontierPoint
from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_milliseconds, format_percent
from xihenet.svg import Axis, log_axis

ACROSS = "processor time of a frame"
HEIGHT_PX = 360
FOOT_PX = 386
"""Where the drawing ends, with room below the axis for errors of 0."""


def pareto_plot(points: Sequence[FrontierPoint], title: str, about: str) -> str:
    """A figure with all `points` of one group, or with a sentence where there is none. `title`, `about` are HTML."""
    if not points:
        return svg.figure("", title=title, about="Nothing was measured.", is_wide=True)
    errors = [p.error for p in points if p.error > 0]
    times, heights = log_axis([p.time_ms for p in points], format_milliseconds), log_axis(errors, _percent)
    unnamed = sorted((p for p in points if p.on_front and p.preset is None), key=lambda p: p.time_ms)
    numbers = {p.label: number for number, p in enumerate(unnamed, start=1)}
    # What is nearest to the reader is drawn last.
    ordered = sorted(points, key=lambda p: (p.preset is not None, p.on_front))
    marks = "".join(_mark(times, heights, p, numbers) for p in ordered)
    zero = f'<text class="tick-y" x="-8" y="{FOOT_PX - 8}">0</text>' if len(errors) < len(points) else ""
    grid = svg.grid_across(heights, HEIGHT_PX) + svg.axis_of(times, ACROSS, FOOT_PX, grid=True) + zero
    body = f"{grid}{svg.straight(0, FOOT_PX, 100, FOOT_PX, 'base')}{_front_line(times, heights, points)}{marks}"
    return svg.figure(
        body, title=title, about=about, label=f"{title}: error against time", below=_legend(points, numbers),
        classes="axes pareto", height_px=FOOT_PX, is_wide=True,
    )  # fmt: skip


def _x(times: Axis, time_ms: float) -> float:
    """Percent from the left edge, within the plot."""
    return min(100.0, max(0.0, times.x(time_ms)))


def _y(errors: Axis, error: float) -> float:
    """Pixels from the upper edge, within the plot; an error of 0 lies at the foot."""
    return FOOT_PX - 8.0 if error <= 0 else min(HEIGHT_PX, max(0.0, errors.y(error, HEIGHT_PX)))


def _front_line(times: Axis, errors: Axis, points: Sequence[FrontierPoint]) -> str:
    """Level from each choice to the next dearer one, and down to it."""
    front = sorted((p for p in points if p.on_front), key=lambda p: p.time_ms)
    steps: list[tuple[float, float]] = []
    for x, y in ((_x(times, p.time_ms), _y(errors, p.error)) for p in front):
        steps += [(x, steps[-1][1] if steps else y), (x, y)]
    return svg.line([*steps, (100.0, steps[-1][1])] if steps else [], "s0", FOOT_PX)


def _mark(times: Axis, errors: Axis, point: FrontierPoint, numbers: Mapping[str, int]) -> str:
    x, y = _x(times, point.time_ms), _y(errors, point.error)
    kind, shape, name = "front" if point.on_front else "aside", "circle", ""
    if point.preset is not None:
        kind, shape = "preset", "diamond"
        side, shift = ("end", -11) if x > 88 else ("start", 11)
        name = f'<text class="preset-name" x="{shift}" y="-9" text-anchor="{side}">{escape(point.preset)}</text>'
    elif point.on_front:
        name = f'<text class="number" x="-6" y="14" text-anchor="end">{numbers[point.label]}</text>'
    # From quartile to quartile, as far as is known: the spread, half of it to either side.
    low, high = (_x(times, max(1e-9, point.time_ms + side * point.spread_ms / 2)) for side in (-1, 1))
    whiskers = svg.straight(low, y, high, y, "whisker")
    if point.error > 0:
        half = point.error_spread / 2
        foot, top = (_y(errors, max(errors.low, point.error + side * half)) for side in (-1, 1))
        whiskers += svg.straight(x, top, x, foot, "whisker")
    return whiskers + svg.mark(x, y, shape, f"choice {kind}", escape(_hover(point)), name)


def _hover(point: FrontierPoint) -> str:
    words = f"{point.name}\nerror {_percent(point.error)}, {format_milliseconds(point.time_ms)}"
    if point.flickers:
        words += f"\non the front in {point.front_share:.0%} of resampled measurements"
    return words if point.on_front or point.instead is None else f"{words}\ntake instead: {point.instead}"


def _legend(points: Sequence[FrontierPoint], numbers: Mapping[str, int]) -> str:
    kinds = [("preset", "diamond", "preset")] if any(p.preset is not None for p in points) else []
    kinds += [("front", "circle", "on the front"), ("aside", "circle", "dominated")]
    entries = [f"{svg.icon(shape, f'choice {kind}')} {words}" for kind, shape, words in kinds]
    entries += [f'<b class="key">{number}</b> {escape(label)}' for label, number in numbers.items()]
    return svg.legend(entries)


def _percent(error: float) -> str:
    return format_percent(error, 2) if error else "0"
