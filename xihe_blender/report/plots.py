"""Plots of what happened frame by frame: light error, change, coverage, milliseconds, payload.

What is undefined is a gap, a value between two gaps is a dot, frames without a position in view are shaded. Each mark
has one shape per reason for which an estimate was made. Hovering a frame's column names its values.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Sequence

from xihe_blender.io.run_results import ProbeResult, RunResults
from xihe_blender.report.invalid import format_kept
from xihe_blender.report.timeline import (
    KEPT,
    REASONS,
    Timeline,
    Value,
    fired_probes,
    format_moment,
    format_trigger,
    probe_in,
    reason_shape,
    series_class,
)
from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_bytes, format_number, format_percent, format_quantity
from xihenet.svg import HEIGHT_PX, Axis, linear_axis

LANE_PX = 15
_WIDEST_BAR_PERCENT = 10.0
_MANY_FRAMES = 80
_ABSOLUTE = "Mean squared difference of sRGB colour."
_RELATIVE = (
    "Change divided by the threshold that applied. Change is the mean squared difference of sRGB colour or, where "
    "coverage fired, the newly seen share of the sphere."
)
CHAIN = {
    "camera path": "the phone moves along the path of the scene's camera",
    "capture": "Cycles renders what the phone sees: colour and depth",
    "unproject": "the pixels become coloured points in the room",
    "sample": "of the points around each virtual object, the nearest in each direction is kept",
    "merge": "what this frame shows is added to what earlier frames showed",
    "trigger": "decides whether enough has changed for a new estimate",
    "encode": "if so, the samples are packed as they would be sent to a server",
    "estimate": "an estimator computes the light at the object: nine spherical-harmonic coefficients for each colour",
    "apply": "the estimate lights the virtual object from the frame at which it arrives",
    "compare": "the picture is compared with room and objects path-traced together",
}
REFLECT, IT_REFLECTS = "reflect", "what a frame shows is kept in finer directions too, for key lights and reflections"
STAGES = (*list(CHAIN)[2:-2], REFLECT)
"""Those of a frame's step, which are timed."""

_STAGES_LISTED = "".join(f"<li><b>{stage}</b>: {words}</li>" for stage, words in CHAIN.items())
_CHAIN_LISTED = (
    f'<details class="chain"><summary>The stages of the chain, in order</summary><ol>{_STAGES_LISTED}</ol>'
    f"<p>Beside <b>sample</b>, <b>{REFLECT}</b>: {IT_REFLECTS}.</p></details>"
)


def plots_section(results: RunResults) -> str:
    """All plots, with the legend of the probes that they share."""
    timeline = Timeline.of(results)
    if not timeline.frames:
        return "<p>The results hold no frame, so there is nothing to plot.</p>"
    plots = _error_plot(timeline, results.summary.ambient_shc_rmse) + _change_plot(timeline) + _coverage_plot(timeline)
    plots += _stage_plot(timeline) + _payload_plot(timeline)
    return f'{_shared_legend(timeline)}<div class="plots">{plots}</div>{_CHAIN_LISTED}'


def _shared_legend(timeline: Timeline) -> str:
    entries = [
        f'{_line_icon(f"line {series_class(i)}")}<b class="key">{i + 1}</b> {escape(name)}'
        for i, name in enumerate(timeline.probe_names)
    ]
    reasons = {probe.reason for probe in timeline.probes if probe.fired}
    known = [reason for reason in REASONS if reason in reasons]
    entries += [f"{svg.icon(reason_shape(reason))} estimate made: {format_trigger(reason)}" for reason in known]
    if not all(probe.is_valid for probe in timeline.probes):
        entries.append(f"{svg.icon(reason_shape(KEPT))} light unknown: the last estimate is kept")
    if timeline.inactive_spans():
        entries.append('<span class="shade-icon"></span> no position in view')
    return svg.legend(entries)


def _line_icon(classes: str) -> str:
    line = f'<line class="{classes}" x1="1" y1="6" x2="33" y2="6"/>'
    return f'<svg class="line-icon" viewBox="0 0 34 12" aria-hidden="true">{line}</svg>'


# ------------------------------------------------------------------------------------------- what all plots have


