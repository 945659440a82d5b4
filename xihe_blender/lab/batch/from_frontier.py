"""Answers that a given frontier adds to a batch: those that take measured times, each with its plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xihe_blender.lab.batch import drawings
from xihe_blender.lab.batch.analysis import chosen, names_of
from xihe_blender.lab.frontier.points import HOW_MANY_ANCHORS, LAST_TENTH, family
from xihe_blender.report.values import code, escape, finite, items, mapping
from xihenet.formats import format_milliseconds, format_percent

Frontier = Mapping[str, Any]
"""Content of a frontier.json."""

WITHOUT_FRONTIER = (
    f"That takes measured times: run {code('xihe frontier SCENE.blend --out DIR')} and give its folder as "
    f"{code('--frontier DIR')} to the same command, or put its frontier.json into this folder."
)


def how_many_anchors(frontier: Frontier) -> tuple[str, str]:
    """The answer in words, and a plot with a dot for each number in it."""
    known = _points(frontier, "compute", "coefficients_truth")
    own = [point for scene in names_of(known, "scene") for point in family(chosen(known, scene=scene), ("n_anchors",))]
    by_anchors = sorted(own, key=lambda point: point["settings"]["n_anchors"])
    plot = _error_against_time(
        [(f"{point['settings']['n_anchors']} anchors", point) for point in by_anchors],
        "Computing: error against time, by anchors",
        "against the rendered light probe, of choices that differ only in their anchors",
        is_joined=False,
    )
    return _answer(frontier, HOW_MANY_ANCHORS), plot


def last_tenth(frontier: Frontier) -> tuple[str, str]:
    """The answer in words, and a plot of each of the two fronts."""
    plots = ""
    for front, doing in (("render", "Rendering"), ("compute", "Computing")):
        on_front = [(p["scene"], p) for p in _points(frontier, front, "coefficients") if p["on_front"]]
        title = f"{doing}: what lies on the front, by scene"
        plots += _error_against_time(
            sorted(on_front, key=lambda named: named[0]), title, "against the exhaustive setting"
        )
    return _answer(frontier, LAST_TENTH), plots


def _answer(frontier: Frontier, question: str) -> str:
    """What `xihe frontier` says to a question, scene by scene."""
    found = [one for one in items(frontier, "answers") if isinstance(one, Mapping) and one.get("question") == question]
    if not found:
        return "The frontier that was given has no answer to that."
    return " ".join(f"<b>{escape(one.get('scene', ''))}</b>: {escape(one.get('answer', ''))}" for one in found)


def _points(frontier: Frontier, front: str, error_kind: str) -> list[Mapping[str, Any]]:
    """Points of `front` whose error of this kind, and time, are known."""
    return [
        point
        for point in items(frontier, "points")
        if point.get("front") == front and mapping(point, "settings").get("error_kind") == error_kind
        if finite(point.get("error")) is not None and finite(point.get("time_ms")) is not None
    ]


def _error_against_time(
    points: Sequence[tuple[str, Mapping[str, Any]]], title: str, about: str, *, is_joined: bool = True
) -> str:
    """Points, each with the name of its curve or cloud; `about` ends the sentence on their error."""
    clouds: dict[str, list[tuple[float, float, str]]] = {}
    for name, point in points:
        error, time_ms = point["error"], point["time_ms"]
        amounts = f"{format_percent(error, 3)} in {format_milliseconds(time_ms)}"
        clouds.setdefault(name, []).append((time_ms, error, f"{point['scene']}, {point.get('label', '')}: {amounts}"))
    return drawings.curves(
        [(name, index, sorted(cloud)) for index, (name, cloud) in enumerate(clouds.items())],
        title=title,
        about=f"From the frontier that was given: error of the coefficients {about}.",
        x_name="ms a frame",
        y_name="error",
        y_label=lambda share: f"{100 * share:.3g} %",
        is_joined=is_joined,
    )
