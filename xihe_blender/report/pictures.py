"""Pictures of the report: which frames are shown, and how two pictures of one are compared.

Each chosen frame is a strip of pictures; radio buttons before the strips choose one, so that it works without
JavaScript and with the arrow keys. The wipe borrows the strips' pictures and appears only where JavaScript runs.
Embedding is the price of one self-contained file, so at most `MAX_FRAMES` frames are embedded, and of large pictures
as many as `MAX_BYTES` hold; the others are named.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import FrameResult, RunResults
from xihe_blender.report.document import png_url
from xihe_blender.report.invalid import format_kept
from xihe_blender.report.timeline import KEPT, Timeline, fired_probes, format_moment, format_trigger, reason_shape
from xihe_blender.report.values import code, escape, rmse_of
from xihenet import estimators
from xihenet.formats import format_count, format_list, format_number, format_percent, format_runs
from xihenet.svg import icon

MAX_FRAMES = 16
MAX_BYTES = 150_000_000
"""Of PNG: a page of 200 MB. Of 1920x1440 pixels a frame with three methods has some 20 MB; 16 of them are a page of
430, which takes five times as much memory to be written."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def pictures_section(results: RunResults, outputs: RunOutputs) -> str:
    """The scrubber, a strip for each chosen frame, the wipe, and which frames and files are not here."""
    timeline = Timeline.of(results)
    frames = [frame for frame in timeline.frames if frame.compared is not None or frame.composited]
    if not frames:
        return "<p>This run made no pictures.</p>"
    pictures = {frame.frame: _pictures_of(frame, outputs) for frame in frames}
    chosen = choose_frames(frames, _most_frames(pictures.values(), outputs.folder))
    kinds = picture_kinds(pictures.values(), results.settings.estimator)
    meanings = {kind: _kind_meaning(kind, results.settings.error_map_full_scale) for kind in kinds}
    places = {frame.frame: x for frame, x in zip(timeline.frames, timeline.centres_percent, strict=True)}
    radios = "".join(
        f'<input type="radio" name="moment" id="f{i}" data-x="{places[frame.frame]:.3f}"'
        f' data-frame="{frame.frame}" aria-label="frame {frame.frame}"{"" if i else " checked"}>'
        for i, frame in enumerate(chosen)
    )
    strips = "".join(_strip(i, frame, pictures[frame.frame], meanings, outputs) for i, frame in enumerate(chosen))
    viewer = f'{radios}{_scrubber(chosen)}<div class="moments">{strips}</div>{_wipe(kinds)}'
    return f'{_choosing_rules(len(chosen))}<div class="viewer">{viewer}</div>{_left_out(frames, chosen)}'


def _pictures_of(frame: FrameResult, outputs: RunOutputs) -> Mapping[str, str]:
    """By kind, those of a comparison, or those over a recording."""
    if frame.compared is not None:
        return frame.compared.pictures
    return {"captured": outputs.relative(outputs.picture("captured", frame.frame)), **frame.composited}