def plot(
    timeline: Timeline, axis: Axis, drawing: str, hover: Sequence[str], *, title: str, about: str, below: str = ""
) -> str:
    """One plot: heading, explanation, drawing with axes, and a column per frame that tells its values.

    `title`, `about` and `below` are HTML; `hover` holds escaped text, one entry per frame.
    """
    shades = "".join(
        f'<rect class="shade" x="{left:.3f}%" y="0" width="{right - left:.3f}%" height="{HEIGHT_PX}"/>'
        for left, right in timeline.inactive_spans()
    )
    was_in_view = any(frame.active for frame in timeline.frames)
    why_empty = "no value in any frame" if was_in_view else "no position in view in any frame"
    empty = "" if drawing else f'<text class="empty" x="50%" y="{HEIGHT_PX / 2}">{why_empty}</text>'
    body = shades + svg.grid_across(axis) + _frame_axis(timeline) + drawing + empty + _columns(timeline, hover)
    return svg.figure(body, title=title, about=about, label=f"{title}, per frame", below=below)


def _frame_axis(timeline: Timeline) -> str:
    """Round frame numbers below the plot, and the axis' name."""
    first, last = timeline.frames[0].frame, timeline.frames[-1].frame
    step = max(1, round(svg.nice_step(max(1, last - first), 6)))
    ticks = [first] if first == last else list(range(math.ceil(first / step) * step, last + 1, step))
    half = timeline.bar_percent / 2
    places = [50.0 if first == last else half + (100 - 2 * half) * (t - first) / (last - first) for t in ticks]
    return svg.axis_below(places, map(str, ticks), "frame")


def _columns(timeline: Timeline, hover: Sequence[str]) -> str:
    columns = '<line class="now" y1="0" y2="100%"/>'
    edges = itertools.pairwise(timeline.edges_percent)
    for frame, (left, right), words in zip(timeline.frames, edges, hover, strict=True):
        words = words if frame.active or words else "no position in view"
        columns += (
            f'<rect class="column" x="{left:.3f}%" y="0" width="{right - left:.3f}%" height="{HEIGHT_PX}">'
            f"<title>{format_moment(frame)}\n{words}</title></rect>"
        )
    return columns


def _curves(timeline: Timeline, axis: Axis, value_of: Value) -> str:
    """A line per probe, dots where they help, and marks where an estimate was made."""
    lines = "".join(
        _curve(timeline, [None if v is None else axis.y(v) for v in timeline.values(name, value_of)], series_class(i))
        for i, name in enumerate(timeline.probe_names)
    )
    marks = "".join(
        _mark(timeline, x, axis.y(value), probe)
        for x, frame in zip(timeline.centres_percent, timeline.frames, strict=True)
        for probe in fired_probes(frame)
        if (value := value_of(probe)) is not None
    )
    return lines + marks


def _curve(timeline: Timeline, heights: Sequence[float | None], classes: str) -> str:
    """With gaps at None, and dots where frames are few or a value lies between two gaps."""
    points = [None if y is None else (x, y) for x, y in zip(timeline.centres_percent, heights, strict=True)]
    dots = ""
    for before, point, after in zip([None, *points], points, [*points[1:], None], strict=False):
        is_alone = before is None and after is None
        if point is not None and (is_alone or len(points) <= _MANY_FRAMES):
            dots += svg.dot(*point, f"dot {classes}", radius=3 if is_alone else 2.2)
    return svg.line(points, classes) + dots


def _mark(timeline: Timeline, x: float, y: float, probe: ProbeResult, reason: str = "", words: str = "") -> str:
    """In the probe's colour, in the shape of why its estimate was made."""
    index = timeline.probe_names.index(probe.name)
    return svg.mark(x, y, reason_shape(reason or probe.reason), f"mark {series_class(index)}", words)


def _hover(timeline: Timeline, describe: Callable[[ProbeResult], str]) -> list[str]:
    """Per frame one line for each probe in view: its key, its name, what `describe` says, whether one was made."""
    return [
        "\n".join(
            f"{index + 1} {escape(name)}: {describe(probe)}{_format_made(probe)}{format_kept(probe)}"
            for index, name in enumerate(timeline.probe_names)
            if (probe := probe_in(frame, name))
        )
        for frame in timeline.frames
    ]


def _format_made(probe: ProbeResult) -> str:
    return f", estimate made: {format_trigger(probe.reason)}" if probe.fired else ""


def _limit(axis: Axis, value: float, words: str) -> tuple[str, str]:
    """A dashed line across at `value`, and its legend."""
    return svg.straight(0, axis.y(value), 100, axis.y(value), "limit"), svg.legend(
        [f"{_line_icon('limit')}<span>{words}</span>"]
    )


# ------------------------------------------------------------------------------------------------------ the plots


