"""How is error drawn against time, both over powers of ten?

As the plots of a run's report are: places across in percentages, places down in pixels, curves in an inner drawing that
is stretched. Every choice is a mark with its spread in both directions; the front is a staircase through its choices,
since what lies right of it and above is no better; presets have their names. An error of 0, the exhaustive setting's
own, has no place on such an axis and is drawn at its foot, below a gap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from xihe_blender.lab.frontier.points import flickers, name_of
from xihe_blender.report.values import escape, significant, with_unit

Point = Mapping[str, Any]
HEIGHT_PX = 360
FOOT_PX = 26
"""Room below the axis for errors of 0."""
DIVISIONS = ((1,), (1, 2, 5), (1, 1.5, 2, 3, 5, 7), (1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 3.5, 4, 4.5, 5, 6, 7, 8, 9))
ROOM = 1.25
"""Factor that is left free beyond the outermost marks."""


@dataclass(frozen=True)
class LogAxis:
    """From `low` to `high`, both above 0; `place` is 0 to 1."""

    low: float
    high: float

    @classmethod
    def around(cls, values: Sequence[float]) -> LogAxis:
        """With room on both sides; half a power of ten at least. Values must be above 0; none gives 1 to 10."""
        low, high = (min(values), max(values)) if values else (1.0, 10.0)
        middle = math.sqrt(low * high)
        return cls(min(low / ROOM, middle / 1.8), max(high * ROOM, middle * 1.8))

    def place(self, value: float) -> float:
        """Below 0 or above 1 outside the axis."""
        return math.log(value / self.low) / math.log(self.high / self.low)

    def ticks(self) -> list[float]:
        """The coarsest of some divisions of a power of ten that gives three ticks; the finest where none does."""
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        ticks: list[float] = []
        for steps in DIVISIONS:
            ticks = [
                tick for power in powers for step in steps if self.low <= (tick := step * 10.0**power) <= self.high
            ]
            if len(ticks) >= 3:
                break
        return ticks


@dataclass(frozen=True)
class Canvas:
    """The two axes: time across, error upwards."""

    time: LogAxis
    error: LogAxis

    def x(self, time_ms: float) -> float:
        """Percent from the left edge."""
        return 100 * min(1.0, max(0.0, self.time.place(time_ms)))

    def y(self, error: float) -> float:
        """Pixels from the upper edge; an error of 0 lies at the foot."""
        if error <= 0:
            return HEIGHT_PX + FOOT_PX - 8
        return HEIGHT_PX * (1 - min(1.0, max(0.0, self.error.place(error))))


def loglog_plot(points: Sequence[Point], title: str, about: str, across: str = "processor time of a frame") -> str:
    """A figure with all `points` of one group, or with a sentence where there is none. `title`, `about` are HTML."""
    if not points:
        return (
            f'<figure class="plot wide"><figcaption><h3>{title}</h3><p>Nothing was measured.</p></figcaption></figure>'
        )
    errors = [p["error"] for p in points if p["error"] > 0]
    canvas = Canvas(LogAxis.around([p["time_ms"] for p in points]), LogAxis.around(errors))
    # What is nearest to the reader is drawn last.
    ordered = sorted(points, key=lambda p: (p["preset"] is not None, p["on_front"]))
    numbers = {p["label"]: place for place, p in enumerate(_unnamed_front(points), start=1)}
    marks = "".join(_mark(canvas, p, numbers) for p in ordered)
    body = _grid(canvas, across, has_zero=len(errors) < len(points)) + _front_line(canvas, points) + marks
    height = HEIGHT_PX + FOOT_PX
    return (
        f'<figure class="plot wide"><figcaption><h3>{title}</h3><p>{about}</p></figcaption>'
        f'<svg class="axes loglog" role="img" aria-label="{title}: error against time" height="{height}">{body}</svg>'
        f"{_legend(points)}</figure>"
    )


def _unnamed_front(points: Sequence[Point]) -> list[Point]:
    """Choices on the front that are no presets, by rising time: they go by number."""
    own = [p for p in points if p["on_front"] and p["preset"] is None]
    return sorted(own, key=lambda p: p["time_ms"])


def _grid(canvas: Canvas, across: str, *, has_zero: bool) -> str:
    lines = "".join(
        f'<line class="grid" x1="0" x2="100%" y1="{canvas.y(tick):.1f}" y2="{canvas.y(tick):.1f}"/>'
        f'<text class="tick-y" x="-8" y="{canvas.y(tick):.1f}">{_percent(tick)}</text>'
        for tick in canvas.error.ticks()
    )
    for tick in canvas.time.ticks():
        x = f"{canvas.x(tick):.3f}%"
        lines += f'<line class="grid" x1="{x}" x2="{x}" y1="0" y2="{HEIGHT_PX + FOOT_PX}"/>'
        lines += f'<text class="tick-x" x="{x}" y="{HEIGHT_PX + FOOT_PX + 18}">{_duration(tick)}</text>'
    foot = HEIGHT_PX + FOOT_PX
    if has_zero:
        lines += f'<text class="tick-y" x="-8" y="{canvas.y(0)}">0</text>'
    lines += f'<line class="base" x1="0" x2="100%" y1="{foot}" y2="{foot}"/>'
    return lines + f'<text class="axis-x" x="100%" y="{foot + 35}">{escape(across)}</text>'


def _front_line(canvas: Canvas, points: Sequence[Point]) -> str:
    """Level from each choice to the next dearer one, and down to it."""
    front = sorted((p for p in points if p["on_front"]), key=lambda p: p["time_ms"])
    path = ""
    for point in front:
        x, y = 10 * canvas.x(point["time_ms"]), canvas.y(point["error"])
        path += f"H{x:.2f}V{y:.2f}" if path else f"M{x:.2f} {y:.2f}"
    height = HEIGHT_PX + FOOT_PX
    view = f'viewBox="0 0 1000 {height}" preserveAspectRatio="none"'
    return f'<svg width="100%" height="{height}" {view}><path class="line s0" d="{path}H1000"/></svg>'


def _mark(canvas: Canvas, point: Point, numbers: Mapping[str, int]) -> str:
    x, y = canvas.x(point["time_ms"]), canvas.y(point["error"])
    kind = "preset" if point["preset"] is not None else "front" if point["on_front"] else "aside"
    shape = "M0-7.5L7.5 0L0 7.5L-7.5 0Z" if kind == "preset" else "M-4 0A4 4 0 1 0 4 0A4 4 0 1 0 -4 0Z"
    words = f"<title>{escape(_told(point))}</title>"
    name = ""
    if kind == "preset":
        side, shift = ("end", -11) if x > 88 else ("start", 11)
        name = f'<text class="name" x="{shift}" y="-9" text-anchor="{side}">{escape(point["preset"])}</text>'
    elif kind == "front":
        name = f'<text class="number" x="-6" y="14" text-anchor="end">{numbers[point["label"]]}</text>'
    return (
        _whiskers(canvas, point)
        + f'<svg x="{x:.3f}%" y="{y:.2f}" width="1" height="1">'
        + f'<path class="choice {kind}" d="{shape}">{words}</path>{name}</svg>'
    )


def _whiskers(canvas: Canvas, point: Point) -> str:
    """From quartile to quartile, as far as is known: the spread, half of it to either side."""
    x, y = canvas.x(point["time_ms"]), canvas.y(point["error"])
    low, high = (canvas.x(max(1e-9, point["time_ms"] + side * point["spread_ms"] / 2)) for side in (-1, 1))
    lines = f'<line class="whisker" x1="{low:.3f}%" x2="{high:.3f}%" y1="{y:.2f}" y2="{y:.2f}"/>'
    if point["error"] > 0:
        top, foot = (
            canvas.y(max(canvas.error.low, point["error"] + side * point["error_spread"] / 2)) for side in (1, -1)
        )
        lines += f'<line class="whisker" x1="{x:.3f}%" x2="{x:.3f}%" y1="{top:.2f}" y2="{foot:.2f}"/>'
    return lines


def _told(point: Point) -> str:
    words = f"{name_of(point)}\nerror {_percent(point['error'])}, {_duration(point['time_ms'])}"
    if flickers(point):
        words += f"\non the front in {point['front_share']:.0%} of resampled measurements"
    return words if point["on_front"] or point["instead"] is None else f"{words}\ntake instead: {point['instead']}"


def _legend(points: Sequence[Point]) -> str:
    def icon(kind: str) -> str:
        shape = "M6-1L13 6L6 13L-1 6Z" if kind == "preset" else "M2 6A4 4 0 1 0 10 6A4 4 0 1 0 2 6Z"
        return f'<svg class="icon" viewBox="-1 -1 14 14"><path class="choice {kind}" d="{shape}"/></svg>'

    entries = [f"<li>{icon('front')} on the front</li>", f"<li>{icon('aside')} dominated</li>"]
    if any(p["preset"] is not None for p in points):
        entries.insert(0, f"<li>{icon('preset')} preset</li>")
    entries += [
        f'<li><b class="key">{n}</b> {escape(p["label"])}</li>' for n, p in enumerate(_unnamed_front(points), 1)
    ]
    return f'<ul class="legend">{"".join(entries)}</ul>'


def _percent(error: float) -> str:
    """0.0005 as "0.05 %"."""
    return f"{significant(100 * error, 2)} %" if error else "0"


def _duration(time_ms: float) -> str:
    return with_unit(time_ms / 1000, "s", 2) if time_ms >= 1000 else with_unit(time_ms, "ms", 2)


LOGLOG_STYLE = """
.plot.wide { grid-column: 1 / -1; }
.choice { fill: var(--c); stroke: var(--card); stroke-width: 1.2; }
.choice.front { --c: var(--k0); }
.choice.aside { fill: var(--card); stroke: var(--quiet); }
.choice.preset { --c: var(--k1); }
.whisker { stroke: var(--quiet); stroke-opacity: .55; }
.axes text.name { fill: var(--ink); font-size: 14px; font-weight: 600; }
.axes text.number { font-size: 11.5px; font-weight: 600; }
.icon .choice { stroke-width: 1; }
.loglog { margin-left: 62px; width: calc(100% - 70px); }
.plots + .block, .block + .plots { margin-top: 20px; }
.apart { margin: 36px 0 12px; }
.answers dt { font-weight: 600; margin-top: 12px; }
.answers dd { margin: 2px 0 0; max-width: 90ch; }
"""
