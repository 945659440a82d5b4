"""Points of a frontier: what was measured of each choice, and which choices lie on a front or are dominated by what.

A point for each choice, front and kind of error: error is the root mean square over places, time the median over
rounds. Judged within one scene, front and kind of error, by these plain numbers. `front_share` says how steady that is:
the share of resampled measurements in which the choice is on the front.

What one choice does when all others stay as they are is found among the points by their settings: a family.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from xihe_blender.lab.frontier.timing import Quartiles
from xihenet.formats import format_setting
from xihenet.pareto import dominators, front_share, on_front

Point = Mapping[str, Any]
"""As in frontier.json."""

HOW_MANY_ANCHORS = "How many anchors?"
HOW_OFTEN = "How often must it run?"
WHICH_ESTIMATOR = "Which estimator?"
NEAREST_ANCHOR = "How should a point find its anchor?"
FRAME_SIZE = "How large a frame?"
HOW_MANY_BOUNCES = "How many bounces?"
PRESETS = "What do the presets cost?"
LAST_TENTH = "What does the last 10 % of accuracy cost?"
"""What people come with: a frontier answers it in these words, and a batch asks for the answer by them."""

STEADY = 0.95
"""A choice flickers if it is on the front in more than 1 - STEADY and less than STEADY of the resamples."""

NO_CHOICE = frozenset({"error_kind", "estimates", "steps"})
"""Settings that say how a point was measured or what came out."""

CHOICES = (
    ("Estimator", "compute", ("estimator",)),
    ("Anchors", "compute", ("n_anchors",)),
    ("Nearest anchor", "compute", ("nearest", "table_size")),
    ("Pixels used, one in n along each side", "compute", ("every_pixel",)),
    ("Theta of the trigger", "compute", ("theta",)),
    ("Order of the spherical harmonics", "compute", ("order",)),
    ("Float type on the wire", "compute", ("wire",)),
    ("Samples per pixel", "render", ("samples",)),
    ("Frame size", "render", ("size",)),
    ("Bounces", "render", ("max_bounces",)),
    ("Denoiser", "render", ("is_denoised",)),
    ("Samples of the pictures", "render", ("picture_samples",)),
)
"""Title, front, and the settings that make the choice."""


@dataclass(frozen=True)
class Measured:
    """A choice, its errors and its time.

    Parameters
    ----------
    label : the choice in words
    settings : the choice as frontier.json names it
    square_errors : squared errors by kind, one for each place; another number of places for another kind
    times_ms : processor time of a frame, one for each round; see `timing`
    preset : whose choice it is, or None
    """

    label: str
    settings: Mapping[str, Any]
    square_errors: Mapping[str, Sequence[float]]
    times_ms: Sequence[float]
    preset: str | None = None

    def as_json(self) -> dict[str, Any]:
        """For `Measured(**...)`."""
        return asdict(self)


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
    errors, times = np.sqrt(square_errors.mean(axis=0)), [Quartiles.of(one.times_ms) for one in measured]
    medians = np.array([each.median for each in times])
    is_on_front, instead = on_front(errors, medians), dominators(errors, medians)
    share = front_share(square_errors, times_ms, rng)
    return [
        {
            "scene": scene,
            "front": front,
            "settings": {"error_kind": kind, **one.settings},
            "error": float(errors[index]),
            "error_spread": Quartiles.of(np.sqrt(square_errors[:, index])).spread,
            "time_ms": times[index].median,
            "spread_ms": times[index].spread,
            "on_front": bool(is_on_front[index]),
            "front_share": float(share[index]),
            "preset": one.preset,
            "label": one.label,
            "instead": None if is_on_front[index] else measured[instead[index]].label,
        }
        for index, one in enumerate(measured)
    ]


def group(points: Sequence[Mapping[str, Any]], scene: str, front: str, kind: str) -> list[Mapping[str, Any]]:
    """The points that are judged together, by rising time."""
    own = [
        point
        for point in points
        if (point["scene"], point["front"], point["settings"]["error_kind"]) == (scene, front, kind)
    ]
    return sorted(own, key=lambda point: (point["time_ms"], point["error"]))


def groups(points: Sequence[Point]) -> list[tuple[str, str, str]]:
    """(scene, front, kind of error) of all points, in their order."""
    return list(dict.fromkeys((p["scene"], p["front"], p["settings"]["error_kind"]) for p in points))


def flickers(point: Mapping[str, Any]) -> bool:
    """Whether chance decides if the choice is on the front."""
    return bool(1 - STEADY < point["front_share"] < STEADY)


def name_of(point: Mapping[str, Any]) -> str:
    """What a choice is called: a preset with what it is on the scene."""
    return point["label"] if point["preset"] is None else f"{point['preset']} ({point['label']})"


def format_dominated(points: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each choice of one group that is never worth taking, told what to take instead."""
    by_label = {point["label"]: point for point in points if point["on_front"]}
    words = []
    for point in points:
        if point["on_front"] or flickers(point):
            continue
        better = by_label[point["instead"]]
        words.append(
            f"{name_of(point)}: {name_of(better)} has {_of(better['error'], point['error'])} of the error in "
            f"{_of(better['time_ms'], point['time_ms'])} of the time"
        )
    return words


def _of(part: float, whole: float) -> str:
    return f"{part / whole:.0%}" if whole > 0 else "the same share"


def family(points: Sequence[Point], names: Sequence[str]) -> list[Point]:
    """The largest set of points that differ in the settings of these `names` and in no other, by rising value.

    Empty where no two points do.
    """
    families: dict[str, list[Point]] = {}
    for point in points:
        settings = point["settings"]
        if names[0] in settings:
            others = {key: value for key, value in settings.items() if key not in {*names, *NO_CHOICE}}
            families.setdefault(json.dumps(others, sort_keys=True), []).append(point)
    largest = max(families.values(), key=len, default=[])
    return sorted(largest, key=lambda point: _rank(point["settings"], names)) if len(largest) > 1 else []


def _rank(settings: Mapping[str, Any], names: Sequence[str]) -> list[tuple[int, float, str]]:
    """Numbers, then words, then nothing set: for bounces that means all of them."""

    def rank(value: Any) -> tuple[int, float, str]:
        if isinstance(value, int | float):
            return 0, float(value), ""
        if isinstance(value, list | tuple):
            return 0, float(value[0]), ""
        return (2, 0.0, "") if value is None else (1, 0.0, str(value))

    return [rank(settings[name]) for name in names]


def format_choice(settings: Mapping[str, Any], names: Sequence[str]) -> str:
    """ "table 1024x512", "512", "all"."""
    return " ".join(filter(None, (_format_setting(settings[name], name) for name in names)))


def _format_setting(value: Any, name: str) -> str:
    if value is None:
        return {"max_bounces": "all", "table_size": ""}.get(name, "none")
    if isinstance(value, bool):
        return format_setting(value)
    return "x".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def errors_by_kind(points: Sequence[Point], scene: str, front: str, label: str) -> dict[str, float]:
    """Errors of one choice, by kind."""
    kinds = dict.fromkeys(p["settings"]["error_kind"] for p in points if p["scene"] == scene and p["front"] == front)
    found = {}
    for kind in kinds:
        own = [p for p in group(points, scene, front, kind) if p["label"] == label]
        if own:
            found[kind] = float(own[0]["error"])
    return found