def _most_frames(pictures: Iterable[Mapping[str, str]], folder: Path) -> int:
    """How many frames, of which `pictures` has the files by kind, are embedded: one at least."""
    files = [[folder / name for name in of_frame.values()] for of_frame in pictures]
    largest = max(sum(file.stat().st_size for file in of_frame if file.is_file()) for of_frame in files)
    return max(1, min(MAX_FRAMES, MAX_BYTES // max(1, largest)))


def choose_frames(frames: Sequence[FrameResult], most: int = MAX_FRAMES) -> list[FrameResult]:
    """At most that many, ascending: first those at which an estimate was made, then the others, both spread evenly."""
    chosen: list[FrameResult] = []
    for group in ([frame for frame in frames if fired_probes(frame)], frames):
        left = [frame for frame in group if frame not in chosen]
        while left and len(chosen) < most:
            farthest = max(left, key=lambda f: min((abs(f.frame - c.frame) for c in chosen), default=0))
            chosen.append(farthest)
            left.remove(farthest)
    return sorted(chosen, key=lambda frame: frame.frame)


def picture_kinds(pictures: Iterable[Mapping[str, str]], estimator: str) -> list[str]:
    """All kinds of pictures in some frames, in the order in which they are shown."""
    kinds = list(dict.fromkeys(kind for of_frame in pictures for kind in of_frame))
    leading = ["captured", "ground_truth", estimator, "ambient", "truth"]
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


def _kind_meaning(kind: str, error_full_scale: float) -> str:
    if _is_error(kind):
        scale = f"black means none, the brightest colour {format_percent(error_full_scale)} or more"
        return f"Difference between {code(kind.removeprefix('error_'))} and the ground truth, in sRGB: {scale}."
    if kind == "captured":
        return "What the phone's camera recorded: the room without the virtual objects."
    if kind == "ground_truth":
        return "The room and the virtual objects, path-traced together."
    return method_meaning(kind) or "The virtual objects lit by this estimator."


def method_meaning(method: str) -> str:
    """What an estimator is, in one sentence; empty for one that is not registered, as a run of another version has."""
    return f"{estimators.summary(method)}." if method in estimators.names() else ""


# ---------------------------------------------------------------------------------------------- choosing a frame


def _choosing_rules(n_chosen: int) -> str:
    """CSS by which the checked radio button shows its strip and lights up its label."""
    shown = ",".join(f"#f{i}:checked~.moments>#m{i}" for i in range(n_chosen))
    lit = ",".join(f"#f{i}:checked~.scrubber>[for=f{i}]" for i in range(n_chosen))
    focused = ",".join(f"#f{i}:focus-visible~.scrubber>[for=f{i}]" for i in range(n_chosen))
    return (
        f"<style>{shown}{{display:block}}{lit}{{background:var(--ink);color:var(--paper)}}"
        f"{focused}{{outline:3px solid var(--accent);outline-offset:2px}}</style>"
    )


def _scrubber(chosen: Sequence[FrameResult]) -> str:
    labels = ""
    for index, frame in enumerate(chosen):
        reasons = dict.fromkeys(probe.reason for probe in fired_probes(frame))
        icons = "".join(icon(reason_shape(reason)) for reason in reasons)
        labels += f'<label for="f{index}"><span class="icons">{icons}</span>{frame.frame}</label>'
    return f'<div class="scrubber"><span class="scrubber-name">Frame</span>{labels}</div>'


# ------------------------------------------------------------------------------------------------------- pictures


def _strip(
    index: int, frame: FrameResult, pictures: Mapping[str, str], meanings: Mapping[str, str], outputs: RunOutputs
) -> str:
    figures = "".join(_figure(kind, meaning, frame, pictures.get(kind), outputs) for kind, meaning in meanings.items())
    return (
        f'<article class="moment" id="m{index}"><h3>{format_moment(frame).capitalize()}</h3>'
        f'<p class="quiet">{_what_happened(frame)}</p><div class="strip">{figures}</div></article>'
    )


def _what_happened(frame: FrameResult) -> str:
    sentences = []
    for reason in dict.fromkeys(probe.reason for probe in fired_probes(frame)):
        names = [escape(probe.name) for probe in fired_probes(frame) if probe.reason == reason]
        made = f"Estimate made for {format_list(names)}: {format_trigger(reason)}."
        sentences.append(f"{icon(reason_shape(reason))} {made}")
    unknown = [probe for probe in frame.probes if not probe.is_valid]
    sentences += [f"{icon(reason_shape(KEPT))} {escape(probe.name)}{format_kept(probe)}." for probe in unknown]
    return " ".join(sentences) or "No new estimate was needed; the last one stays in use."


def _figure(kind: str, meaning: str, frame: FrameResult, name_of_file: str | None, outputs: RunOutputs) -> str:
    name = kind_label(kind)
    is_method = kind not in ("captured", "ground_truth") and not _is_error(kind)
    title = code(name) if is_method else escape(name[0].upper() + name[1:])
    rmse = None if frame.compared is None else rmse_of(frame.compared.comparison, kind)
    figure = "" if rmse is None else f' <span class="figure-number">rmse {format_number(rmse)}</span>'
    picture = _embedded(kind, frame.frame, name_of_file, outputs)
    return (
        f"<figure>{picture}<figcaption><strong>{title}</strong>{figure}"
        f'<span class="meaning">{meaning}</span></figcaption></figure>'
    )


def _embedded(kind: str, number: int, name: str | None, outputs: RunOutputs) -> str:
    path = outputs.folder / name if name else outputs.picture(kind, number)
    content = _read_png(path, outputs.folder)
    if content is None:
        return (
            f'<div class="missing"><span>No picture here. Expected {code(name or outputs.relative(path))}</span></div>'
        )
    width, height = struct.unpack(">II", content[16:24])
    words = escape(f"{kind_label(kind)}, frame {number}")
    size = f'width="{width}" height="{height}"'
    return f'<img data-kind="{escape(kind)}" {size} alt="{words}" src="{png_url(content)}">'


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


def _left_out(frames: Sequence[FrameResult], chosen: Sequence[FrameResult]) -> str:
    others = [frame.frame for frame in frames if frame not in chosen]
    if not others:
        return ""
    return (
        f'<p class="quiet">{format_count(len(chosen), "frame")} shown here. Pictures of '
        f"{format_count(len(others), 'more frame')} are files beside this page, in {code('pictures/')}: "
        f"{format_runs(others)}.</p>"
    )
