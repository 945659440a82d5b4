"""Invalid data of a run, and why: one short table that is always there, and what it does not list in one line.

Pixels are those of the phone's frames, points those that a probe samples: a pixel without a plane depth is left out at
every probe, so reasons that pixels have are told once, as pixels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from xihe_blender.report.timeline import Timeline, is_active, number, probe_name
from xihe_blender.report.values import code, escape, finite, finite_only, items, mapping
from xihenet.formats import DASH, format_frames, format_list, format_percent
from xihenet.invalid import CLAMPED, LEFT_OUT, UNKNOWN, format_reason

HEAD = ("what", "how many", "why", "what became of it")
_UNDEFINED = {
    "psnr": "has no finite value for identical pictures, and none where no pixel of an object is seen",
    "angular_deg": "is undefined where one of the colours is black",
}
_NOT_RECORDED = "Not recorded: these results were made before invalid data was counted by reason."


def invalid_rows(results: Mapping[str, Any]) -> list[list[str]]:
    """HTML cells of each kind of invalid data that turned up: pixels, points, clamped values, lights."""
    counts = mapping(mapping(results, "summary"), "invalid")
    pixels, points = mapping(counts, "pixels"), mapping(counts, "points")
    own = {reason: n for reason, n in points.items() if reason not in pixels}
    rows = [_row("pixels", reason, n, _n_pixels(results), "gave no point") for reason, n in pixels.items()]
    rows += [_row("points", reason, n, None, "left out at that probe") for reason, n in own.items()]
    rows += _light_rows(Timeline.of(results)) + _comparison_rows(counts)
    n_followed = finite(mapping(results, "summary").get("n_followed_anchors"))
    if n_followed:
        why = "out of view while the light in view changed as a whole"
        rows.append(["directions around probes", _counted(n_followed), why, "changed alike, a guess"])
    return rows


def format_undefined(metric: str) -> str:
    """When a metric of the comparison has no value: "is undefined where ..."."""
    return _UNDEFINED.get(metric, "is undefined where no pixel of an object is seen")


def _comparison_rows(counts: Mapping[str, Any]) -> list[list[str]]:
    """Metrics without a value in a frame, and pixels without a hue."""
    rows = [
        [code(name), _counted(n, "time"), f"it {format_undefined(name)}", "left out of the mean over frames"]
        for name, n in mapping(counts, "metrics").items()
    ]
    hue = "black in its picture or in the ground truth, so there is no hue"
    return rows + [
        [f"pixels of {code(method)}", _counted(n), hue, f"left out of {code('angular_deg')}"]
        for method, n in mapping(counts, "hues").items()
    ]


def _counted(n: Any, noun: str = "") -> str:
    many = finite(n)
    number = DASH if many is None else f"{many:,.0f}"
    return f"{number} {noun}{'' if many == 1 else 's'}" if noun else number


def _row(what: str, reason: str, n: Any, of_all: float | None, became: str) -> list[str]:
    share = f" ({format_percent((finite(n) or 0.0) / of_all)})" if of_all else ""
    if reason in CLAMPED:
        became = "used, but not as it came"
    return ["distances" if reason.startswith("distance_") else what, f"{_counted(n)}{share}", _why(reason), became]


def _why(reason: str) -> str:
    if not reason:
        return "reason not recorded"
    return (
        escape(format_reason(reason))
        if reason in {**LEFT_OUT, **CLAMPED, **UNKNOWN}
        else f"{code(reason)} of the phone"
    )


def _n_pixels(results: Mapping[str, Any]) -> float | None:
    """Pixels of all frames that were captured; None where the size is not recorded."""
    size = finite_only(items(mapping(results, "settings"), "size"))
    n_frames = sum(map(is_active, Timeline.of(results).frames))
    return size[0] * size[1] * n_frames if len(size) == 2 else None


def _light_rows(timeline: Timeline) -> list[list[str]]:
    """One for each probe and reason."""
    kept: dict[tuple[str, str], list[tuple[int, Any]]] = {}
    for frame in timeline.frames:
        for probe in items(frame, "probes"):
            if is_kept(probe):
                reason = str(probe.get("unknown_because") or "")
                kept.setdefault((probe_name(probe), reason), []).append((number(frame), probe.get("light_frame")))
    return [
        [f"light at {escape(name)}", escape(format_frames([n for n, _ in of_one])), _why(reason), _stayed(of_one)]
        for (name, reason), of_one in kept.items()
    ]


def _stayed(frames_and_sources: Iterable[tuple[int, Any]]) -> str:
    sources = dict.fromkeys(source for _, source in frames_and_sources)
    return format_list(
        ["the ambient light stood in" if s is None else f"the light of frame {escape(s)} stayed" for s in sources]
    )


def is_kept(probe: Mapping[str, Any]) -> bool:
    """Whether the light at a probe could not be known, so that the last one stayed."""
    return probe.get("is_valid") is False


def format_kept(probe: Mapping[str, Any]) -> str:
    """Why the last light was kept: ", last light kept: no surface was seen from there"; empty where it was not."""
    return f", last light kept: {_why(str(probe.get('unknown_because') or ''))}" if is_kept(probe) else ""


def invalid_otherwise(results: Mapping[str, Any]) -> str:
    """One sentence on what the table does not list."""
    counts = mapping(mapping(results, "summary"), "invalid")
    if not counts:
        return _NOT_RECORDED
    pixels, points = mapping(counts, "pixels"), mapping(counts, "points")
    sound = [
        ("every pixel of the phone's frames gave a point", set(pixels) <= set(CLAMPED)),
        ("every point was used", set(points) - set(pixels) <= set(CLAMPED)),
        ("no value was clamped", not {*pixels, *points} & set(CLAMPED)),
        ("the light was known wherever a probe was in view", not mapping(counts, "lights")),
        (
            "every metric had a value and every pixel a hue",
            not {**mapping(counts, "metrics"), **mapping(counts, "hues")},
        ),
    ]
    true = [words for words, is_so in sound if is_so]
    all_is = " Nothing was invalid." if len(true) == len(sound) else ""
    return f"{format_list(true).capitalize()}.{all_is}" if true else ""
