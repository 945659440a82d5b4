"""How is one plot of the report drawn? Axes, curves, marks and hover columns as inline SVG, without a plotting library.

Horizontal places are percentages and vertical ones pixels, so one drawing fits every width with text of one size.
Curves are the exception: paths cannot hold percentages, so they live in an inner SVG that is stretched, with strokes
that are not. Rejected: one picture that is scaled, whose text cannot be read on a telephone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from xihe_blender.report.timeline import Timeline, is_active, moment_in_words, number, reason_shape
from xihe_blender.report.values import escape

HEIGHT_PX = 190
_MANY_FRAMES = 80
_AS_GOOD_AS_ZERO = 1e-12


@dataclass(frozen=True)
class Axis:
    """A vertical axis from 0 at the bottom to `top`, with its ticks."""

    top: float
    ticks: tuple[float, ...]
    label: Callable[[float], str]

    def y(self, value: float) -> float:
        """Pixels from the upper edge of the plot."""
        return HEIGHT_PX * (1 - value / self.top)


def nice_step(span: float, n_steps: int) -> float:
    """The smallest of 1, 2, 5 times a power of ten that covers `span` in at most `n_steps` steps."""
    power = 10.0 ** math.floor(math.log10(span / n_steps))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power * n_steps >= span * (1 - 1e-9))


def axis_up_to(largest: float, label: Callable[[float], str] | None = None) -> Axis:
    """An axis that ends at the first tick at or above `largest`, or at 1 where that is 0 or as good as 0."""
    largest = largest if largest > _AS_GOOD_AS_ZERO else 1.0
    step = nice_step(largest, 4)
    n_ticks = math.ceil(largest / step - 1e-9)
    return Axis(n_ticks * step, tuple(i * step for i in range(n_ticks + 1)), label or tick_label(step))


def tick_label(step: float) -> Callable[[float], str]:
    """As many decimals as the step has; an exponent where those would not fit beside the plot."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return (lambda v: f"{v:,.{decimals}f}") if decimals < 5 and step < 1e5 else (lambda v: f"{v:.3g}")


def plot(
    timeline: Timeline, axis: Axis, drawing: str, hover: Sequence[str], *, title: str, about: str, legend: str = ""
) -> str:
    """One plot: heading, explanation, drawing with axes, and a column per frame that tells its values.

    `title`, `about` and `legend` are HTML; `hover` holds escaped text, one entry per frame.
    """
    empty = "" if drawing else f'<text class="empty" x="50%" y="{HEIGHT_PX / 2}">{_why_empty(timeline)}</text>'
    body = _shading(timeline) + grid(axis) + _frame_axis(timeline) + drawing + empty + _columns(timeline, hover)
    return figure(body, title=title, about=about, label=f"{title}, per frame", legend=legend)


def figure(
    body: str,
    *,
    title: str,
    about: str,
    label: str = "",
    legend: str = "",
    classes: str = "axes",
    height_px: int = HEIGHT_PX,
) -> str:
    """A drawing below its heading and explanation; all is HTML, and `label`, or else the title, is for who listens."""
    return (
        f'<figure class="plot"><figcaption><h3>{title}</h3><p>{about}</p></figcaption>'
        f'<svg class="{classes}" role="img" aria-label="{label or title}" height="{height_px}">{body}</svg>'
        f"{legend}</figure>"
    )


def _why_empty(timeline: Timeline) -> str:
    return "no value in any frame" if any(map(is_active, timeline.frames)) else "no probe in view in any frame"


def _shading(timeline: Timeline) -> str:
    return "".join(
        f'<rect class="shade" x="{left:.3f}%" y="0" width="{right - left:.3f}%" height="{HEIGHT_PX}"/>'
        for left, right in timeline.inactive_spans()
    )


def grid(axis: Axis) -> str:
    """A line across for each tick, and its words to the left."""
    return "".join(
        f'<line class="{"grid" if tick else "base"}" x1="0" x2="100%" y1="{axis.y(tick):.1f}" y2="{axis.y(tick):.1f}"/>'
        f'<text class="tick-y" x="-8" y="{axis.y(tick):.1f}">{escape(axis.label(tick))}</text>'
        for tick in axis.ticks
    )


def _frame_axis(timeline: Timeline) -> str:
    """Round frame numbers below the plot, and the axis' name."""
    first, last = number(timeline.frames[0]), number(timeline.frames[-1])
    step = max(1, round(nice_step(max(1, last - first), 6)))
    ticks = [first] if first == last else list(range(math.ceil(first / step) * step, last + 1, step))
    half = timeline.bar_percent / 2
    places = [50.0 if first == last else half + (100 - 2 * half) * (t - first) / (last - first) for t in ticks]
    return axis_below(places, map(str, ticks), "frame")


def axis_below(places_percent: Iterable[float], words: Iterable[str], name: str) -> str:
    """Ticks below the plot, their words, and the axis' name."""
    marks = "".join(
        f'<line class="base" x1="{x:.3f}%" x2="{x:.3f}%" y1="{HEIGHT_PX}" y2="{HEIGHT_PX + 4}"/>'
        f'<text class="tick-x" x="{x:.3f}%" y="{HEIGHT_PX + 18}">{escape(word)}</text>'
        for x, word in zip(places_percent, words, strict=True)
    )
    return f'{marks}<text class="axis-x" x="100%" y="{HEIGHT_PX + 35}">{name}</text>'


def _columns(timeline: Timeline, hover: Sequence[str]) -> str:
    columns = []
    for index, (frame, words) in enumerate(zip(timeline.frames, hover, strict=True)):
        left, right = timeline.edges_percent[index : index + 2]
        words = words if is_active(frame) or words else "no probe in view"
        columns.append(
            f'<rect class="column" x="{left:.3f}%" y="0" width="{right - left:.3f}%" height="{HEIGHT_PX}">'
            f"<title>{moment_in_words(frame)}\n{words}</title></rect>"
        )
    return '<line class="now" y1="0" y2="100%"/>' + "".join(columns)


def curve(timeline: Timeline, axis: Axis, values: Sequence[float | None], classes: str) -> str:
    """A line with gaps at None, and dots where they help: few frames, or a value between two gaps."""
    path, dots = "", ""
    for index, value in enumerate(values):
        if value is None:
            continue
        x, y = timeline.centres_percent[index], axis.y(value)
        follows = index > 0 and values[index - 1] is not None
        path += f"{'L' if follows else 'M'}{10 * x:.2f} {y:.2f}"
        alone = not follows and (index + 1 == len(values) or values[index + 1] is None)
        if alone or len(values) <= _MANY_FRAMES:
            dots += f'<circle class="dot {classes}" cx="{x:.3f}%" cy="{y:.2f}" r="{3 if alone else 2.2}"/>'
    return stretched(f'<path class="line {classes}" d="{path}"/>') + dots if path else ""


def stretched(content: str) -> str:
    """Paths whose x runs from 0 to 1000, stretched to the plot's width."""
    view = f'viewBox="0 0 1000 {HEIGHT_PX}" preserveAspectRatio="none"'
    return f'<svg width="100%" height="{HEIGHT_PX}" {view}>{content}</svg>'


def mark(x_percent: float, y: float, reason: str, *, classes: str, words: str = "") -> str:
    """The shape for `reason`; `words`, escaped, are told on hovering."""
    path = f'<path class="mark {classes}" d="{reason_shape(reason)}"><title>{words}</title></path>'
    return f'<svg x="{x_percent:.3f}%" y="{y:.2f}" width="1" height="1">{path}</svg>'
