"""Report of a frontier, one self-contained page: the picture, the answers in words, then every number.

Made from frontier.json alone. First picture: rendering and computing together, since that is what a user waits for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from xihe_blender.lab.frontier.points import CHOICES, family, format_choice, format_dominated, group, groups
from xihe_blender.lab.frontier.records import Frontier, FrontierPoint, FrontierScene
from xihe_blender.report.document import block, document, table
from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_count, format_list, format_milliseconds, format_percent, format_quantity, format_runs
from xihenet.svg import Axis, log_axis

LAB_STYLE = Path(__file__).parents[1] / "lab.css"
FRONTS = {
    "total": (
        "Rendering and computing together",
        "The capture of a frame, and the chain on it; for pictures the comparison as well. A run renders more: light "
        "probes, and compared pictures, which take most of its time.",
    ),
    "render": ("Rendering", "The capture of a frame, and for pictures the comparison as well."),
    "compute": ("Computing", "What a phone would do: unproject to estimate, mean over the frames of a walk."),
}
KINDS = {
    "coefficients": "coefficients, against the exhaustive setting",
    "irradiance": "irradiance on surfaces, against the exhaustive setting",
    "picture": "picture inside the objects (sRGB), against the exhaustive setting",
    "coefficients_truth": "coefficients to order 4, against the rendered light probe",
    "irradiance_truth": "irradiance on surfaces, against the rendered light probe",
    "picture_truth": "picture inside the objects (sRGB), against the path-traced one",
    "ring_truth": "picture around the objects (linear), against the path-traced one",
}

ACROSS = "processor time of a frame"
HEIGHT_PX = 360
FOOT_PX = 386
"""Where the drawing ends, with room below the axis for errors of 0."""

NUMBER_PERCENT, NUMBER_PX = 3, 14
"""Room for a number beside its mark."""

NAMES_LEFT_FROM = 88
"""Per cent of the width: further right there is no room for a preset's name on the right of its mark."""


def report_page(frontier: Frontier) -> str:
    names = [scene.name for scene in frontier.scenes]
    n_choices = len({(p.front, p.label) for p in frontier.points})
    presets = [p for p in frontier.points if p.preset is not None]
    lead = (
        f"{format_count(n_choices, 'choice')} measured on {format_count(len(names), 'scene')}. The presets are on the "
        f"front in {sum(p.on_front for p in presets)} of {len(presets)} cases, by scene, front and kind of error."
    )
    sections = [(escape(name), escape(name), _scene(frontier, name)) for name in names]
    return document(
        "What accuracy costs in time",
        f'<p class="lead">{lead}</p>',
        [*sections, ("how", "How it was measured", _how(frontier))],
        style=LAB_STYLE,
    )


def _scene(frontier: Frontier, name: str) -> str:
    points = frontier.points
    fronts = [(front, kind) for front in FRONTS for kind in KINDS if (name, front, kind) in groups(points)]
    opening, *others = (
        pareto_plot(group(points, name, front, kind), f"{FRONTS[front][0]}: {KINDS[kind]}", FRONTS[front][1])
        for front, kind in fronts
    )
    answered = "".join(
        f"<dt>{escape(one.question)}</dt><dd>{escape(one.answer)}</dd>" for one in frontier.answers if one.scene == name
    )
    tables = "".join(_numbers(group(points, name, front, kind), front, kind) for front, kind in fronts)
    samples = _samples(next(scene for scene in frontier.scenes if scene.name == name))
    return (
        f'<p>{samples}</p><div class="plots">{opening}</div>'
        + block("In words", f'<dl class="answers">{answered}</dl>')
        + f'<div class="plots">{"".join(others)}</div><h3 class="apart">Choice by choice</h3>'
        f'{_choices(points, name)}<h3 class="apart">All that was measured</h3>{tables}'
    )