def _error_plot(timeline: Timeline, ambient: float | None) -> str:
    known = timeline.known_values(lambda probe: probe.shc_rmse)
    if timeline.probe_names and not known:  # Of a recording, which has no truth.
        return ""
    axis = linear_axis(0, max([*known, ambient or 0.0]))
    drawing, below = _curves(timeline, axis, lambda probe: probe.shc_rmse), ""
    if drawing and ambient is not None:
        limit, below = _limit(axis, ambient, f"<code>ambient</code>, mean over the run: {format_number(ambient)}")
        drawing = limit + drawing
    hover = _hover(timeline, lambda probe: format_number(probe.shc_rmse))
    about = "SHC RMSE between the coefficients in use and the rendered light probe. No unit; 0 is a perfect estimate."
    return plot(timeline, axis, drawing, hover, title="Light error", about=about, below=below)


def _change_plot(timeline: Timeline) -> str:
    """Change and threshold. Where thresholds differ between frames or probes, the change is drawn relative to them."""
    thresholds = set(timeline.known_values(lambda probe: probe.threshold))
    is_relative = len(thresholds) > 1
    threshold = 1.0 if is_relative else next(iter(thresholds), None)

    def change(probe: ProbeResult) -> float | None:
        if not is_relative or probe.change is None:
            return probe.change
        return probe.change / probe.threshold if probe.threshold else None

    axis = linear_axis(0, max([*timeline.known_values(change), 1.05 * (threshold or 0.0)]))
    drawing, below = _curves(timeline, axis, change), _lanes(timeline)
    if threshold is not None:
        words = "threshold" if is_relative else f"threshold {format_number(threshold)}"
        limit, legend = _limit(axis, threshold, words)
        drawing, below = limit + drawing, below + legend
    rows = "The rows below show when and why an estimate was made, or why it could not be."
    about = f"{_RELATIVE if is_relative else _ABSOLUTE} {rows}"
    title = "Change against the trigger threshold"
    return plot(timeline, axis, drawing, _hover(timeline, _format_change), title=title, about=about, below=below)


def _format_change(probe: ProbeResult) -> str:
    words = "no change to compare" if probe.change is None else f"change {format_number(probe.change)}"
    return words + ("" if probe.threshold is None else f", threshold {format_number(probe.threshold)}")


def _lanes(timeline: Timeline) -> str:
    """One row per probe with a mark at each frame for which its estimate was made, or its light could not be known."""
    if not any(probe.fired or not probe.is_valid for probe in timeline.probes):
        return ""
    rows = ""
    for index, name in enumerate(timeline.probe_names):
        y = LANE_PX * (index + 0.5)
        rows += f'<text class="tick-y" x="-8" y="{y}">{index + 1}</text>{svg.straight(0, y, 100, y, "grid")}'
        for x, frame in zip(timeline.centres_percent, timeline.frames, strict=True):
            probe = probe_in(frame, name)
            if probe and (probe.fired or not probe.is_valid):
                made = format_trigger(probe.reason) if probe.fired else "no estimate"
                words = f"{format_moment(frame)}\n{escape(name)}: {made}{format_kept(probe)}"
                rows += _mark(timeline, x, y, probe, "" if probe.is_valid else KEPT, words)
    height = LANE_PX * len(timeline.probe_names)
    return f'<svg class="lanes" role="img" aria-label="Estimates made, by position" height="{height}">{rows}</svg>'


def _coverage_plot(timeline: Timeline) -> str:
    axis = Axis(0.0, 1.0, (0.0, 0.25, 0.5, 0.75, 1.0), format_percent)
    hover = _hover(timeline, lambda probe: format_percent(probe.coverage))
    about = "Share of the directions around the position that the camera has seen. The rest has to be guessed."
    drawing = _curves(timeline, axis, lambda probe: probe.coverage)
    return plot(timeline, axis, drawing, hover, title="Coverage", about=about)


def _stage_plot(timeline: Timeline) -> str:
    """Stacked bars. A frame that towers over the others is cut off, marked and named, or it would flatten them all."""
    stages = [[frame.stage_ms.get(stage, 0.0) for stage in STAGES] for frame in timeline.frames]
    totals = [sum(values) for values in stages]
    axis = linear_axis(0, _shown_up_to(totals))
    bars = _stacked_bars(timeline, axis, stages)
    drawing = svg.stretched(bars) + _cut_off_marks(timeline, axis, totals) if bars else ""
    about = "Milliseconds of the chain at all positions, without rendering; stacked as listed, from the bottom up."
    hover, below = _stage_hover(timeline), _stage_legend(timeline)
    return plot(timeline, axis, drawing, hover, title="Time per stage", about=about, below=below)


