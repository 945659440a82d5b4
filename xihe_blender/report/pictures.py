"""Pictures of the report: which frames are shown, and how two pictures of one are compared.

Each chosen frame is a strip of pictures; radio buttons before the strips choose one, so that it works without
JavaScript and with the arrow keys. The wipe borrows the strips' pictures and appears only where JavaScript runs.
Embedding is the price of one self-contained file, so at most `MAX_FRAMES` frames are embedded; the others are named.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.report.document import png_url
from xihe_blender.report.invalid import format_kept, is_kept
from xihe_blender.report.timeline import (
    KEPT,
    Timeline,
    fired_probes,
    format_moment,
    format_trigger,
    is_active,
    number,
    probe_name,
    reason_of,
    reason_shape,
)
from xihe_blender.report.values import code, escape, finite, items, mapping
from xihenet.formats import format_count, format_list, format_number, format_percent, format_runs
from xihenet.svg import icon

MAX_FRAMES = 16
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SHOWN_MISSING = 12

METHOD_MEANINGS = {
    "ambient": "One colour from all around, as a phone's ambient light sensing gives it.",
    "probe": "A mirror ball at the object's place, seen by the camera.",
    "projection": "Least squares on what the camera has seen so far; nothing is learned.",
    "pointar": "Uniform random sampling and a point network.",
    "xihenet": "Unit-sphere sampling and a point network, as in the paper.",
    "lattice": "A network on the fixed directions around the object.",
    "truth": "The light probe rendered at the object's place, as spherical harmonics.",
}

Frame = Mapping[str, Any]


def pictures_section(results: Mapping[str, Any], outputs: RunOutputs) -> str:
    """The scrubber, a strip for each chosen frame, the wipe, and which frames and files are not here."""
    timeline = Timeline.of(results)
    frames = [frame for frame in timeline.frames if mapping(frame, "pictures")]
    if not frames:
        return "<p>This run made no pictures.</p>"
    chosen = choose_frames(frames)
    settings = mapping(results, "settings")
    kinds = picture_kinds(frames, settings.get("estimator"))
    meanings = {kind: _kind_meaning(kind, finite(settings.get("error_map_full_scale"))) for kind in kinds}
    start = next((i for i, frame in enumerate(chosen) if is_compared(frame)), 0)
    places = dict(zip(map(number, timeline.frames), timeline.centres_percent, strict=True))
    radios = "".join(
        f'<input type="radio" name="moment" id="f{i}" data-x="{places[number(frame)]:.3f}"'
        f' data-frame="{number(frame)}" aria-label="frame {number(frame)}"{" checked" if i == start else ""}>'
        for i, frame in enumerate(chosen)
    )
    strips = "".join(_strip(i, frame, meanings, outputs) for i, frame in enumerate(chosen))
    return (
        f'{_choosing_rules(len(chosen))}<div class="viewer">{radios}{_scrubber(chosen)}'
        f'<div class="moments">{strips}</div>{_wipe(kinds)}</div>{_left_out(frames, chosen)}{_missing(frames, outputs)}'
    )


def is_compared(frame: Frame) -> bool:
    """Whether the frame has pictures beyond the captured one."""
    return any(kind != "captured" for kind in mapping(frame, "pictures"))


def choose_frames(frames: Sequence[Frame], limit: int = MAX_FRAMES) -> list[Frame]:
    """At most `limit` of `frames`, ascending: compared ones first, of these first those at which an estimate was made.

    Frames with nothing but a captured picture are taken only where an estimate was made or where no frame was
    compared. Within each of these groups the frames are spread evenly.
    """
    compared = [frame for frame in frames if is_compared(frame)]
    fired = [frame for frame in frames if fired_probes(frame)]
    groups = [[frame for frame in compared if fired_probes(frame)], compared, fired, [] if compared else list(frames)]
    chosen: list[Frame] = []
    for group in groups:
        _spread(chosen, group, limit)
    return sorted(chosen, key=number)


def _spread(chosen: list[Frame], group: Sequence[Frame], limit: int) -> None:
    """Add frames of `group` to `chosen`, each time the one that is farthest from all that are chosen already."""
    left = [frame for frame in group if not any(frame is other for other in chosen)]
    while left and len(chosen) < limit:
        farthest = max(left, key=lambda f: min((abs(number(f) - number(c)) for c in chosen), default=0))
        chosen.append(farthest)
        left = [frame for frame in left if frame is not farthest]


def picture_kinds(frames: Sequence[Frame], estimator: Any) -> list[str]:
    """All kinds of pictures in these frames, in the order in which they are shown."""
    kinds = list(dict.fromkeys(kind for frame in frames for kind in mapping(frame, "pictures")))
    leading = ["captured", "ground_truth", str(estimator), "ambient", "truth"]
    methods = [k for k in leading if k in kinds] + [k for k in kinds if k not in leading and not _is_error(k)]
    errors = [f"error_{method}" for method in methods if f"error_{method}" in kinds]
    return methods + errors + [kind for kind in kinds if _is_error(kind) and kind not in errors]


def _is_error(kind: str) -> bool:
    return kind.startswith("error_")


def kind_label(kind: str) -> str:
    """What a picture is called, in plain text."""
    if _is_error(kind):
        return f"error of {kind.removeprefix('error_')}"
    return {"captured": "captured frame", "ground_truth": "ground truth"}.get(kind, kind)


def _kind_meaning(kind: str, error_full_scale: float | None) -> str:
    if _is_error(kind):
        scale = (
            ""
            if error_full_scale is None
            else f": black is none, the brightest {format_percent(error_full_scale)} or more"
        )
        return f"Difference between {code(kind.removeprefix('error_'))} and the ground truth, in sRGB{scale}."
    if kind == "captured":
        return "What the phone's camera recorded: the room without the virtual objects."
    if kind == "ground_truth":
        return "The room and the virtual objects, path-traced together."
    return METHOD_MEANINGS.get(kind, "The virtual objects lit by this estimator.")


# ---------------------------------------------------------------------------------------------- choosing a frame


def _choosing_rules(n_chosen: int) -> str:
    """CSS by which the checked radio button shows its strip and lights up its label."""

    def selectors(pattern: str) -> str:
        return ",".join(pattern.format(i=i) for i in range(n_chosen))

    shown = selectors("#f{i}:checked~.moments>#m{i}")
    lit = selectors("#f{i}:checked~.scrubber>[for=f{i}]")
    focused = selectors("#f{i}:focus-visible~.scrubber>[for=f{i}]")
    return (
        f"<style>{shown}{{display:block}}{lit}{{background:var(--ink);color:var(--paper)}}"
        f"{focused}{{outline:3px solid var(--accent);outline-offset:2px}}</style>"
    )


def _scrubber(chosen: Sequence[Frame]) -> str:
    labels = ""
    for index, frame in enumerate(chosen):
        reasons = dict.fromkeys(map(reason_of, fired_probes(frame)))
        icons = "".join(icon(reason_shape(reason)) for reason in reasons)
        labels += f'<label for="f{index}"><span class="icons">{icons}</span>{number(frame)}</label>'
    return f'<div class="scrubber"><span class="scrubber-name">Frame</span>{labels}</div>'


# ------------------------------------------------------------------------------------------------------- pictures


def _strip(index: int, frame: Frame, meanings: Mapping[str, str], outputs: RunOutputs) -> str:
    shown = [kind for kind in meanings if is_compared(frame) or kind in mapping(frame, "pictures")]
    figures = "".join(_figure(frame, kind, meanings[kind], outputs) for kind in shown)
    heading = format_moment(frame)
    return (
        f'<article class="moment" id="m{index}"><h3>{heading[0].upper()}{heading[1:]}</h3>'
        f'<p class="quiet">{_what_happened(frame)}</p><div class="strip">{figures}</div></article>'
    )


def _what_happened(frame: Frame) -> str:
    sentences = []
    for reason in dict.fromkeys(map(reason_of, fired_probes(frame))):
        names = [escape(probe_name(probe)) for probe in fired_probes(frame) if reason_of(probe) == reason]
        sentences.append(
            f"{icon(reason_shape(reason))} Estimate made for {format_list(names)}: {format_trigger(reason)}."
        )
    for probe in filter(is_kept, items(frame, "probes")):
        sentences.append(f"{icon(reason_shape(KEPT))} {escape(probe_name(probe))}{format_kept(probe)}.")
    if not is_active(frame):
        sentences.append("No probe in view.")
    elif not sentences:
        sentences.append("No estimate was due; the last one stays in force.")
    if not is_compared(frame):
        sentences.append("This frame was not compared with the ground truth.")
    return " ".join(sentences)


def _figure(frame: Frame, kind: str, meaning: str, outputs: RunOutputs) -> str:
    name = kind_label(kind)
    title = (
        escape(name[0].upper() + name[1:]) if kind in ("captured", "ground_truth") or _is_error(kind) else code(name)
    )
    rmse = finite(mapping(mapping(frame, "comparison"), kind).get("rmse"))
    figure = "" if rmse is None else f' <span class="figure-number">rmse {format_number(rmse)}</span>'
    picture = _embedded(frame, kind, outputs)
    return (
        f"<figure>{picture}<figcaption><strong>{title}</strong>{figure}"
        f'<span class="meaning">{meaning}</span></figcaption></figure>'
    )


def _embedded(frame: Frame, kind: str, outputs: RunOutputs) -> str:
    path = _picture_path(frame, kind, outputs)
    content = _read_png(path, outputs.folder)
    if content is None:
        return f'<div class="missing"><span>No picture here. Expected {code(_shown_path(path, outputs))}</span></div>'
    width, height = struct.unpack(">II", content[16:24])
    words = escape(f"{kind_label(kind)}, frame {number(frame)}")
    size = f'width="{width}" height="{height}"'
    return f'<img data-kind="{escape(kind)}" {size} alt="{words}" src="{png_url(content)}">'


def _picture_path(frame: Frame, kind: str, outputs: RunOutputs) -> Path:
    """Where the results say that the picture is, or where a run would have put it."""
    name = mapping(frame, "pictures").get(kind)
    return outputs.folder / str(name) if name else outputs.picture(kind, number(frame))


def _shown_path(path: Path, outputs: RunOutputs) -> str:
    return outputs.relative(path) if path.is_relative_to(outputs.folder) else str(path)


def _read_png(path: Path, folder: Path) -> bytes | None:
    """The file, or None where it is missing, is no PNG picture, or lies outside the run's folder."""
    if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
        return None
    content = path.read_bytes()
    return content if content.startswith(_PNG_SIGNATURE) and len(content) > 24 else None


