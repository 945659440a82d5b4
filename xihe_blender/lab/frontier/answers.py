"""Answers of the fronts to someone who asks: how many anchors, how often, what does the last bit of accuracy cost?

Sentences with their numbers, made from the points alone. A sentence says nothing that the points do not: where a scene
has no answer there is none.
"""

from __future__ import annotations

from collections.abc import Sequence

from xihe_blender.lab.frontier import points as asked
from xihe_blender.lab.frontier.choices import ComputeChoice
from xihe_blender.lab.frontier.points import Point, group, name_of
from xihenet.formats import format_count, format_milliseconds, format_share

GOOD_ENOUGH = 0.01
"""A difference of a hundredth of the light is hard to see."""


def answers(scenes: Sequence[str], points: Sequence[Point]) -> list[dict[str, str]]:
    """[{scene, question, answer}]."""
    found = []
    for scene in scenes:
        truth = group(points, scene, "compute", "coefficients_truth")
        compute, render, total = (
            group(points, scene, front, "coefficients") for front in ("compute", "render", "total")
        )
        by_question = {
            asked.HOW_MANY_ANCHORS: _anchors(truth),
            asked.HOW_OFTEN: _how_often(compute),
            asked.WHICH_ESTIMATOR: _estimator(truth),
            asked.NEAREST_ANCHOR: _nearest(compute),
            asked.FRAME_SIZE: _frame_size(render),
            asked.HOW_MANY_BOUNCES: _bounces(render),
            asked.PRESETS: _presets(total),
            asked.LAST_TENTH: f"{_last_tenth(render, 'Rendering')} {_last_tenth(compute, 'Computing')}",
        }
        found += [
            {"scene": scene, "question": question, "answer": answer}
            for question, answer in by_question.items()
            if answer.strip()
        ]
    return found


def varied(points: Sequence[Point], *names: str) -> list[Point]:
    """Points of ways to compute that differ from the base in nothing but the settings of these names."""
    base = ComputeChoice().as_json()
    fixed = {name: value for name, value in base.items() if name not in names}
    return [p for p in points if all(p["settings"].get(name) == value for name, value in fixed.items())]


def _anchors(points: Sequence[Point]) -> str:
    own = sorted(varied(points, "n_anchors"), key=lambda p: p["settings"]["n_anchors"])
    if len(own) < 2:
        return ""
    listed = "; ".join(f"{p['settings']['n_anchors']}: {_light_and_time(p)}" for p in own)
    best = min(own, key=lambda p: p["error"])
    fewest = next(p for p in own if p["error"] - best["error"] <= GOOD_ENOUGH)
    return (
        f"{fewest['settings']['n_anchors']} come within {GOOD_ENOUGH:.0%} of the light of the closest to the rendered "
        f"light probe. Off it, by anchors: {listed} a frame."
    )


def _how_often(points: Sequence[Point]) -> str:
    own = sorted(varied(points, "theta"), key=lambda p: p["settings"]["theta"])
    if len(own) < 2:
        return ""
    words = [
        f"with theta {p['settings']['theta']:g} in {p['settings']['estimates']} of {p['settings']['steps']} steps, "
        f"which is {_light_and_time(p, 'off in')} a frame"
        for p in own
    ]
    return f"An estimate is made {'; '.join(words)}."


def _estimator(points: Sequence[Point]) -> str:
    own = [p for p in varied(points, "estimator") if p["settings"]["order"] == 2]
    if len(own) < 2:
        return ""
    listed = "; ".join(
        f"{p['settings']['estimator']} {_light_and_time(p)}" for p in sorted(own, key=lambda p: p["error"])
    )
    best = min(own, key=lambda p: p["error"])["settings"]["estimator"]
    return f"{best} is closest to the rendered light probe on this walk. Off it, by estimator: {listed} a frame."


def _nearest(points: Sequence[Point]) -> str:
    own = varied(points, "nearest", "table_size")
    base = next((p for p in own if p["settings"]["nearest"] == "exact"), None)
    if base is None or len(own) < 2:
        return ""
    others = "; ".join(
        f"{p['label']} {format_share(abs(p['error'] - base['error']))} "
        f"{'more' if p['error'] > base['error'] else 'less'} error at {p['time_ms'] / base['time_ms']:.2f} of the time"
        for p in own
        if p is not base
    )
    return f"Exactly: {_light_and_time(base, 'off in')} a frame. Against that, {others}."


def _frame_size(points: Sequence[Point]) -> str:
    own = [p for p in points if p["settings"].get("max_bounces") is None and "picture_samples" not in p["settings"]]
    best: dict[tuple[int, ...], Point] = {}
    for p in own:
        size = tuple(p["settings"]["size"])
        if size not in best or p["error"] < best[size]["error"]:
            best[size] = p
    if len(best) < 2:
        return ""
    listed = "; ".join(
        f"{size[0]}x{size[1]} comes to {format_share(p['error'])} at best"
        for size, p in sorted(best.items(), reverse=True)
    )
    return f"Whatever the samples, {listed}: in a small frame a pixel stands for more anchors than one."


def _bounces(points: Sequence[Point]) -> str:
    cut = [p for p in points if p["settings"].get("max_bounces") is not None]
    if not cut:
        return ""
    own = [
        p
        for p in points
        if p["settings"].get("samples") == cut[-1]["settings"]["samples"]
        and p["settings"].get("size") == cut[-1]["settings"]["size"]
        and p["settings"]["is_denoised"]
        and p["settings"].get("preset") is None
    ]
    listed = "; ".join(
        f"{'all' if p['settings']['max_bounces'] is None else p['settings']['max_bounces']}: {_light_and_time(p)}"
        for p in sorted(own, key=_fewest_bounces_first)
    )
    return f"At {format_count(cut[-1]['settings']['samples'], 'sample')}, by bounces: {listed}."


def _fewest_bounces_first(point: Point) -> float:
    limit = point["settings"]["max_bounces"]
    return float("inf") if limit is None else float(limit)


def _presets(points: Sequence[Point]) -> str:
    own = [p for p in points if p["preset"] is not None]
    if not own:
        return ""
    words = [f"{p['preset']} ({p['label']}) is {_light_and_time(p, 'off in')} a frame" for p in own]
    return f"{'; '.join(words)}."


def _last_tenth(points: Sequence[Point], doing: str) -> str:
    """From a tenth of the range of errors on the front to its most accurate end."""
    front = [p for p in points if p["on_front"]]
    if len(front) < 2:
        return ""
    cheapest, dearest = front[0], front[-1]
    bound = dearest["error"] + 0.1 * (cheapest["error"] - dearest["error"])
    near = next(p for p in front if p["error"] <= bound)
    way = f"from {format_share(cheapest['error'])} to {format_share(dearest['error'])}"
    if near is dearest:
        time = format_milliseconds(dearest["time_ms"])
        return f"{doing}: nothing but {name_of(dearest)}, in {time} a frame, goes the way {way}."
    time = format_milliseconds(near["time_ms"])
    return (
        f"{doing}: {name_of(near)} goes nine tenths of the way {way} in {time} a frame; the rest, {name_of(dearest)}, "
        f"takes {dearest['time_ms'] / near['time_ms']:.1f} times that."
    )


def _light_and_time(point: Point, between: str = "in") -> str:
    """ "1.23% in 4.12 ms"."""
    return f"{format_share(point['error'])} {between} {format_milliseconds(point['time_ms'])}"
