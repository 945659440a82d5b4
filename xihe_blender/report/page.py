"""Report of a run: one self-contained HTML page, pictures first, then plots, then numbers.

It works from results.json and the pictures beside it alone, never from Blender, so that a report can be written again
on another machine. The same results and pictures give the same bytes. Rejected: a page that loads its pictures from
files, which breaks when it is sent to someone.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.report.document import SCRIPT, document, write_document
from xihe_blender.report.pictures import pictures_section
from xihe_blender.report.plots import plots_section
from xihe_blender.report.tables import numbers_section
from xihe_blender.report.timeline import Timeline, fired_probes, is_active
from xihe_blender.report.values import closeness, code, escape, finite, finite_only, format_closeness, items, mapping
from xihenet.formats import DASH, format_bytes, format_count, format_number, format_percent, format_quantity

SCHEMA_VERSION = 1


def write_report(results: Mapping[str, Any], outputs: RunOutputs) -> Path:
    """Write the page that the user opens first.

    Parameters
    ----------
    results : as in results.json, schema version 1; any value may be null
    outputs : the run's files; pictures are read from there, one that is missing is named in the page

    Returns
    -------
    `outputs.report`, whole

    Raises
    ------
    ValueError : for another schema version
    OSError : where the page cannot be written
    """
    if results.get("schema_version") != SCHEMA_VERSION:
        raise ValueError(f"results: expected schema_version {SCHEMA_VERSION}, got {results.get('schema_version')}")
    write_document(outputs.report, report_page(results, outputs))
    return outputs.report


def report_page(results: Mapping[str, Any], outputs: RunOutputs) -> str:
    """The page as text."""
    name = _scene_name(results, outputs)
    sections = [
        ("pictures", "Pictures", pictures_section(results, outputs)),
        ("plots", "Frame by frame", plots_section(results)),
        ("numbers", "Numbers", numbers_section(results)),
    ]
    return document(
        escape(name),
        f'<p class="lead">{format_result(results)}</p>{_key_figures(results)}',
        sections,
        title=f"{escape(name)}: lighting previsualisation",
        script=SCRIPT,
    )


def _scene_name(results: Mapping[str, Any], outputs: RunOutputs) -> str:
    file = str(mapping(results, "scene").get("file") or outputs.scene)
    return PurePosixPath(file.replace("\\", "/")).stem


# ------------------------------------------------------------------------------------------- the result in words


def format_result(results: Mapping[str, Any]) -> str:
    """What the run showed, in two or three plain sentences of HTML."""
    return " ".join(filter(None, [_what_was_done(results), _how_close(results), _how_close_truth(results)]))


def _what_was_done(results: Mapping[str, Any]) -> str:
    frames = Timeline.of(results).frames
    known = finite(mapping(results, "summary").get("n_estimates"))
    n_estimates = sum(len(fired_probes(frame)) for frame in frames) if known is None else round(known)
    sentence = f"Over {format_count(len(frames), 'frame')} the phone made {format_count(n_estimates, 'estimate')}"
    if n_estimates == 0 and not any(map(is_active, frames)):
        return f"{sentence}: no probe was in view."
    n_objects = len(items(mapping(results, "scene"), "virtual_objects"))
    return (
        f"{sentence} of the light around {format_count(n_objects, 'virtual object')}." if n_objects else f"{sentence}."
    )


def _how_close(results: Mapping[str, Any]) -> str:
    comparison, estimator = mapping(results, "comparison"), mapping(results, "settings").get("estimator")
    if not comparison:
        return "No frame was compared with the ground truth."
    own, ambient = (finite(mapping(comparison, str(name)).get("rmse")) for name in (estimator, "ambient"))
    lit = f"Lit by {code(estimator)}, the virtual objects"
    if own is None:
        return f"{lit} could not be measured against the ground truth."
    if estimator == "ambient" or ambient is None:
        return f"{lit} differ from the ground truth by an rmse of {format_number(own)}."
    if ambient == 0:
        ending = "match the ground truth exactly, as they do" if own == 0 else "miss the ground truth, which they match"
        return f"{lit} {ending} with <code>ambient</code>."
    words = format_closeness(1.0 - own / ambient)
    numbers = f"rmse {format_number(own)} against {format_number(ambient)}"
    return f"{lit} are {words} {_joint(words)} with <code>ambient</code> ({numbers})."


def _joint(words: str) -> str:
    """What follows "31 % closer", "as close" or "3.1 times as far" in a sentence."""
    if words == "as close":
        return "to the ground truth as"
    if "times" in words:
        return "from the ground truth as"
    return "to the ground truth than" if words.endswith("closer") else "from the ground truth than"


def _how_close_truth(results: Mapping[str, Any]) -> str:
    closer = closeness(mapping(results, "comparison"), "truth")
    if closer is None or mapping(results, "settings").get("estimator") == "truth":
        return ""
    return f"The rendered light probe itself, {code('truth')}, is {format_closeness(closer)}."


def _key_figures(results: Mapping[str, Any]) -> str:
    summary, frames = mapping(results, "summary"), Timeline.of(results).frames
    n_estimates = finite(summary.get("n_estimates"))
    payload = sum(finite_only(p.get("payload_bytes") for f in frames for p in items(f, "probes")))
    estimates = f"estimate{'' if n_estimates == 1 else 's'} in {format_count(len(frames), 'frame')}"
    figures = [
        (DASH if n_estimates is None else f"{n_estimates:.0f}", estimates),
        _error_figure(summary),
        _closeness_figure(results),
        (format_quantity(finite(summary.get("mean_step_ms")), "ms"), "mean time of one step, without rendering"),
        (format_bytes(payload), "sent to the estimator in all"),
        _render_figure(summary),
    ]
    shown = "".join(f"<div><dt>{label}</dt><dd>{value}</dd></div>" for value, label in figures)
    return f'<dl class="figures">{shown}</dl>'


def _error_figure(summary: Mapping[str, Any]) -> tuple[str, str]:
    ambient = finite(summary.get("ambient_shc_rmse"))
    against = "" if ambient is None else f"; {format_number(ambient)} with <code>ambient</code>"
    return format_number(finite(summary.get("mean_shc_rmse"))), f"mean coefficient error (SHC RMSE){against}"


def _closeness_figure(results: Mapping[str, Any]) -> tuple[str, str]:
    closer = closeness(mapping(results, "comparison"), str(mapping(results, "settings").get("estimator")))
    rounded = round(closer or 0.0, 3)
    direction = "further from" if rounded < 0 else "closer to"
    value = DASH if closer is None else format_percent(abs(rounded))
    return value, f"{direction} the ground truth than <code>ambient</code> (rmse)"


def _render_figure(summary: Mapping[str, Any]) -> tuple[str, str]:
    overhead = finite(summary.get("overhead_share"))
    around = "" if overhead is None else f", and {format_percent(overhead)} of work around it"
    return format_quantity(finite(summary.get("render_s")), "s"), f"of rendering{around}"
