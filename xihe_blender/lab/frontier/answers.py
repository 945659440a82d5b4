"""What do the fronts say to someone who asks: how many anchors, how often, what does the last bit of accuracy cost?

Sentences with their numbers, made from the points alone. A sentence says nothing that the points do not: where a scene
has no answer there is none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from xihe_blender.lab.frontier import questions
from xihe_blender.lab.frontier.choices import ComputeChoice
from xihe_blender.lab.frontier.points import group, name_of

Point = Mapping[str, Any]
GOOD_ENOUGH = 0.01
"""A difference of a hundredth of the light is hard to see."""


def answers(scenes: Sequence[str], points: Sequence[Point]) -> list[dict[str, str]]:
    """[{scene, question, answer}]."""
    found = []
    for scene in scenes:
        for question, answer in (
            (questions.HOW_MANY_ANCHORS, _anchors(group(points, scene, "compute", "coefficients_truth"))),
            (questions.HOW_OFTEN, _how_often(group(points, scene, "compute", "coefficients"))),
            (questions.WHICH_ESTIMATOR, _estimator(group(points, scene, "compute", "coefficients_truth"))),
            (questions.NEAREST_ANCHOR, _nearest(group(points, scene, "compute", "coefficients"))),
            (questions.FRAME_SIZE, _frame_size(group(points, scene, "render", "coefficients"))),
            (questions.HOW_MANY_BOUNCES, _bounces(group(points, scene, "render", "coefficients"))),
            (questions.PRESETS, _presets(group(points, scene, "total", "coefficients"))),
            (
                questions.LAST_TENTH,
                " ".join(
                    _last_tenth(group(points, scene, front, "coefficients"), doing)
                    for front, doing in (("render", "Rendering"), ("compute", "Computing"))
                ),
            ),
        ):
            if answer:
                found.append({"scene": scene, "question": question, "answer": answer})
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
    listed = "; ".join(f"{p['settings']['n_anchors']}: {_share(p['error'])} in {_ms(p['time_ms'])}" for p in own)
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
    said = [
        f"with theta {p['settings']['theta']:g} in {p['settings']['estimates']} of {p['settings']['steps']} steps, "
        f"which is {_share(p['error'])} off in {_ms(p['time_ms'])} a frame"
        for p in own
    ]
    return f"An estimate is made {'; '.join(said)}."


def _estimator(points: Sequence[Point]) -> str:
    own = [p for p in varied(points, "estimator") if p["settings"]["order"] == 2]
    if len(own) < 2:
        return ""
    listed = "; ".join(
        f"{p['settings']['estimator']} {_share(p['error'])} in {_ms(p['time_ms'])}"
        for p in sorted(own, key=lambda p: p["error"])
    )
    best = min(own, key=lambda p: p["error"])["settings"]["estimator"]
    return f"{best} is closest to the rendered light probe on this walk. Off it, by estimator: {listed} a frame."


def _nearest(points: Sequence[Point]) -> str:
    own = varied(points, "nearest", "table_size")
    base = next((p for p in own if p["settings"]["nearest"] == "exact"), None)
    if base is None or len(own) < 2:
        return ""
    others = "; ".join(
        f"{p['label']} {_share(abs(p['error'] - base['error']))} {'more' if p['error'] > base['error'] else 'less'} "
        f"error at {p['time_ms'] / base['time_ms']:.2f} of the time"
        for p in own
        if p is not base
    )
    return f"Exactly: {_share(base['error'])} off in {_ms(base['time_ms'])} a frame. Against that, {others}."


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
        f"{size[0]}x{size[1]} comes to {_share(p['error'])} at best" for size, p in sorted(best.items(), reverse=True)
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
        f"{'all' if p['settings']['max_bounces'] is None else p['settings']['max_bounces']}: {_share(p['error'])} in "
        f"{_ms(p['time_ms'])}"
        for p in sorted(own, key=_fewest_bounces_first)
    )
    samples = cut[-1]["settings"]["samples"]
    return f"At {samples} sample{'' if samples == 1 else 's'}, by bounces: {listed}."


def _fewest_bounces_first(point: Point) -> float:
    limit = point["settings"]["max_bounces"]
    return float("inf") if limit is None else float(limit)


def _presets(points: Sequence[Point]) -> str:
    own = [p for p in points if p["preset"] is not None]
    if not own:
        return ""
    said = [f"{p['preset']} ({p['label']}) is {_share(p['error'])} off in {_ms(p['time_ms'])} a frame" for p in own]
    return f"{'; '.join(said)}."


def _last_tenth(points: Sequence[Point], doing: str) -> str:
    """From a tenth of the range of errors on the front to its most accurate end."""
    front = [p for p in points if p["on_front"]]
    if len(front) < 2:
        return ""
    cheapest, dearest = front[0], front[-1]
    bound = dearest["error"] + 0.1 * (cheapest["error"] - dearest["error"])
    near = next(p for p in front if p["error"] <= bound)
    way = f"from {_share(cheapest['error'])} to {_share(dearest['error'])}"
    if near is dearest:
        return f"{doing}: nothing but {name_of(dearest)}, in {_ms(dearest['time_ms'])} a frame, goes the way {way}."
    return (
        f"{doing}: {name_of(near)} goes nine tenths of the way {way} in {_ms(near['time_ms'])} a frame; the rest, "
        f"{name_of(dearest)}, takes {dearest['time_ms'] / near['time_ms']:.1f} times that."
    )


def _share(error: float) -> str:
    return f"{error:.2%}" if error < 0.0995 else f"{error:.0%}"


def _ms(time_ms: float) -> str:
    return f"{time_ms / 1000:.2g} s" if time_ms >= 1000 else f"{time_ms:.3g} ms"
