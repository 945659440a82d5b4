"""Invalid data of a run, and why: one short table that is always there, and what it does not list in one line.

Pixels are those of the phone's frames, points those that a position samples: a pixel without a plane depth is left out
at every position, so reasons that pixels have are told once, as pixels.
"""

from __future__ import annotations

import math

from xihe_blender.io.run_results import InvalidCounts, ProbeResult, RunResults
from xihe_blender.report.timeline import Timeline
from xihe_blender.report.values import code, escape
from xihenet.formats import format_frames, format_list, format_percent
from xihenet.invalid import CLAMPED, LEFT_OUT, UNKNOWN, format_reason

HEAD = ("what", "how many", "why", "what became of it")
_UNDEFINED = {
    "psnr": "has no finite value for identical pictures, and none where no pixel of an object is visible",
    "angular_deg": "is undefined where one of the colours is black",
}


def invalid_rows(results: RunResults) -> list[list[str]]:
    """HTML cells of each kind of invalid data that turned up: pixels, points, clamped values, lights."""
    counts, n_followed = results.summary.invalid, results.summary.n_followed_anchors
    n_pixels = math.prod(results.settings.size) * len(results.captured_frames)
    own = {reason: n for reason, n in counts.points.items() if reason not in counts.pixels}
    rows = [_row("pixels", reason, n, n_pixels, _pixels_became(reason)) for reason, n in counts.pixels.items()]
    rows += [_row("points", reason, n, 0, "left out at that position") for reason, n in own.items()]
    rows += _light_rows(Timeline.of(results)) + _comparison_rows(counts)
    if n_followed:
        why = "out of view while the light in view changed as a whole"
        rows.append(["directions around positions", f"{n_followed:,}", why, "scaled by the same factor, a guess"])
    return rows


def format_undefined(metric: str) -> str:
    """When a metric of the comparison has no value: "is undefined where ..."."""
    return _UNDEFINED.get(metric, "is undefined where no pixel of an object is visible")


def _comparison_rows(counts: InvalidCounts) -> list[list[str]]:
    """Metrics without a value in a frame, and pixels without a hue."""
    rows = []
    for name, n in counts.metrics.items():
        times = f"{n:,} time{'' if n == 1 else 's'}"
        rows.append([code(name), times, f"it {format_undefined(name)}", "left out of the mean over frames"])
    hue = "black in its picture or in the ground truth, so there is no hue"
    for method, n in counts.hues.items():
        rows.append([f"pixels of {code(method)}", f"{n:,}", hue, f"left out of {code('angular_deg')}"])
    return rows


def _row(what: str, reason: str, n: int, of_all: int, became: str) -> list[str]:
    share = f" ({format_percent(n / of_all)})" if of_all else ""
    if reason in CLAMPED:
        became = "used after clamping"
    return ["distances" if reason.startswith("distance_") else what, f"{n:,}{share}", _why(reason), became]


def _pixels_became(reason: str) -> str:
    return "gave no point" if reason in ("not_finite", "colour_not_finite") else "light from far away"


def _why(reason: str | None) -> str:
    if not reason:
        return "reason not recorded"
    is_ours = reason in {**LEFT_OUT, **CLAMPED, **UNKNOWN}
    return escape(format_reason(reason)) if is_ours else f"{code(reason)} of the phone"


def _light_rows(timeline: Timeline) -> list[list[str]]:
    """One for each probe and reason."""
    kept: dict[tuple[str, str | None], list[tuple[int, int | None]]] = {}
    for frame in timeline.frames:
        for probe in frame.probes:
            if not probe.is_valid:
                kept.setdefault((probe.name, probe.unknown_because), []).append((frame.frame, probe.light_frame))
    rows = []
    for (name, reason), of_one in kept.items():
        sources = dict.fromkeys(source for _, source in of_one)
        instead = [
            f"the light of frame {s} was kept" if s is not None else "the ambient light was used instead"
            for s in sources
        ]
        frames = escape(format_frames([number for number, _ in of_one]))
        rows.append([f"light at {escape(name)}", frames, _why(reason), format_list(instead)])
    return rows


def format_kept(probe: ProbeResult) -> str:
    """Why the last light was kept: ", last light kept: no surface was seen from there"; empty where it was not."""
    return "" if probe.is_valid else f", last light kept: {_why(probe.unknown_because)}"


def invalid_otherwise(counts: InvalidCounts) -> str:
    """One sentence on what the table does not list."""
    pixels, points = counts.pixels, counts.points
    sound = [
        ("every pixel of the phone's frames gave a point", set(pixels) <= set(CLAMPED)),
        ("every point was used", set(points) - set(pixels) <= set(CLAMPED)),
        ("no value was clamped", not {*pixels, *points} & set(CLAMPED)),
        ("the light was known wherever a position was in view", not counts.lights),
        ("every metric had a value and every pixel a hue", not counts.metrics and not counts.hues),
    ]
    true = [words for words, is_so in sound if is_so]
    all_is = " Nothing was invalid." if len(true) == len(sound) else ""
    return f"{format_list(true).capitalize()}.{all_is}" if true else ""
