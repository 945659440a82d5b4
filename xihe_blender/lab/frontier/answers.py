"""Answers of the fronts to someone who asks: how many anchors, how often, what does the last bit of accuracy cost?

Sentences with their numbers, made from the points alone. A sentence says nothing that the points do not: where a scene
has no answer there is none.
"""

from __future__ import annotations

from collections.abc import Sequence

from xihe_blender.lab.frontier.points import family, format_choice, group
from xihe_blender.lab.frontier.records import Answer, FrontierPoint
from xihenet.formats import format_count, format_milliseconds, format_percent

HOW_MANY_ANCHORS = "How many anchors?"
LAST_TENTH = "What does the last 10 % of accuracy cost?"
"""These two are asked by a batch as well."""

WHAT_LIGHT = "Do objects need a key light and reflections?"

ERROR_AND_TIME = "Error and time of a frame"

GOOD_ENOUGH = 0.01
"""A difference of a hundredth of the light is hard to see."""


def answers(scenes: Sequence[str], points: Sequence[FrontierPoint]) -> list[Answer]:
    """Those that the points of each scene have."""
    found = []
    for scene in scenes:
        truth = group(points, scene, "compute", "coefficients_truth")
        compute, render, total = (
            group(points, scene, front, "coefficients") for front in ("compute", "render", "total")
        )
        by_question = {
            HOW_MANY_ANCHORS: _anchors(truth),
            "How often must it run?": _how_often(compute),
            "Which estimator?": _estimator(truth),
            "How should a point find its anchor?": _nearest(compute),
            "How large a frame?": _frame_size(render),
            "How many bounces?": _bounces(render),
            "What do the presets cost?": _presets(total),
            WHAT_LIGHT: _what_light(*(group(points, scene, "total", kind) for kind in ("picture_truth", "ring_truth"))),
            LAST_TENTH: f"{_last_tenth(render, 'Rendering')} {_last_tenth(compute, 'Computing')}",
        }
        told = [(question, answer) for question, answer in by_question.items() if answer.strip()]
        found += [Answer(scene=scene, question=question, answer=answer) for question, answer in told]
    return found


def _anchors(points: Sequence[FrontierPoint]) -> str:
    own = family(points, ("n_anchors",))
    if not own:
        return ""
    listed = "; ".join(f"{p.computing.n_anchors}: {_light_and_time(p)}" for p in own)
    least = min(p.error for p in own)
    fewest = next(p for p in own if p.error - least <= GOOD_ENOUGH)
    n = fewest.computing.n_anchors
    words = f"{n} anchors, the most that were measured, bring the estimate closest to the rendered light probe"
    if fewest is not own[-1]:
        words = (
            f"{n} anchors are enough: no other number brings the estimate closer to the rendered light probe by more "
            f"than {format_percent(GOOD_ENOUGH, 1)} of the light"
        )
    return f"{words}. {ERROR_AND_TIME}, by anchors: {listed}."


def _how_often(points: Sequence[FrontierPoint]) -> str:
    own = family(points, ("theta",))
    if not own:
        return ""
    words = [
        f"theta {p.computing.theta:g}, {format_count(p.settings.estimates or 0, 'estimate')} in "
        f"{format_count(p.settings.steps or 0, 'step')}: {_light_and_time(p)}"
        for p in own
    ]
    return f"{ERROR_AND_TIME}, by the trigger's threshold: {'; '.join(words)}."


def _estimator(points: Sequence[FrontierPoint]) -> str:
    own = sorted(family(points, ("estimator",)), key=lambda p: p.error)
    if not own:
        return ""
    listed = "; ".join(f"{p.computing.estimator}: {_light_and_time(p)}" for p in own)
    best = own[0].computing.estimator
    return (
        f"{best} is closest to the rendered light probe on this walk, of light clipped at white. {ERROR_AND_TIME}, by "
        f"estimator: {listed}."
    )


def _nearest(points: Sequence[FrontierPoint]) -> str:
    own = sorted(family(points, ("nearest", "table_size")), key=lambda p: p.time_ms)
    base = next((p for p in own if p.computing.nearest == "exact"), None)
    if base is None:
        return ""
    listed = "; ".join(f"{'exact' if p is base else p.label}: {_light_and_time(p)}" for p in own)
    return f"{ERROR_AND_TIME}: {listed}."


def _frame_size(points: Sequence[FrontierPoint]) -> str:
    best: dict[tuple[int, int], float] = {}
    for point in points:
        choice = point.settings.rendering
        if choice is not None and choice.max_bounces is None and point.settings.picture_samples is None:
            best[choice.size] = min(point.error, best.get(choice.size, point.error))
    if len(best) < 2:
        return ""
    listed = "; ".join(
        f"{size[0]}x{size[1]} pixels: {format_percent(error, 3)}" for size, error in sorted(best.items(), reverse=True)
    )
    return f"The least error, whatever the samples: {listed}. In a small frame a pixel stands for more than one anchor."


def _bounces(points: Sequence[FrontierPoint]) -> str:
    own = family(points, ("max_bounces",))
    if not own:
        return ""
    listed = "; ".join(f"{format_choice(p, ('max_bounces',))}: {_light_and_time(p)}" for p in own)
    samples = int(format_choice(own[0], ("samples",)))
    return f"{ERROR_AND_TIME} at {format_count(samples, 'sample')}, by bounces: {listed}."


def _presets(points: Sequence[FrontierPoint]) -> str:
    words = [f"{p.name}: {_light_and_time(p)}" for p in points if p.preset is not None]
    return f"{ERROR_AND_TIME}, without what else a run renders: {'; '.join(words)}." if words else ""


def _what_light(inside: Sequence[FrontierPoint], around: Sequence[FrontierPoint]) -> str:
    own = family(inside, ("light",))
    if not own:
        return ""
    ring = {p.label: format_percent(p.error, 3) for p in around}
    best = min(own, key=lambda p: p.error)
    listed = "; ".join(f"{p.settings.light}: {_light_and_time(p)}, {ring[p.label]} around them" for p in own)
    return (
        f"Lit with {best.settings.light}, the objects are closest to the path-traced picture. {ERROR_AND_TIME}, by "
        f"what they are lit with: {listed}."
    )


def _last_tenth(points: Sequence[FrontierPoint], doing: str) -> str:
    """From a tenth of the range of errors on the front to its most accurate end."""
    front = [p for p in points if p.on_front]
    if len(front) < 2:
        return ""
    cheapest, dearest = front[0], front[-1]
    bound = dearest.error + 0.1 * (cheapest.error - dearest.error)
    near = next(p for p in front if p.error <= bound)
    way = f"the error from {format_percent(cheapest.error, 3)} to {format_percent(dearest.error, 3)}"
    time = format_milliseconds(near.time_ms)
    if near is dearest:
        return f"{doing}: only {dearest.name}, which takes {time} a frame, lowers {way}."
    return (
        f"{doing}: {dearest.name} lowers {way}. Nine tenths of that cost {time} a frame, with {near.name}; all of it "
        f"costs {dearest.time_ms / near.time_ms:.1f} times as much."
    )


def _light_and_time(point: FrontierPoint) -> str:
    """ "1.23 % in 4.12 ms"."""
    return f"{format_percent(point.error, 3)} in {format_milliseconds(point.time_ms)}"
