"""The report of an error budget: bars, as long as what a perfect part would take off an error."""

from __future__ import annotations

from pathlib import Path

from xihe_blender.io.budget_results import PARTS, BudgetPart, BudgetResults, ObjectBudget
from xihe_blender.report.document import document, table, write_document
from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_count, format_frames, format_number, format_percent, with_minus

ROW_PX, BAR_PX = 42, 16
_HOW = (
    "Each bar is what would be taken off the error if that part alone were perfect and all else as it was. Parts "
    "overlap, so the bars do not add up to the whole error. A bar to the left makes the error larger. The line on a "
    "bar is the 95 % confidence interval over seeds, and goes on where it meets the edge: of parts whose lines overlap "
    "nobody can say which helps more, and one whose line holds 0 may help or harm, and stands last."
)


def write_budget_report(path: Path, results: BudgetResults) -> None:
    """One self-contained page."""
    sections = [(f"object{index}", escape(item.name), _of_object(item)) for index, item in enumerate(results.objects)]
    sections.append(("parts", "What perfect means", _meaning()))
    heading = f"What would help: {escape(results.scene)}"
    write_document(path, document(heading, _opening(results), sections))


def _opening(results: BudgetResults) -> str:
    advice = "".join(f"<li>{escape(item.advice)}</li>" for item in results.objects)
    estimator, phone = (escape(str(results.settings[name])) for name in ("estimator", "phone"))
    network = results.settings["network"]
    over = "" if network is None else f", over <code>{escape(str(network))}</code>"
    session = f"Light by <code>{estimator}</code>, phone <code>{phone}</code>{over}"
    seeds = results.settings["seeds"]
    assert isinstance(seeds, int)
    measured = f"measured with {format_count(seeds, 'seed')}"
    notes = " ".join(escape(note) for note in results.notes)
    return f"<ul>{advice}</ul><p>{session}, from {format_count(len(results.frames), 'frame')}, {measured}. {notes}</p>"


def _of_object(item: ObjectBudget) -> str:
    if not item.brightness:
        return f"<p>{escape(item.advice)}</p>"
    return f'<div class="plots">{_bars(item)}</div>{_least_squares(item)}{_table(item)}'


def _bars(item: ObjectBudget) -> str:
    """Bars from the largest gain to the smallest, in per cent of the brightness; the axis ends at the whole error."""
    parts, whole = item.largest_first, 100 * item.relative(item.error or 0.0)
    gains = [100 * item.relative(part.gain) for part in parts]
    axis = _axis(min(0.0, *gains, *(max(100 * item.relative(part.low), -whole) for part in parts)), whole)
    height_px = ROW_PX * len(parts)
    rows = "".join(_bar(axis, index * ROW_PX, item, part) for index, part in enumerate(parts))
    now = svg.straight(axis.x(whole), 0, axis.x(whole), height_px, "limit")
    below = svg.axis_of(axis, "taken off the error, of the brightness; dotted: the whole error", height_px, grid=True)
    return svg.figure(
        f"{below}{now}{rows}", title=escape(item.advice), about=_HOW, label=f"Error budget of {escape(item.name)}",
        height_px=height_px, is_wide=True,
    )  # fmt: skip


def _axis(low: float, high: float) -> svg.Axis:
    """From the largest loss, in per cent, to the whole error; its ticks lie between them."""
    ticks = svg.linear_axis(low, high, n_steps=8).ticks
    inside = tuple(tick for tick in ticks if low <= tick <= high)
    return svg.Axis(low, 1.02 * high if high > 0 else 1.0, inside, lambda value: f"{_number(value, 'g')} %")


def _number(value: float, form: str) -> str:
    return with_minus(f"{round(value, 1):{form}}")


def _bar(axis: svg.Axis, top: int, item: ObjectBudget, part: BudgetPart) -> str:
    gain = 100 * item.relative(part.gain)
    left, right = sorted((axis.x(0.0), axis.x(gain)))
    said = f"{PARTS[part.name].label}: {_number(gain, '.1f')} %{_between(item, part)}"
    return (
        f'<text x="{axis.x(0.0):.3f}%" dx="4" y="{top + 14}">{escape(said)}</text>'
        f'<rect class="bar s{0 if gain >= 0 else 1}" x="{left:.3f}%" y="{top + 20}" width="{right - left:.3f}%" '
        f'height="{BAR_PX}"><title>{escape(PARTS[part.name].perfect)}</title></rect>{_interval(axis, top, item, part)}'
    )


def _between(item: ObjectBudget, part: BudgetPart) -> str:
    """The interval of a gain in words, and whether it leaves open what the part does."""
    if part.interval is None:
        return ""
    low, high = (_number(100 * item.relative(end), ".1f") for end in part.interval)
    return f", {low} to {high} %" + ("" if part.is_certain else ": not certain")


def _interval(axis: svg.Axis, top: int, item: ObjectBudget, part: BudgetPart) -> str:
    """A line across the bar, as far as the axis goes."""
    if part.interval is None:
        return ""
    low, high = (axis.x(min(max(100 * item.relative(end), axis.low), axis.high)) for end in part.interval)
    middle = top + 20 + BAR_PX / 2
    return svg.straight(low, middle, high, middle, "interval")


def _least_squares(item: ObjectBudget) -> str:
    if item.least_squares_error is None:
        return ""
    then, now = (format_percent(item.relative(error or 0.0)) for error in (item.least_squares_error, item.error))
    other = "With least squares (<code>projection</code>) instead of the estimator"
    return f"<p>{other} the error would be {then} of the brightness; it is {now}.</p>"


def _table(item: ObjectBudget) -> str:
    head = ["part", "error with it perfect", "taken off", "95 % interval", "error, as a share of the brightness"]
    rows = [["as it was", format_number(item.error), "", "", format_percent(item.relative(item.error or 0.0))]]
    rows += [_row(item, part) for part in item.largest_first]
    rows += [[PARTS[p.name].label, "not simulated", "", "", ""] for p in item.parts if p.state == "not simulated"]
    measured = (
        f"<p>Measured in {format_count(len(item.moments), 'frame')} of each seed: {format_frames(item.moments)}.</p>"
    )
    return table(head, rows) + measured


def _row(item: ObjectBudget, part: BudgetPart) -> list[str]:
    of_brightness = format_percent(item.relative(part.error))
    interval = " to ".join(map(format_number, part.interval)) if part.interval else format_number(None)
    return [PARTS[part.name].label, format_number(part.error), format_number(part.gain), interval, of_brightness]


def _meaning() -> str:
    rows = [[words.label, escape(words.perfect)] for words in PARTS.values()]
    return table(["part", "a perfect one"], rows, "words") + (
        "<p>The error is the root mean square difference between two pictures of a satin ball in the object's place: "
        "under the estimated light and under the true light, path-traced.</p>"
    )
