"""Plots as SVG, without a plotting library: axes, lines, marks and the figure around them, for every report there is.

Places across are percentages and places down pixels, so one drawing fits every width with text of one size. Paths
cannot hold percentages, so they live in an inner SVG that is stretched, with strokes that are not. Colours and widths
are CSS classes: a page's style follows the reader's light or dark, and every mark names its value on hovering.

Rejected: one picture that is scaled, whose text cannot be read on a telephone; matplotlib, which the add-on would have
to bundle, and whose pictures neither follow the page's colours nor tell what is under the pointer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape

from xihenet.formats import MINUS

HEIGHT_PX = 190
SHAPES = {
    "diamond": "M0-6.5L6 0L0 6.5L-6 0Z",
    "circle": "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0Z",
    "triangle": "M0-6L6 5L-6 5Z",
    "square": "M-4.5-4.5h9v9h-9Z",
    "cross": "M-5-3L-3-5L0-2L3-5L5-3L2 0L5 3L3 5L0 2L-3 5L-5 3L-2 0Z",
}
"""Paths around the origin, some 12 pixels wide, so that marks are told apart without colour."""

_AS_GOOD_AS_ZERO = 1e-12
_DIVISIONS = ((1,), (1, 2, 5), (1, 1.5, 2, 3, 5, 7), (1, 1.2, 1.4, 1.6, 1.8, 2, 2.5, 3, 3.5, 4, 4.5, 5, 6, 7, 8, 9))
_ROOM = 1.25
"""Factor that is left free beyond the outermost marks of a logarithmic axis."""

Label = Callable[[float], str]


@dataclass(frozen=True)
class Axis:
    """From `low` to `high`, with its ticks and their words; over powers of ten where `is_log`."""

    low: float
    high: float
    ticks: tuple[float, ...]
    label: Label
    is_log: bool = False

    def share(self, value: float) -> float:
        """0 at the low end, 1 at the high one; beyond them outside the axis."""
        if self.is_log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def x(self, value: float) -> float:
        """Percent from the left edge of the plot."""
        return 100 * self.share(value)

    def y(self, value: float, height_px: float = HEIGHT_PX) -> float:
        """Pixels from the upper edge of the plot."""
        return height_px * (1 - self.share(value))


def linear_axis(low: float, high: float, *, n_steps: int = 4, label: Label | None = None) -> Axis:
    """Round ticks from the one at or below `low` to the one at or above `high`; 0 to 1 where both are 0."""
    if max(abs(low), abs(high)) <= _AS_GOOD_AS_ZERO:
        low, high = 0.0, 1.0
    step = nice_step(high - low if high - low > _AS_GOOD_AS_ZERO else abs(high), n_steps)
    first = math.floor(low / step + 1e-9)
    last = max(math.ceil(high / step - 1e-9), first + 1)
    ticks = tuple(i * step for i in range(first, last + 1))
    return Axis(ticks[0], ticks[-1], ticks, label or tick_label(step))


def log_axis(values: Sequence[float], label: Label) -> Axis:
    """With room on both sides; half a power of ten at least. Values must be above 0; none gives 1 to 10.

    Ticks are the coarsest of some divisions of a power of ten that gives three; the finest where none does.
    """
    low, high = (min(values), max(values)) if values else (1.0, 10.0)
    middle = math.sqrt(low * high)
    low, high = min(low / _ROOM, middle / 1.8), max(high * _ROOM, middle * 1.8)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks: tuple[float, ...] = ()
    for steps in _DIVISIONS:
        ticks = tuple(tick for power in powers for step in steps if low <= (tick := step * 10.0**power) <= high)
        if len(ticks) >= 3:
            break
    return Axis(low, high, ticks, label, is_log=True)


def nice_step(span: float, n_steps: int) -> float:
    """The smallest of 1, 2, 5 times a power of ten that covers `span` in at most `n_steps` steps."""
    power = 10.0 ** math.floor(math.log10(span / n_steps))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power * n_steps >= span * (1 - 1e-9))


def tick_label(step: float) -> Label:
    """As many decimals as the step has; an exponent where those would not fit beside the plot."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    form = f",.{decimals}f" if decimals < 5 and step < 1e5 else ".3g"
    return lambda value: f"{value:{form}}".replace("-", MINUS)


