"""The report of a replayed recording: what was seen from each position, which light followed, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from xihe_blender.report.document import document, png_url, table, write_document
from xihe_blender.report.values import escape
from xihenet import svg
from xihenet.formats import format_count, format_percent
from xihenet.invalid import format_reason

SIDE_BY_SIDE, HALF = "display: flex; flex-wrap: wrap; gap: 1rem; align-items: flex-start", "width: 24rem"
COLOURS = ("red", "green", "blue")
SPHERES = (
    "<p>On the left the sphere as it was seen from there, straight up at the top, grey where no frame shows anything. "
    "On the right the last light as a panorama of the same directions, and on a mirror, a matte silver and a grey "
    "ball.</p>"
)


def write_replay_report(
    path: Path,
    content: Mapping[str, Any],
    lights: Mapping[str, tuple[bytes, bytes]],
    frames: Sequence[tuple[int, bytes]],
) -> None:
    """One self-contained page of what replay.json holds.

    `lights` are by position PNG files of the sphere as it was seen, and of its last light; `frames` numbers of some,
    and PNG files of what they show.
    """
    sections = [
        ("light", "The light", _light(content, lights)),
        ("frames", "What the phone saw", _frames(frames)),
        ("time", "When", _timeline(content)),
        ("exposure", "Exposure", _exposure(content)),
        ("score", "Estimators without a true light", _score(content)),
        ("left-out", "What was left out", _left_out(content)),
    ]
    shown = [section for section in sections if section[2]]
    source = f" ({content['source']})" if content["source"] else ""
    write_document(path, document(f"A replay: {escape(content['format'] + source)}", _opening(content), shown))


def _opening(content: Mapping[str, Any]) -> str:
    said = f"{format_count(len(content['frames']), 'frame')}, light by <code>{escape(content['estimator'])}</code>, "
    said += "all of it" if content["target"] == "hdr" else "clipped at white"
    if not content["positions"]:
        said = "Estimators were scored at places of the room; no light was asked for"
    moments = [one["light_gain"] for frame in content["frames"] for one in frame["positions"].values()]
    n_carried = sum(gain is not None and set(gain) != {1.0} for gain in moments)
    if n_carried:
        said += f". {format_count(n_carried, 'time')} the light in view had changed since the last estimate, which was "
        said += "carried on by the same factor until the next one was there"
    return f"<p>{said}. {' '.join(escape(note) for note in content['notes'])}</p>"


def _light(content: Mapping[str, Any], lights: Mapping[str, tuple[bytes, bytes]]) -> str:
    if not content["positions"]:
        return ""
    head = ["position", "estimates", "last in frame", "seen of the sphere", "expected error", "key light from"]
    rows, pictures = [], ""
    for place in content["positions"]:
        where = ", ".join(f"{x:.10g}" for x in place["at"])
        rows.append([f"{escape(place['name'])} at {where} m", *_last(place)])
        if place["name"] not in lights:
            continue
        seen, shown = lights[place["name"]]
        pictures += (
            f'<figure class="plot"><figcaption><h3>{escape(place["name"])}</h3></figcaption>'
            f'<div style="{SIDE_BY_SIDE}"><img src="{png_url(seen)}" alt="the sphere as seen" style="{HALF}">'
            f'<img src="{png_url(shown)}" alt="the light" style="{HALF}"></div></figure>'
        )
    return table(head, rows) + (SPHERES + pictures if pictures else "")


def _last(place: Mapping[str, Any]) -> list[str]:
    if not place["lights"]:
        return ["none: nothing was seen from there", "", format_percent(place["coverage"]), "", ""]
    last = place["lights"][-1]
    expected, key = last["expected_error"], last["key_light"]
    return [
        str(len(place["lights"])),
        str(last["frame"]),
        format_percent(place["coverage"]),
        "unknown" if expected is None else f"{expected:.2f}",
        "no one direction" if key is None else ", ".join(f"{x:.2f}" for x in key["direction"]),
    ]


def _frames(frames: Sequence[tuple[int, bytes]]) -> str:
    return "".join(
        f'<img src="{png_url(picture)}" alt="frame {number}" title="frame {number}" '
        'style="width: 24%; min-width: 160px">'
        for number, picture in frames
    )


def _timeline(content: Mapping[str, Any]) -> str:
    """Coverage by frame, with a mark at each estimate."""
    frames = content["frames"]
    if not frames or not content["positions"]:
        return ""
    times = [one["time_s"] for one in frames]
    across, up = svg.linear_axis(min(times), max(times), n_steps=6), svg.linear_axis(0, 1)
    body, entries = svg.grid_across(up) + svg.axis_of(across, "seconds"), []
    for colour, place in enumerate(content["positions"]):
        name = place["name"]
        steps = [(one["time_s"], one["positions"].get(name)) for one in frames]
        points = [None if step is None else (across.x(t), up.y(step["coverage"])) for t, step in steps]
        body += svg.line(points, f"s{colour % 6}")
        marks = [(t, step) for t, step in steps if step is not None and step["fired"]]
        body += "".join(
            svg.dot(across.x(t), up.y(step["coverage"]), f"dot s{colour % 6}", f"{name}, {step['reason']}")
            for t, step in marks
        )
        entries.append(f"{svg.icon('circle', f'dot s{colour % 6}')} {escape(name)}")
    about = "The share of the sphere that is known at each position, where the camera sees it; a dot is an estimate."
    return svg.figure(body, title="Coverage and estimates", about=about, below=svg.legend(entries))


def _exposure(content: Mapping[str, Any]) -> str:
    """The gains that were found, by frame."""
    drift = content.get("drift")
    if drift is None:
        return ""
    gains: Sequence[Sequence[float]] = drift["gains"]
    high = max(max(row) for row in gains)
    across = svg.linear_axis(0, max(len(gains) - 1, 1), n_steps=6)
    up = svg.linear_axis(0, high)
    body = svg.grid_across(up) + svg.axis_of(across, "frames of the recording")
    for channel in range(3):
        body += svg.line([(across.x(k), up.y(row[channel])) for k, row in enumerate(gains)], f"s{channel}")
    about = (
        "By how much the phone's exposure and white balance differ from those of the first frame, from surfaces that "
        f"are seen again, and were divided out. {format_count(drift['n_unknown'], 'frame')} could not be tied to the "
        "first one."
    )
    entries = [f"{svg.icon('circle', f'dot s{k}')} {name}" for k, name in enumerate(COLOURS)]
    return svg.figure(body, title="Gains by channel", about=about, below=svg.legend(entries), is_wide=True)


def _score(content: Mapping[str, Any]) -> str:
    score = content["score"]
    if not score or not score["estimators"]:
        return ""
    head = ["estimator", "error", "95 % interval", "better than ambient at", "places"]
    rows = [
        [
            escape(one["estimator"]),
            f"{one['rmse']:.3f}",
            "" if one["low"] is None else f"{one['low']:.3f} to {one['high']:.3f}",
            "" if one["estimator"] == "ambient" else format_percent(one["share_better"]),
            str(one["n_places"]),
        ]
        for one in score["estimators"]
    ]
    return f"<p>{escape(score['says'])}</p>" + table(head, rows)


def _left_out(content: Mapping[str, Any]) -> str:
    rows = [
        [escape(place["name"]), escape(format_reason(reason)), format_count(n, what)]
        for place in content["positions"]
        for what, counts in (("point", place["invalid"]), ("frame", place["unknown"]))
        for reason, n in counts.items()
    ]
    return table(["position", "why", "left out"], rows) if rows else ""
