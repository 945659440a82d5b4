"""Timeline of a run: where each frame lies on the report's common time axis, and what happened in it.

All plots and the picture scrubber share one `Timeline`: frames sorted by number, each with a column of the plot's
width in percent. Percent instead of pixels lets one SVG fit a telephone and a wide screen with text of the same size.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

from xihe_blender.io.run_results import FrameResult, ProbeResult, RunResults

Value = Callable[[ProbeResult], float | None]
REASONS = {
    "first": ("first estimate", "diamond"),
    "colour": ("light changed", "circle"),
    "coverage": ("more of the surroundings seen", "triangle"),
    "light": ("light differs", "circle"),  # as "colour": one run has one policy of the trigger
    "moved": ("object moved", "square"),
}
"""Why an estimate was made: in words, and the shape of its mark."""

KEPT = "kept"
"""Stands where a reason stands, for a frame whose light could not be known."""
N_COLOURS = 6


def format_trigger(reason: str) -> str:
    return REASONS[reason][0] if reason in REASONS else reason


def reason_shape(reason: str) -> str:
    """Which of the shapes marks `reason`: one each, so that reasons are told apart without colour."""
    return "cross" if reason == KEPT else REASONS[reason][1]


def series_class(index: int) -> str:
    """Colour and dash of the probe with this index: six colours, then the same six dashed, then dotted."""
    return f"s{index % N_COLOURS} d{index // N_COLOURS % 3}"


@dataclass(frozen=True)
class Timeline:
    """The frames of one run, ascending."""

    frames: tuple[FrameResult, ...]
    edges_percent: tuple[float, ...]  # borders of the frames' columns, one more than there are frames; 0 to 100
    centres_percent: tuple[float, ...]  # where each frame's dots and bars stand: frame numbers to scale
    bar_percent: float  # width of the narrowest column
    probe_names: tuple[str, ...]  # in the order in which they are first seen

    @classmethod
    def of(cls, results: RunResults) -> Timeline:
        """A run without frames is legal."""
        frames = tuple(sorted(results.frames, key=lambda frame: frame.frame))
        names = dict.fromkeys(probe.name for frame in frames for probe in frame.probes)
        return cls(frames, *_columns([frame.frame for frame in frames]), tuple(names))

    @property
    def probes(self) -> list[ProbeResult]:
        return [probe for frame in self.frames for probe in frame.probes]

    def values(self, name: str, value_of: Value) -> list[float | None]:
        """A value of one probe, None for every frame without it."""
        probes = [probe_in(frame, name) for frame in self.frames]
        return [None if probe is None else value_of(probe) for probe in probes]

    def known_values(self, value_of: Value) -> list[float]:
        """A value of all probes, where they have it."""
        return [value for probe in self.probes if (value := value_of(probe)) is not None]

    def inactive_spans(self) -> list[tuple[float, float]]:
        """Percent from and to of each stretch of frames in which no probe is in view."""
        spans: list[tuple[float, float]] = []
        for index, frame in enumerate(self.frames):
            left, right = self.edges_percent[index : index + 2]
            if frame.active:
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


def probe_in(frame: FrameResult, name: str) -> ProbeResult | None:
    """The probe of this name in `frame`, None where it is out of view."""
    return next((probe for probe in frame.probes if probe.name == name), None)


def fired_probes(frame: FrameResult) -> list[ProbeResult]:
    return [probe for probe in frame.probes if probe.fired]


def format_moment(frame: FrameResult) -> str:
    """The frame's number and time: "frame 12 (0.37 s)"."""
    return f"frame {frame.frame} ({frame.time_s:.2f} s)"
