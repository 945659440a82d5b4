"""What does one choice do when all others stay as they are?

Points that differ in nothing but that choice are found among all that were measured, by their settings; where there are
several such families, the largest counts.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from xihe_blender.lab.frontier.points import group

Point = Mapping[str, Any]
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


def value_in_words(settings: Mapping[str, Any], names: Sequence[str]) -> str:
    """ "table 1024x512", "512", "all"."""
    words = [_word(settings[name], name) for name in names]
    return " ".join(word for word in words if word)


def _word(value: Any, name: str) -> str:
    if value is None:
        return {"max_bounces": "all", "wire": "none", "table_size": ""}.get(name, "none")
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value[0]}x{value[1]}" if isinstance(value, list | tuple) else str(value)


def errors_by_kind(points: Sequence[Point], scene: str, front: str, label: str) -> dict[str, float]:
    """Errors of one choice, by kind."""
    kinds = dict.fromkeys(p["settings"]["error_kind"] for p in points if p["scene"] == scene and p["front"] == front)
    found = {}
    for kind in kinds:
        own = [p for p in group(points, scene, front, kind) if p["label"] == label]
        if own:
            found[kind] = float(own[0]["error"])
    return found