def _stacked_bars(timeline: Timeline, axis: Axis, stages: Sequence[Sequence[float]]) -> str:
    """One path per stage with a rectangle per frame; what lies above the axis is cut off."""
    paths = [""] * len(STAGES)
    half = 10 * min(0.4 * timeline.bar_percent, _WIDEST_BAR_PERCENT / 2)
    for x, values in zip(timeline.centres_percent, stages, strict=True):
        below = 0.0
        for index, value in enumerate(values):
            low, high = min(below, axis.high), min(below + value, axis.high)
            below += value
            if high > low:
                height = axis.y(low) - axis.y(high)
                paths[index] += f"M{10 * x - half:.2f} {axis.y(high):.2f}h{2 * half:.2f}v{height:.2f}h{-2 * half:.2f}Z"
    return "".join(f'<path class="bar b{index}" d="{path}"/>' for index, path in enumerate(paths) if path)


def _shown_up_to(totals: Sequence[float]) -> float:
    """The largest total, or less where a few frames tower over nine in ten of the others."""
    ordered = sorted(total for total in totals if total > 0)
    if len(ordered) < 5:
        return max(ordered, default=0.0)
    usual = ordered[math.ceil(0.9 * len(ordered)) - 1] if len(ordered) >= 10 else ordered[-2]
    return 1.25 * usual if ordered[-1] > 2.5 * usual else ordered[-1]


def _cut_off_marks(timeline: Timeline, axis: Axis, totals: Sequence[float]) -> str:
    marks = ""
    for x, total in zip(timeline.centres_percent, totals, strict=True):
        if total > axis.high:
            side, shift = ("start", 8) if x < 50 else ("end", -8)
            words = f'<text class="cut" x="{shift}" y="0" text-anchor="{side}">{format_quantity(total, "ms")}</text>'
            arrow = f'<path class="cut" d="M0-5L5 4L-5 4Z"/>{words}'
            marks += f'<svg x="{x:.3f}%" y="-9" width="1" height="1">{arrow}</svg>'
    return marks


def _stage_hover(timeline: Timeline) -> list[str]:
    words = []
    for frame in timeline.frames:
        known = {stage: frame.stage_ms[stage] for stage in STAGES if stage in frame.stage_ms}
        lines = [f"{stage}: {format_quantity(value, 'ms')}" for stage, value in known.items()]
        total = format_quantity(math.fsum(known.values()), "ms")
        words.append("\n".join([*reversed(lines), f"together: {total}"]) if lines else "")
    return words


def _stage_legend(timeline: Timeline) -> str:
    entries = []
    for index, stage in enumerate(STAGES):
        known = [frame.stage_ms[stage] for frame in timeline.frames if stage in frame.stage_ms]
        if stage == REFLECT and not known:
            continue
        median = f"median {format_quantity(statistics.median(known), 'ms', 2)}" if known else "not measured"
        entries.append(f'<span class="swatch b{index}"></span>{stage} <span class="quiet">{median}</span>')
    return svg.legend(entries)


def _payload_plot(timeline: Timeline) -> str:
    """A dot on a stem for each encoded cloud; nothing where none was sent."""
    sent = [
        (x, probe)
        for x, frame in zip(timeline.centres_percent, timeline.frames, strict=True)
        for name in timeline.probe_names
        if (probe := probe_in(frame, name)) and probe.payload_bytes
    ]
    largest = max((probe.payload_bytes for _, probe in sent), default=1000)
    axis = linear_axis(0, largest, label=lambda size: f"{size:g} B" if largest < 1000 else f"{size / 1000:g} kB")
    drawing = "".join(svg.straight(x, HEIGHT_PX, x, axis.y(p.payload_bytes), "stem") for x, p in sent)
    drawing += "".join(_mark(timeline, x, axis.y(p.payload_bytes), p) for x, p in sent)
    total = f"{format_bytes(sum(p.payload_bytes for _, p in sent))} in all" if sent else "Nothing was sent"
    about = f"Size of each encoded cloud, as it would be sent to the estimator. {total}."
    hover = _hover(timeline, lambda p: format_bytes(p.payload_bytes) if p.payload_bytes else "nothing sent")
    return plot(timeline, axis, drawing, hover, title="Payload", about=about)