def _samples(scene: FrontierScene) -> str:
    """How many samples each preset takes, and the render that they are held against."""
    counts = [f"{format_count(choice.samples, 'sample')} at {name}" for name, choice in scene.presets.items()]
    most = scene.exhaustive_samples
    return f"In this room a pixel of a capture has {format_list(counts)}; in the exhaustive render it has {most}."


def _choices(points: Sequence[FrontierPoint], scene: str) -> str:
    """A table for each choice that was varied: errors of all kinds, and time."""
    blocks = ""
    # Of two presets that are the same choice on the scene the faster one is told.
    slowest_first = sorted((p for p in points if p.scene == scene), key=lambda p: (p.time_ms, p.error), reverse=True)
    for title, front, names in CHOICES:
        first = {"picture_samples": "picture", "light": "picture_truth"}.get(names[0], "coefficients")
        others = [kind for kind in KINDS if kind != first]
        own = max((family(group(points, scene, front, kind), names) for kind in (first, *others)), key=len)
        if not own:
            continue
        errors = [
            {p.kind: p.error for p in slowest_first if (p.front, p.label) == (front, point.label)} for point in own
        ]
        kinds = [kind for kind in KINDS if any(kind in each for each in errors)]
        rows = [
            [
                escape(format_choice(point, names)),
                format_quantity(point.time_ms, "ms"),
                *(format_percent(each.get(kind), 3) for kind in kinds),
            ]
            for point, each in zip(own, errors, strict=True)
        ]
        heads = [kind.replace("_truth", ", off the truth") for kind in kinds]
        blocks += block(title, table(["", "time", *heads], rows))
    return blocks


def _numbers(points: Sequence[FrontierPoint], front: str, kind: str) -> str:
    rows = [
        [
            escape(p.name),
            format_percent(p.error, 3),
            format_quantity(p.time_ms, "ms"),
            format_quantity(p.spread_ms, "ms", 2),
            "flickers" if p.flickers else "on the front" if p.on_front else "dominated",
        ]
        for p in points
    ]
    head = ["choice", "error", "time", "spread of time", "judged"]
    items_of = "".join(f"<li>{escape(words)}</li>" for words in format_dominated(points))
    dominated = f"<p>Never worth taking here:</p><ul>{items_of}</ul>" if items_of else ""
    flickering = [p.name for p in points if p.flickers]
    chance = f"<p>On the front or off it by chance: {escape(format_list(flickering))}.</p>" if flickering else ""
    title = f"{FRONTS[front][0]}: {KINDS[kind]}"
    return (
        f'<section class="block"><details><summary><b>{title}</b>, {format_count(len(points), "choice")}</summary>'
        f"{table(head, rows)}{dominated}{chance}</details></section>"
    )


def _how(frontier: Frontier) -> str:
    notes = [
        "Errors are shares of the light, root mean square over frames and positions; the exhaustive setting compares "
        "every point with all anchors, estimates in every frame, and renders with the most samples and all "
        "bounces the scene calls for. Pictures: root mean square of sRGB-encoded colour, 0 to 1.",
        "Errors of computing and rendering are of light clipped at white, as in the paper. A run estimates all of the "
        "light unless it is told otherwise, and another estimator may be closest to that.",
        "Times are processor time, median over rounds in which all choices take turns in random order; renders "
        "take one thread. Whiskers are as long as the distance between the quartiles.",
        "A choice is dominated if another has no more error in no more time, and less of one; it flickers if resampled "
        "measurements put it on the front in 5 to 95 % of cases.",
    ]
    software, machine = frontier.software, frontier.machine
    facts = f"Blender {software.get('blender')}, Python {software.get('python')}, {machine.get('platform')}"
    facts += f", {machine['n_cores']} cores" if machine.get("n_cores") is not None else ""
    listed_notes = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return (
        f'<section class="block"><ul>{listed_notes}</ul>'
        f"<p>{escape(facts)}.</p><pre>{escape(software.get('command', ''))}</pre></section>"
    )


# ------------------------------------------------------------------------------------------ the Pareto plot