def grid_across(axis: Axis, height_px: float = HEIGHT_PX) -> str:
    """A line across for each tick of an upright axis, and its words to the left."""
    places = [(f"{axis.y(tick, height_px):.1f}", tick) for tick in axis.ticks]
    return "".join(
        f'<line class="{"grid" if tick else "base"}" x1="0" x2="100%" y1="{y}" y2="{y}"/>'
        f'<text class="tick-y" x="-8" y="{y}">{escape(axis.label(tick))}</text>'
        for y, tick in places
    )


def axis_below(
    places_percent: Iterable[float],
    words: Iterable[str],
    name: str,
    height_px: float = HEIGHT_PX,
    *,
    grid: bool = False,
) -> str:
    """Ticks below the plot, or with `grid` lines through it, their words, and the axis' name."""
    top, kind = (0.0, "grid") if grid else (height_px + 4, "base")
    marks = "".join(
        f'<line class="{kind}" x1="{x:.3f}%" x2="{x:.3f}%" y1="{height_px:g}" y2="{top:g}"/>'
        f'<text class="tick-x" x="{x:.3f}%" y="{height_px + 18:g}">{escape(word)}</text>'
        for x, word in zip(places_percent, words, strict=True)
    )
    return f'{marks}<text class="axis-x" x="100%" y="{height_px + 35:g}">{escape(name)}</text>'


def axis_of(axis: Axis, name: str, height_px: float = HEIGHT_PX, *, grid: bool = False) -> str:
    """`axis_below` with the ticks of `axis`."""
    return axis_below(map(axis.x, axis.ticks), map(axis.label, axis.ticks), name, height_px, grid=grid)


def stretched(content: str, height_px: float = HEIGHT_PX) -> str:
    """Paths whose x runs from 0 to 1000, stretched to the plot's width."""
    view = f'viewBox="0 0 1000 {height_px:g}" preserveAspectRatio="none"'
    return f'<svg width="100%" height="{height_px:g}" {view}>{content}</svg>'


def line(points: Iterable[tuple[float, float] | None], classes: str, height_px: float = HEIGHT_PX) -> str:
    """Through points (percent, pixels), with a gap at each None; nothing without points."""
    path, follows = "", False
    for point in points:
        if point is not None:
            path += f"{'L' if follows else 'M'}{10 * point[0]:.2f} {point[1]:.2f}"
        follows = point is not None
    return stretched(f'<path class="line {classes}" d="{path}"/>', height_px) if path else ""


def straight(x1: float, y1: float, x2: float, y2: float, classes: str) -> str:
    """From one place (percent, pixels) to another."""
    return f'<line class="{classes}" x1="{x1:.3f}%" x2="{x2:.3f}%" y1="{y1:.2f}" y2="{y2:.2f}"/>'


def dot(x_percent: float, y: float, classes: str, words: str = "", *, radius: float = 4) -> str:
    """A round dot; `words`, escaped here, are told on hovering."""
    title = f"<title>{escape(words)}</title>" if words else ""
    return f'<circle class="{classes}" cx="{x_percent:.3f}%" cy="{y:.2f}" r="{radius:g}">{title}</circle>'


def mark(x_percent: float, y: float, shape: str, classes: str, words: str = "", beside: str = "") -> str:
    """One of SHAPES; `words`, escaped already, are told on hovering, and `beside` is SVG around the same place."""
    path = f'<path class="{classes}" d="{SHAPES[shape]}"><title>{words}</title></path>'
    return f'<svg x="{x_percent:.3f}%" y="{y:.2f}" width="1" height="1">{path}{beside}</svg>'


def icon(shape: str, classes: str = "") -> str:
    """One of SHAPES as a picture within a line of text."""
    named = f' class="{classes}"' if classes else ""
    return f'<svg class="icon" viewBox="-8 -8 16 16" aria-hidden="true"><path{named} d="{SHAPES[shape]}"/></svg>'


def legend(entries: Iterable[str]) -> str:
    """A list of HTML entries below a plot."""
    return f'<ul class="legend">{"".join(f"<li>{entry}</li>" for entry in entries)}</ul>'


def figure(
    body: str, *, title: str, about: str, label: str = "", below: str = "", classes: str = "axes",
    height_px: float = HEIGHT_PX, is_wide: bool = False,
) -> str:  # fmt: skip
    """A drawing below its heading and explanation; all is HTML, and `label`, or else the title, is for who listens."""
    drawing = f'<svg class="{classes}" role="img" aria-label="{label or title}" height="{height_px:g}">{body}</svg>'
    return (
        f'<figure class="plot{" wide" if is_wide else ""}"><figcaption><h3>{title}</h3><p>{about}</p></figcaption>'
        f"{drawing if body else ''}{below}</figure>"
    )
