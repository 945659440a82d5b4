"""Which of the measured choices lie on a front, and which are dominated by what?

A point for each choice, front and kind of error: error is the root mean square over places, time the median over
rounds. Judged within one scene, front and kind of error, by these plain numbers. `front_share` says how steady that is:
the share of resampled measurements in which the choice is on the front.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from xihe_blender.lab.frontier.measured import Measured
from xihe_blender.lab.frontier.timing import Spread
from xihenet.pareto import dominators, front_share, on_front

STEADY = 0.95
"""A choice flickers if it is on the front in more than 1 - STEADY and less than STEADY of the resamples."""


def points_of(scene: str, fronts: Mapping[str, Sequence[Measured]], seed: int) -> list[dict[str, Any]]:
    """The points of frontier.json of one scene."""
    points = []
    for front, measured in fronts.items():
        for kind in dict.fromkeys(kind for one in measured for kind in one.square_errors):
            own = [one for one in measured if kind in one.square_errors]
            points += _judged(scene, front, kind, own, np.random.default_rng(seed))
    return points


def _judged(
    scene: str, front: str, kind: str, measured: Sequence[Measured], rng: np.random.Generator
) -> list[dict[str, Any]]:
    square_errors = np.array([one.square_errors[kind] for one in measured]).T
    times_ms = np.array([one.times_ms for one in measured]).T
    errors, times = np.sqrt(square_errors.mean(axis=0)), [Spread.of(one.times_ms) for one in measured]
    medians = np.array([each.median for each in times])
    is_on_front, instead = on_front(errors, medians), dominators(errors, medians)
    share = front_share(square_errors, times_ms, rng)
    return [
        {
            "scene": scene,
            "front": front,
            "settings": {"error_kind": kind, **one.settings},
            "error": float(errors[place]),
            "error_spread": Spread.of(np.sqrt(square_errors[:, place])).spread,
            "time_ms": times[place].median,
            "spread_ms": times[place].spread,
            "on_front": bool(is_on_front[place]),
            "front_share": float(share[place]),
            "preset": one.preset,
            "label": one.label,
            "instead": None if is_on_front[place] else measured[instead[place]].label,
        }
        for place, one in enumerate(measured)
    ]


def group(points: Sequence[Mapping[str, Any]], scene: str, front: str, kind: str) -> list[Mapping[str, Any]]:
    """The points that are judged together, by rising time."""
    own = [
        point
        for point in points
        if (point["scene"], point["front"], point["settings"]["error_kind"]) == (scene, front, kind)
    ]
    return sorted(own, key=lambda point: (point["time_ms"], point["error"]))


def groups(points: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """(scene, front, kind of error) of all points, in their order."""
    return list(dict.fromkeys((p["scene"], p["front"], p["settings"]["error_kind"]) for p in points))


def flickers(point: Mapping[str, Any]) -> bool:
    """Whether chance decides if the choice is on the front."""
    return bool(1 - STEADY < point["front_share"] < STEADY)


def name_of(point: Mapping[str, Any]) -> str:
    """What a choice is called: a preset with what it is on the scene."""
    return point["label"] if point["preset"] is None else f"{point['preset']} ({point['label']})"


def dominated_in_words(points: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each choice of one group that is never worth taking, told what to take instead."""
    by_label = {point["label"]: point for point in points if point["on_front"]}
    said = []
    for point in points:
        if point["on_front"] or flickers(point):
            continue
        better = by_label[point["instead"]]
        said.append(
            f"{name_of(point)}: {name_of(better)} has {_of(better['error'], point['error'])} of the error in "
            f"{_of(better['time_ms'], point['time_ms'])} of the time"
        )
    return said


def _of(part: float, whole: float) -> str:
    return f"{part / whole:.0%}" if whole > 0 else "the same share"
