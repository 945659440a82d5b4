"""Report of a frontier, one self-contained page: the picture, the answers in words, then every number.

Made from frontier.json alone. First picture: rendering and computing together, since that is what a user waits for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from xihe_blender.lab.frontier.pareto_plot import pareto_plot
from xihe_blender.lab.frontier.points import (
    CHOICES,
    Point,
    errors_by_kind,
    family,
    flickers,
    format_choice,
    format_dominated,
    group,
    groups,
    name_of,
)
from xihe_blender.report.document import block, document, table
from xihe_blender.report.values import escape, finite, items, mapping
from xihenet.formats import format_count, format_list, format_percent, format_quantity

LAB_STYLE = Path(__file__).parents[1] / "lab.css"
FRONTS = {
    "total": ("Rendering and computing together", "What a frame of a run takes: its capture, and the chain on it."),
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
}


def report_page(content: Mapping[str, Any]) -> str:
    """The page as text."""
    points: Sequence[Point] = items(content, "points")
    names = [str(scene["name"]) for scene in items(content, "scenes")]
    return document(
        "What accuracy costs in time",
        f'<p class="lead">{_lead(content, points)}</p>',
        [(escape(name), escape(name), _scene(content, points, name)) for name in names]
        + [("how", "How it was measured", _how(content))],
        style=LAB_STYLE,
    )


def _lead(content: Mapping[str, Any], points: Sequence[Point]) -> str:
    n_choices = len({(p["front"], p["label"]) for p in points})
    presets = [p for p in points if p["preset"] is not None]
    on_front = sum(p["on_front"] for p in presets)
    return (
        f"{format_count(n_choices, 'choice')} measured on {format_count(len(items(content, 'scenes')), 'scene')}. The "
        f"presets are on the front in {on_front} of {len(presets)} cases, by scene, front and kind of error."
    )


def _scene(content: Mapping[str, Any], points: Sequence[Point], name: str) -> str:
    opening, *others = (
        pareto_plot(group(points, name, front, kind), f"{FRONTS[front][0]}: {KINDS[kind]}", FRONTS[front][1])
        for front, kind in _ordered(points, name)
    )
    answered = "".join(
        f"<dt>{escape(one['question'])}</dt><dd>{escape(one['answer'])}</dd>"
        for one in items(content, "answers")
        if one["scene"] == name
    )
    tables = "".join(_numbers(group(points, name, front, kind), front, kind) for front, kind in _ordered(points, name))
    return (
        f'<div class="plots">{opening}</div>'
        + block("In words", f'<dl class="answers">{answered}</dl>')
        + f'<div class="plots">{"".join(others)}</div><h3 class="apart">Choice by choice</h3>'
        f'{_choices(points, name)}<h3 class="apart">All that was measured</h3>{tables}'
    )


def _choices(points: Sequence[Point], scene: str) -> str:
    """A table for each choice that was varied: errors of all kinds, and time."""
    blocks = ""
    for title, front, names in CHOICES:
        first = "picture" if names == ("picture_samples",) else "coefficients"
        others = [kind for kind in KINDS if kind != first]
        own = max((family(group(points, scene, front, kind), names) for kind in (first, *others)), key=len)
        if not own:
            continue
        errors = [errors_by_kind(points, scene, front, point["label"]) for point in own]
        kinds = [kind for kind in KINDS if any(kind in each for each in errors)]
        rows = [
            [
                escape(format_choice(point["settings"], names)),
                format_quantity(point["time_ms"], "ms"),
                *(format_percent(each.get(kind), 3) for kind in kinds),
            ]
            for point, each in zip(own, errors, strict=True)
        ]
        heads = [kind.replace("_truth", ", off the truth") for kind in kinds]
        blocks += block(title, table(["", "time", *heads], rows))
    return blocks


def _ordered(points: Sequence[Point], name: str) -> list[tuple[str, str]]:
    """(front, kind) of a scene in the order of the page."""
    known = {(front, kind) for scene, front, kind in groups(points) if scene == name}
    return [(front, kind) for front in FRONTS for kind in KINDS if (front, kind) in known]


def _numbers(points: Sequence[Point], front: str, kind: str) -> str:
    rows = [
        [
            escape(name_of(p)),
            format_percent(p["error"], 3),
            format_quantity(p["time_ms"], "ms"),
            format_quantity(p["spread_ms"], "ms", 2),
            "flickers" if flickers(p) else "on the front" if p["on_front"] else "dominated",
        ]
        for p in points
    ]
    head = ["choice", "error", "time", "spread of time", "judged"]
    items_of = "".join(f"<li>{escape(words)}</li>" for words in format_dominated(points))
    dominated = f"<p>Never worth taking here:</p><ul>{items_of}</ul>" if items_of else ""
    flickering = [name_of(p) for p in points if flickers(p)]
    chance = f"<p>On the front or off it by chance: {escape(format_list(flickering))}.</p>" if flickering else ""
    title = f"{FRONTS[front][0]}: {KINDS[kind]}"
    return (
        f'<section class="block"><details><summary><b>{title}</b>, {format_count(len(points), "choice")}</summary>'
        f"{table(head, rows)}{dominated}{chance}</details></section>"
    )


def _how(content: Mapping[str, Any]) -> str:
    software, machine = mapping(content, "software"), mapping(content, "machine")
    missing = sorted({name for scene in items(content, "scenes") for name in items(scene, "missing_estimators")})
    notes = [
        "Errors are shares of the light, root mean square over frames and positions; the exhaustive setting compares "
        "every point with all anchors, estimates in every frame, and renders with the most samples and all "
        "bounces the scene calls for. Pictures: root mean square of sRGB-encoded colour, 0 to 1.",
        "Times are processor time, median over rounds in which all choices take turns in random order; renders and "
        "torch take one thread. Whiskers reach from quartile to quartile.",
        "A choice is dominated if another has no more error in no more time, and less of one; it flickers if resampled "
        "measurements put it on the front in 5 to 95 % of cases.",
    ]
    if missing:
        notes.append(f"Not measured, since what they need is not installed: {format_list(missing)}.")
    facts = f"Blender {software.get('blender')}, Python {software.get('python')}, {machine.get('platform')}"
    cores = finite(machine.get("n_cores"))
    facts += f", {cores:.0f} cores" if cores is not None else ""
    listed_notes = "".join(f"<li>{escape(note)}</li>" for note in notes)
    return (
        f'<section class="block"><ul>{listed_notes}</ul>'
        f"<p>{escape(facts)}.</p><pre>{escape(software.get('command') or '')}</pre></section>"
    )
