"""Points of a frontier: what was measured of each choice, and which choices lie on a front or are dominated by what.

A point for each choice, front and kind of error: error is the root mean square over places, time the median over
rounds. Judged within one scene, front and kind of error, by these plain numbers; `front_share`, the share of resampled
measurements in which the choice is on the front, says how steady that is.

What one choice does when all others stay as they are is found among the points by their settings: a family.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from xihe_blender.io.json_records import INLINE, Json, as_json
from xihe_blender.lab.frontier.records import ChoiceSettings, Front, FrontierPoint, FrontierScene, PointSettings
from xihe_blender.lab.frontier.timing import median_and_spread
from xihenet.formats import format_percent, format_setting
from xihenet.pareto import dominators, front_share, on_front

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
    ("What objects are lit with", "render", ("light",)),
)
"""Title, front, and the settings that make the choice."""


@dataclass(frozen=True)
class Measured:
    """A choice, its label in words, and the preset, if any, whose choice it is.

    Squared errors are by kind, one for each place, of which another kind may have another number; processor times of a
    frame one for each round, see `timing`.
    """

    label: str
    settings: ChoiceSettings
    square_errors: dict[str, tuple[float, ...]]
    times_ms: tuple[float, ...]
    preset: str | None = None


@dataclass(frozen=True, kw_only=True)
class MeasuredScene:
    """All that was measured on a scene, by front, as the folder of a frontier keeps it."""

    fronts: dict[Front, tuple[Measured, ...]]
    scene: FrontierScene | None = field(metadata=INLINE)


def is_whole_scene(name: str, one: MeasuredScene) -> bool:
    """Whether all fronts of the scene `name` are there, with as many numbers of 0 or more for each choice."""
    if one.scene is None or one.scene.name != name or one.fronts.keys() != set(get_args(Front)):
        return False
    for measured in one.fronts.values():
        for kind in {kind for each in measured for kind in each.square_errors}:
            own = [each for each in measured if kind in each.square_errors]
            for rows in ([each.square_errors[kind] for each in own], [each.times_ms for each in own]):
                if len({len(row) for row in rows}) != 1 or not rows[0] or min(map(min, rows)) < 0:
                    return False
    return True


def points_of(scene: str, fronts: Mapping[Front, Sequence[Measured]], seed: int) -> list[FrontierPoint]:
    """The points of frontier.json of one scene."""
    points = []
    for front, measured in fronts.items():
        for kind in dict.fromkeys(kind for one in measured for kind in one.square_errors):
            own = [one for one in measured if kind in one.square_errors]
            points += _judged(scene, front, kind, own, np.random.default_rng(seed))
    return points


def _judged(
    scene: str, front: Front, kind: str, measured: Sequence[Measured], rng: np.random.Generator
) -> list[FrontierPoint]:
    square_errors = np.array([one.square_errors[kind] for one in measured]).T
    times_ms = np.array([one.times_ms for one in measured]).T
    errors, times = np.sqrt(square_errors.mean(axis=0)), [median_and_spread(one.times_ms) for one in measured]
    medians = np.array([median for median, _ in times])
    is_on_front, instead = on_front(errors, medians), dominators(errors, medians)
    share = front_share(square_errors, times_ms, rng)
    return [
        FrontierPoint(
            scene=scene,
            front=front,
            settings=PointSettings(error_kind=kind, **vars(one.settings)),
            error=float(errors[index]),
            error_spread=median_and_spread(np.sqrt(square_errors[:, index]))[1],
            time_ms=times[index][0],
            spread_ms=times[index][1],
            on_front=bool(is_on_front[index]),
            front_share=float(share[index]),
            preset=one.preset,
            label=one.label,
            instead=None if is_on_front[index] else measured[instead[index]].label,
        )
        for index, one in enumerate(measured)
    ]


def group(points: Sequence[FrontierPoint], scene: str, front: str, kind: str) -> list[FrontierPoint]:
    """The points that are judged together, by rising time."""
    own = [point for point in points if (point.scene, point.front, point.kind) == (scene, front, kind)]
    return sorted(own, key=lambda point: (point.time_ms, point.error))


def groups(points: Sequence[FrontierPoint]) -> list[tuple[str, str, str]]:
    """(scene, front, kind of error) of all points, in their order."""
    return list(dict.fromkeys((point.scene, point.front, point.kind) for point in points))


def format_dominated(points: Sequence[FrontierPoint]) -> list[str]:
    """A sentence for each choice of one group that is never worth taking, told what to take instead."""
    by_label = {p.label: p for p in points if p.on_front}
    pairs = [(p, by_label[p.instead]) for p in points if p.instead is not None and not p.flickers]
    return [
        f"{p.name}: {better.name} has {_of(better.error, p.error)} of the error in "
        f"{_of(better.time_ms, p.time_ms)} of the time"
        for p, better in pairs
    ]


def _of(part: float, whole: float) -> str:
    return format_percent(part / whole) if whole > 0 else "the same share"


def family(points: Sequence[FrontierPoint], names: Sequence[str]) -> list[FrontierPoint]:
    """The largest set of points that differ in the settings of these `names` and in no other, by rising value.

    Empty where no two points do.
    """
    families: dict[str, list[tuple[list[tuple[int, float, str]], FrontierPoint]]] = {}
    for point in points:
        settings = as_json(point.settings)
        if names[0] in settings:
            others = {key: value for key, value in settings.items() if key not in {*names, *NO_CHOICE}}
            ranked = [_rank(settings[name]) for name in names], point
            families.setdefault(json.dumps(others, sort_keys=True), []).append(ranked)
    largest = max(families.values(), key=len, default=[])
    return [point for _, point in sorted(largest, key=lambda one: one[0])] if len(largest) > 1 else []


def _rank(value: Json) -> tuple[int, float, str]:
    """Numbers, then words, then nothing set: for bounces that means all of them."""
    number = value[0] if isinstance(value, list) else value
    if isinstance(number, int | float):
        return 0, float(number), ""
    return (2, 0.0, "") if value is None else (1, 0.0, str(value))


def format_choice(point: FrontierPoint, names: Sequence[str]) -> str:
    """Its settings of these names: "table 1024x512", "512", "all"."""
    settings, words = as_json(point.settings), []
    for name in names:
        value = settings[name]
        if value is None:
            words.append({"max_bounces": "all", "table_size": ""}.get(name, "none"))
        elif isinstance(value, list):
            words.append("x".join(map(str, value)))
        else:
            words.append(format_setting(value) if isinstance(value, bool) else str(value))
    return " ".join(filter(None, words))