# -------------------------------------------------------------------------------------------------- wipe and notes


def _wipe(kinds: Sequence[str]) -> str:
    """A stage for two pictures with a divider; hidden until the script has filled it."""
    if len(kinds) < 2:
        return ""
    first = "ground_truth" if "ground_truth" in kinds else kinds[0]
    second = next((kind for kind in kinds if kind not in ("captured", first)), kinds[1])
    return (
        '<div class="wipe" hidden><h3>Wipe between two pictures <span class="quiet" data-now></span></h3>'
        f'<div class="wipe-names">{_choice("Left", "wipe-left", kinds, first)}'
        f"{_choice('Right', 'wipe-right', kinds, second)}</div>"
        '<div class="stage"><img class="under" alt=""><img class="over" alt=""><div class="absent"></div>'
        '<div class="divider" role="slider" tabindex="0" aria-label="divider" aria-valuemin="0" aria-valuemax="100"'
        ' aria-valuenow="50"></div></div>'
        '<p class="quiet">Drag the line, or move it with the arrow keys.</p></div>'
    )


def _choice(label: str, name: str, kinds: Sequence[str], selected: str) -> str:
    options = "".join(
        f'<option value="{escape(kind)}"{" selected" if kind == selected else ""}>{escape(kind_label(kind))}</option>'
        for kind in kinds
    )
    return f'<label>{label} <select id="{name}">{options}</select></label>'


def _left_out(frames: Sequence[Frame], chosen: Sequence[Frame]) -> str:
    shown = set(map(number, chosen))
    others = [number(frame) for frame in frames if number(frame) not in shown]
    if not others:
        return ""
    return (
        f'<p class="quiet">{format_count(len(chosen), "frame")} shown here. Pictures of '
        f"{format_count(len(others), 'more frame')} are files beside this page, in {code('pictures/')}: "
        f"{format_runs(others)}.</p>"
    )


def _missing(frames: Sequence[Frame], outputs: RunOutputs) -> str:
    """Names every picture that the results promise and the folder does not hold, also of frames not shown."""
    missing = [
        _shown_path(path, outputs)
        for frame in frames
        for kind in mapping(frame, "pictures")
        if not (path := _picture_path(frame, kind, outputs)).is_file()
    ]
    if not missing:
        return ""
    named = [code(path) for path in missing[:_SHOWN_MISSING]]
    if len(missing) > _SHOWN_MISSING:
        named.append(f"{len(missing) - _SHOWN_MISSING} more")
    return f'<p class="warning">{format_count(len(missing), "picture").capitalize()} missing: {format_list(named)}.</p>'
