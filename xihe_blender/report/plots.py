"""What happened frame by frame? Five plots: coefficient error, change, coverage, milliseconds, payload.

Null values are gaps, a value between two gaps is a dot, frames without a probe in view are shaded. Each mark has one
shape per reason for which an estimate was made. Hovering a frame's column names its values.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from xihe_blender.report.invalid import is_kept, kept_in_words
from xihe_blender.report.svg import HEIGHT_PX, Axis, axis_up_to, curve, mark, plot, stretched
from xihe_blender.report.timeline import (
    KEPT,
    REASONS,
    Timeline,
    fired_probes,
    moment_in_words,
    probe_in,
    probe_name,
    reason_icon,
    reason_in_words,
    reason_of,
    series_class,
)
from xihe_blender.report.values import (
    byte_size,
    escape,
    finite,
    finite_only,
    items,
    mapping,
    percent,
    significant,
    with_unit,
)

STAGES = ("unproject", "sample", "merge", "trigger", "encode", "estimate")
LANE_PX = 15
_WIDEST_BAR_PERCENT = 10.0
_ABSOLUTE = "Mean squared difference of sRGB colour."
_RELATIVE = (
    "Divided by the threshold that decided. The change is the mean squared difference of sRGB colour or, where coverage"
    " fired, the newly seen share of the sphere."
)
CHAIN = {
    "camera path": "the phone walks through the room",
    "capture": "its colour picture and distances are rendered",
    "unproject": "pixels become coloured points in the room",
    "sample": "around each probe, every direction keeps its nearest point",
    "merge": "what this frame saw is added to what was seen before",
    "trigger": "is there enough news for another estimate?",
    "encode": "what is known is packed as it would be sent",
    "estimate": "spherical harmonics of the light at the probe",
    "apply": "the virtual objects are lit by them",
    "compare": "and set beside the path-traced ground truth",
}
_CHAIN_TOLD = (
    '<details class="chain"><summary>The stages of the chain, in order</summary><ol>'
    + "".join(f"<li><b>{stage}</b>: {told}</li>" for stage, told in CHAIN.items())
    + "</ol></details>"
)


def plots_section(results: Mapping[str, Any]) -> str:
    """All plots, with the legend of the probes that they share."""
    timeline = Timeline.of(results)
    if not timeline.frames:
        return "<p>The results hold no frame, so there is nothing to plot.</p>"
    plots = [_error_plot(timeline, results), _change_plot(timeline), _coverage_plot(timeline)]
    plots += [_stage_plot(timeline), _payload_plot(timeline)]
    return f'{_shared_legend(timeline)}<div class="plots">{"".join(plots)}</div>{_CHAIN_TOLD}'


def _shared_legend(timeline: Timeline) -> str:
    entries = [
        f'<li>{_line_icon(series_class(i))}<b class="key">{i + 1}</b> {escape(name)}</li>'
        for i, name in enumerate(timeline.probe_names)
    ]
    reasons = sorted({reason_of(p) for f in timeline.frames for p in fired_probes(f)}, key=_reason_order)
    entries += [f"<li>{reason_icon(reason)} estimate made: {reason_in_words(reason)}</li>" for reason in reasons]
    if any(is_kept(probe) for frame in timeline.frames for probe in items(frame, "probes")):
        entries.append(f"<li>{reason_icon(KEPT)} light could not be known: the last one stays</li>")
    if timeline.inactive_spans():
        entries.append('<li><span class="shade-icon"></span> no probe in view</li>')
    return f'<ul class="legend">{"".join(entries)}</ul>'


def _reason_order(reason: str) -> tuple[int, str]:
    known = list(REASONS)
    return (known.index(reason) if reason in known else len(known), reason)


def _line_icon(classes: str) -> str:
    line = f'<line class="line {classes}" x1="1" y1="6" x2="33" y2="6"/>'
    return f'<svg class="line-icon" viewBox="0 0 34 12" aria-hidden="true">{line}</svg>'


def _curves(timeline: Timeline, axis: Axis, key: str) -> str:
    return "".join(
        curve(timeline, axis, timeline.values(name, key), series_class(i))
        for i, name in enumerate(timeline.probe_names)
    )


def _fired_marks(timeline: Timeline, axis: Axis, key: str) -> str:
    """Marks on the curves where an estimate was made."""
    marks = ""
    for index, frame in enumerate(timeline.frames):
        for probe in fired_probes(frame):
            value = finite(probe.get(key))
            if value is not None:
                place = timeline.probe_names.index(probe_name(probe))
                marks += mark(
                    timeline.centres_percent[index], axis.y(value), reason_of(probe), classes=series_class(place)
                )
    return marks


def _hover(timeline: Timeline, tell: Callable[[Mapping[str, Any]], str | None]) -> list[str]:
    """Per frame one line for each probe in view: its key, its name and what `tell` says of it."""
    words = []
    for frame in timeline.frames:
        lines = [
            f"{place + 1} {escape(name)}: {told}"
            for place, name in enumerate(timeline.probe_names)
            if (probe := probe_in(frame, name)) and (told := tell(probe)) is not None
        ]
        words.append("\n".join(lines))
    return words


def _fired_in_words(probe: Mapping[str, Any]) -> str:
    made = f", estimate made: {reason_in_words(reason_of(probe))}" if probe.get("fired") else ""
    return made + kept_in_words(probe)


def _error_plot(timeline: Timeline, results: Mapping[str, Any]) -> str:
    ambient = finite(mapping(results, "summary").get("ambient_shc_rmse"))
    known = [v for name in timeline.probe_names for v in finite_only(timeline.values(name, "shc_rmse"))]
    axis = axis_up_to(max([*known, ambient or 0.0]))
    drawing = _curves(timeline, axis, "shc_rmse") + _fired_marks(timeline, axis, "shc_rmse")
    legend = ""
    if drawing and ambient is not None:
        drawing = _limit_line(axis, ambient) + drawing
        legend = _limit_legend(f"<code>ambient</code>, mean over the run: {significant(ambient)}")
    hover = _hover(timeline, lambda p: significant(finite(p.get("shc_rmse"))) + _fired_in_words(p))
    about = "SHC RMSE between the coefficients in force and the rendered light probe. No unit; 0 is a perfect estimate."
    return plot(timeline, axis, drawing, hover, title="Coefficient error", about=about, legend=legend)


def _limit_line(axis: Axis, value: float) -> str:
    y = f"{axis.y(value):.2f}"
    return f'<line class="limit" x1="0" x2="100%" y1="{y}" y2="{y}"/>'


def _limit_legend(words: str) -> str:
    line = '<line class="limit" x1="1" y1="6" x2="33" y2="6"/>'
    icon = f'<svg class="line-icon" viewBox="0 0 34 12" aria-hidden="true">{line}</svg>'
    return f'<ul class="legend"><li>{icon}<span>{words}</span></li></ul>'


def _change_plot(timeline: Timeline) -> str:
    """Change and threshold. Where thresholds differ between frames or probes, the change is drawn relative to them."""
    probes = [probe for frame in timeline.frames for probe in items(frame, "probes")]
    thresholds = sorted(set(finite_only(probe.get("threshold") for probe in probes)))
    is_relative = len(thresholds) > 1
    limit = 1.0 if is_relative else next(iter(thresholds), None)
    shown = _with_shown_change(timeline, is_relative=is_relative)
    known = [v for name in shown.probe_names for v in finite_only(shown.values(name, "shown_change"))]
    axis = axis_up_to(max([*known, 1.05 * (limit or 0.0)]))
    drawing = _curves(shown, axis, "shown_change") + _fired_marks(shown, axis, "shown_change")
    legend = _lanes(timeline)
    if probes and limit is not None:
        drawing = _limit_line(axis, limit) + drawing
        legend += _limit_legend("threshold" if is_relative else f"threshold {significant(limit)}")
    rows = "The rows below tell when and why an estimate was made, or could not be."
    about = f"{_RELATIVE if is_relative else _ABSOLUTE} {rows}"
    title, hover = "Change against the trigger threshold", _hover(timeline, _change_in_words)
    return plot(timeline, axis, drawing, hover, title=title, about=about, legend=legend)


def _with_shown_change(timeline: Timeline, *, is_relative: bool) -> Timeline:
    def shown(probe: Mapping[str, Any]) -> float | None:
        change, threshold = finite(probe.get("change")), finite(probe.get("threshold"))
        if not is_relative or change is None:
            return change
        return change / threshold if threshold else None

    frames = tuple(
        {**frame, "probes": [{**p, "shown_change": shown(p)} for p in items(frame, "probes")]}
        for frame in timeline.frames
    )
    return replace(timeline, frames=frames)


def _change_in_words(probe: Mapping[str, Any]) -> str:
    change, threshold = finite(probe.get("change")), finite(probe.get("threshold"))
    words = "no change to compare" if change is None else f"change {significant(change)}"
    return words + ("" if threshold is None else f", threshold {significant(threshold)}") + _fired_in_words(probe)


def _lanes(timeline: Timeline) -> str:
    """One row per probe with a mark at each frame for which its estimate was made, or its light could not be known."""
    if not any(p.get("fired") or is_kept(p) for frame in timeline.frames for p in items(frame, "probes")):
        return ""
    rows = ""
    for place, name in enumerate(timeline.probe_names):
        y = LANE_PX * (place + 0.5)
        rows += f'<text class="tick-y" x="-8" y="{y}">{place + 1}</text>'
        rows += f'<line class="grid" x1="0" x2="100%" y1="{y}" y2="{y}"/>'
        for x, frame in zip(timeline.centres_percent, timeline.frames, strict=True):
            probe = probe_in(frame, name)
            if probe.get("fired") or is_kept(probe):
                told = (reason_in_words(reason_of(probe)) if probe.get("fired") else "no estimate") + kept_in_words(
                    probe
                )
                words = f"{moment_in_words(frame)}\n{escape(name)}: {told}"
                rows += mark(
                    x, y, KEPT if is_kept(probe) else reason_of(probe), classes=series_class(place), words=words
                )
    height = LANE_PX * len(timeline.probe_names)
    return f'<svg class="lanes" role="img" aria-label="Estimates made, a row per probe" height="{height}">{rows}</svg>'


def _coverage_plot(timeline: Timeline) -> str:
    axis = Axis(1.0, (0.0, 0.25, 0.5, 0.75, 1.0), percent)
    drawing = _curves(timeline, axis, "coverage") + _fired_marks(timeline, axis, "coverage")
    hover = _hover(timeline, lambda p: percent(finite(p.get("coverage"))) + _fired_in_words(p))
    about = "Share of the directions around the probe that the camera has seen. The rest has to be guessed."
    return plot(timeline, axis, drawing, hover, title="Coverage", about=about)


def _stage_plot(timeline: Timeline) -> str:
    """Stacked bars. A frame that towers over the others is cut off, marked and named, or it would flatten them all."""
    stages = [[finite(mapping(f, "stage_ms").get(stage)) or 0.0 for stage in STAGES] for f in timeline.frames]
    totals = [sum(values) for values in stages]
    axis = axis_up_to(_shown_up_to(totals))
    bars = _stacked_bars(timeline, axis, stages)
    drawing = stretched(bars) + _cut_off_marks(timeline, axis, totals) if bars else ""
    about = "Milliseconds of the chain without rendering, all probes together; stacked as listed, from the bottom up."
    hover, legend = _stage_hover(timeline), _stage_legend(timeline)
    return plot(timeline, axis, drawing, hover, title="Time per stage", about=about, legend=legend)


def _stacked_bars(timeline: Timeline, axis: Axis, stages: Sequence[Sequence[float]]) -> str:
    """One path per stage with a rectangle per frame; what lies above the axis is cut off."""
    paths = [""] * len(STAGES)
    half = 10 * min(0.4 * timeline.bar_percent, _WIDEST_BAR_PERCENT / 2)
    for x, values in zip(timeline.centres_percent, stages, strict=True):
        below = 0.0
        for place, value in enumerate(values):
            low, high = min(below, axis.top), min(below + value, axis.top)
            below += value
            if high > low:
                height = axis.y(low) - axis.y(high)
                paths[place] += f"M{10 * x - half:.2f} {axis.y(high):.2f}h{2 * half:.2f}v{height:.2f}h{-2 * half:.2f}Z"
    return "".join(f'<path class="bar b{place}" d="{path}"/>' for place, path in enumerate(paths) if path)


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
        if total > axis.top:
            side, shift = ("start", 8) if x < 50 else ("end", -8)
            words = f'<text class="cut" x="{shift}" y="0" text-anchor="{side}">{with_unit(total, "ms")}</text>'
            marks += (
                f'<svg x="{x:.3f}%" y="-9" width="1" height="1"><path class="cut" d="M0-5L5 4L-5 4Z"/>{words}</svg>'
            )
    return marks


def _stage_hover(timeline: Timeline) -> list[str]:
    words = []
    for frame in timeline.frames:
        known = [(stage, finite(mapping(frame, "stage_ms").get(stage))) for stage in STAGES]
        lines = [f"{stage}: {with_unit(value, 'ms')}" for stage, value in known if value is not None]
        total = with_unit(math.fsum(finite_only(value for _, value in known)), "ms")
        words.append("\n".join([*reversed(lines), f"together: {total}"]) if lines else "")
    return words


def _stage_legend(timeline: Timeline) -> str:
    entries = ""
    for place, stage in enumerate(STAGES):
        known = finite_only(mapping(frame, "stage_ms").get(stage) for frame in timeline.frames)
        told = f"median {with_unit(statistics.median(known), 'ms', 2)}" if known else "not measured"
        entries += f'<li><span class="swatch b{place}"></span>{stage} <span class="quiet">{told}</span></li>'
    return f'<ul class="legend">{entries}</ul>'


def _payload_plot(timeline: Timeline) -> str:
    """A dot on a stem for each encoded cloud; nothing where none was sent."""
    sent = [
        (x, place, size, probe)
        for x, frame in zip(timeline.centres_percent, timeline.frames, strict=True)
        for place, name in enumerate(timeline.probe_names)
        if (size := finite((probe := probe_in(frame, name)).get("payload_bytes")))
    ]
    axis = _payload_axis(max((size for _, _, size, _ in sent), default=0.0))
    drawing = "".join(
        f'<line class="stem" x1="{x:.3f}%" x2="{x:.3f}%" y1="{HEIGHT_PX}" y2="{axis.y(size):.2f}"/>'
        for x, _, size, _ in sent
    ) + "".join(mark(x, axis.y(size), reason_of(probe), classes=series_class(place)) for x, place, size, probe in sent)
    hover = _hover(timeline, _payload_in_words)
    total = f"{byte_size(sum(size for _, _, size, _ in sent))} in all" if sent else "Nothing was sent"
    about = f"Size of each encoded cloud, as it would be sent to the estimator. {total}."
    return plot(timeline, axis, drawing, hover, title="Payload", about=about)


def _payload_axis(largest: float) -> Axis:
    if 0 < largest < 1000:
        return axis_up_to(largest, lambda size: f"{size:g} B")
    return axis_up_to(largest or 1000.0, lambda size: f"{size / 1000:g} kB")


def _payload_in_words(probe: Mapping[str, Any]) -> str:
    size = finite(probe.get("payload_bytes"))
    return (byte_size(size) if size else "nothing sent") + _fired_in_words(probe)