def pareto_plot(points: Sequence[FrontierPoint], title: str, about: str) -> str:
    """Error against time, both over powers of ten, of one point at least. `title`, `about` are HTML.

    Every choice is a mark with its spread in both directions; the front is a staircase through its choices, since what
    lies right of it and above is no better; presets have their names. An error of 0, the exhaustive setting's own, has
    no place on such an axis and is drawn at its foot, below a gap.
    """
    errors = [p.error for p in points if p.error > 0]
    times, heights = log_axis([p.time_ms for p in points], format_milliseconds), log_axis(errors, _percent)
    unnamed = sorted((p for p in points if p.on_front and p.preset is None), key=lambda p: p.time_ms)
    numbers = {p.label: number for number, p in enumerate(unnamed, start=1)}
    told: dict[str, str] = {}
    for run in _runs(times, heights, unnamed):
        # What is close together is numbered once, below the last of them: the front goes down there.
        told[run[-1].label] = format_runs([numbers[p.label] for p in run])
    # What is nearest to the reader is drawn last.
    ordered = sorted(points, key=lambda p: (p.preset is not None, p.on_front))
    marks = "".join(_mark(times, heights, p, told.get(p.label, "")) for p in ordered)
    zero = f'<text class="tick-y" x="-8" y="{FOOT_PX - 8}">0</text>' if len(errors) < len(points) else ""
    grid = svg.grid_across(heights, HEIGHT_PX) + svg.axis_of(times, ACROSS, FOOT_PX, grid=True) + zero
    grid += '<text class="axis-y" x="4" y="-6">error</text>'
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
    return svg.line([*steps, (100.0, steps[-1][1])], "s0", FOOT_PX)


def _runs(times: Axis, errors: Axis, ordered: Sequence[FrontierPoint]) -> list[list[FrontierPoint]]:
    """Points whose numbers could not be read beside each other, by time."""
    runs: list[list[FrontierPoint]] = []
    for point in ordered:
        last = runs[-1][-1] if runs else None
        if last is not None and (
            _x(times, point.time_ms) - _x(times, last.time_ms) < NUMBER_PERCENT
            and abs(_y(errors, point.error) - _y(errors, last.error)) < NUMBER_PX
        ):
            runs[-1].append(point)
        else:
            runs.append([point])
    return runs


def _mark(times: Axis, errors: Axis, point: FrontierPoint, number: str) -> str:
    x, y = _x(times, point.time_ms), _y(errors, point.error)
    kind, shape, name = "front" if point.on_front else "aside", "circle", ""
    if point.preset is not None:
        kind, shape = "preset", "diamond"
        side, shift = ("end", -11) if x > NAMES_LEFT_FROM else ("start", 11)
        name = f'<text class="preset-name" x="{shift}" y="-9" text-anchor="{side}">{escape(point.preset)}</text>'
    elif number:
        # On the right, where the names of presets stand on the left.
        place = 'x="8" y="4"' if NAMES_LEFT_FROM < x < 100 - NUMBER_PERCENT else 'x="-6" y="14" text-anchor="end"'
        name = f'<text class="number" {place}>{number}</text>'
    # The quartiles themselves are not kept: half of their distance to either side.
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
        words += f"\non the front in {format_percent(point.front_share)} of resampled measurements"
    return words if point.on_front or point.instead is None else f"{words}\ntake instead: {point.instead}"


def _legend(points: Sequence[FrontierPoint], numbers: Mapping[str, int]) -> str:
    kinds = [("preset", "diamond", "preset")] if any(p.preset is not None for p in points) else []
    kinds += [("front", "circle", "on the front"), ("aside", "circle", "dominated")]
    entries = [f"{svg.icon(shape, f'choice {kind}')} {words}" for kind, shape, words in kinds]
    entries += [f'<b class="key">{number}</b> {escape(label)}' for label, number in numbers.items()]
    return svg.legend(entries)


def _percent(error: float) -> str:
    return format_percent(error, 2) if error else "0"
