"""Timeline of a run: where each frame lies on the report's common time axis, and what happened in it.

All plots and the picture scrubber share one `Timeline`: frames sorted by number, each with a column of the plot's
width in percent. Percent instead of pixels lets one SVG fit a telephone and a wide screen with text of the same size.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from xihe_blender.report.values import escape, finite, items

REASONS = {"first": "first estimate", "colour": "light changed", "coverage": "more of the surroundings seen"}
KEPT = "kept"
"""Stands where a reason stands, for a frame whose light could not be known."""

_SHAPES = {"first": "diamond", "colour": "circle", "coverage": "triangle", KEPT: "cross"}
N_COLOURS = 6


def format_trigger(reason: str) -> str:
    """Why an estimate was made, escaped."""
    return escape(REASONS.get(reason, reason or "reason not recorded"))


def reason_shape(reason: str) -> str:
    """Which of the shapes marks `reason`: one each, so that reasons are told apart without colour."""
    return _SHAPES.get(reason, "square")


def series_class(index: int) -> str:
    """Colour and dash of the probe with this index: six colours, then the same six dashed, then dotted."""
    return f"s{index % N_COLOURS} d{index // N_COLOURS % 3}"


@dataclass(frozen=True)
class Timeline:
    """The frames of one run, ascending.

    Parameters
    ----------
    frames : as in results.json
    edges_percent : borders of the frames' columns, one more than there are frames; 0 to 100
    centres_percent : where each frame's dots and bars stand: frame numbers to scale
    bar_percent : width of the narrowest column
    probe_names : in the order in which they are first seen
    """

    frames: tuple[Mapping[str, Any], ...]
    edges_percent: tuple[float, ...]
    centres_percent: tuple[float, ...]
    bar_percent: float
    probe_names: tuple[str, ...]

    @classmethod
    def of(cls, results: Mapping[str, Any]) -> Timeline:
        """Read from results.json; a run without frames is legal."""
        frames = tuple(sorted(items(results, "frames"), key=number))
        names = dict.fromkeys(probe_name(probe) for frame in frames for probe in items(frame, "probes"))
        return cls(frames, *_columns([number(frame) for frame in frames]), tuple(names))

    def values(self, name: str, key: str) -> list[float | None]:
        """The value at `key` of one probe, a None for every frame without it."""
        return [finite(probe_in(frame, name).get(key)) for frame in self.frames]

    def inactive_spans(self) -> list[tuple[float, float]]:
        """Percent from and to of each stretch of frames in which no probe is in view."""
        spans: list[tuple[float, float]] = []
        for index, frame in enumerate(self.frames):
            left, right = self.edges_percent[index : index + 2]
            if is_active(frame):
                continue
            if spans and spans[-1][1] == left:
                left = spans.pop()[0]
            spans.append((left, right))
        return spans


def _columns(numbers: list[int]) -> tuple[tuple[float, ...], tuple[float, ...], float]:
    """Edges, centres and the narrowest width, in percent, of the columns of frames with these numbers."""
    if not numbers:
        return (0.0,), (), 100.0
    pairs = list(itertools.pairwise(numbers))
    half = min((b - a for a, b in pairs if b > a), default=1) / 2
    first, last = numbers[0] - half, numbers[-1] + half

    def scaled(value: float) -> float:
        return 100 * (value - first) / (last - first)

    edges = [first, *((a + b) / 2 for a, b in pairs), last]
    return tuple(map(scaled, edges)), tuple(map(scaled, numbers)), scaled(first + 2 * half)


def number(frame: Mapping[str, Any]) -> int:
    """The frame's number in the scene."""
    return int(frame["frame"])


def probe_name(probe: Mapping[str, Any]) -> str:
    return str(probe.get("name"))


def probe_in(frame: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The probe of this name in `frame`, empty where it is out of view."""
    return next((probe for probe in items(frame, "probes") if probe_name(probe) == name), {})


def is_active(frame: Mapping[str, Any]) -> bool:
    """Whether any probe was in the camera's view."""
    return bool(frame.get("active"))


def fired_probes(frame: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The probes for which an estimate was made in `frame`."""
    return [probe for probe in items(frame, "probes") if probe.get("fired")]


def reason_of(probe: Mapping[str, Any]) -> str:
    """Why the estimate was made; empty where that is not recorded."""
    return str(probe.get("reason") or "")


def format_moment(frame: Mapping[str, Any]) -> str:
    """The frame's number and time, escaped: "frame 12 (0.37 s)"."""
    time_s = finite(frame.get("time_s"))
    return f"frame {number(frame)}" + ("" if time_s is None else f" ({time_s:.2f} s)")
