"""Report of a run: one self-contained HTML page, pictures first, then plots, then numbers.

It works from a run's results and the pictures beside them alone, never from Blender, so that a report can be written
again on another machine. The same results and pictures give the same bytes. Rejected: a page that loads its pictures
from files, which breaks when it is sent to someone.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.run_results import RunResults, Summary
from xihe_blender.report.document import SCRIPT, document, write_document
from xihe_blender.report.pictures import pictures_section
from xihe_blender.report.plots import plots_section
from xihe_blender.report.tables import numbers_section
from xihe_blender.report.values import closeness, code, escape, format_closeness, rmse_of, too_small_to_judge
from xihenet.formats import DASH, format_bytes, format_count, format_number, format_percent, format_quantity
from xihenet.invalid import format_unanswered


def write_report(results: RunResults, outputs: RunOutputs) -> Path:
    """Write `outputs.report`, whole, with the pictures in `outputs`; OSError where it cannot be written."""
    write_document(outputs.report, report_page(results, outputs))
    return outputs.report


def report_page(results: RunResults, outputs: RunOutputs) -> str:
    name = escape(PurePosixPath(results.scene.file.replace("\\", "/")).stem)
    sections = [
        ("pictures", "Pictures", pictures_section(results, outputs)),
        ("plots", "Frame by frame", plots_section(results)),
        ("numbers", "Numbers", numbers_section(results)),
    ]
    return document(
        name,
        f'<p class="lead">{format_result(results)}</p>{_key_figures(results)}',
        sections,
        title=f"{name}: lighting previsualisation",
        script=SCRIPT,
    )


# ------------------------------------------------------------------------------------------- the result in words


def format_result(results: RunResults) -> str:
    """What the run showed, in two or three plain sentences of HTML."""
    sentences = [_what_was_done(results), _how_close(results)]
    closer = closeness(results.comparison, "truth")
    if closer is not None and results.settings.estimator != "truth":
        sentences.append(f"Lit by the rendered light probe itself, {code('truth')}, they {_against_ambient(closer)}.")
    return " ".join(sentences)


def _what_was_done(results: RunResults) -> str:
    n_estimates, n_objects = results.summary.n_estimates, len(results.scene.virtual_objects)
    over = format_count(len(results.frames), "frame")
    unanswered = format_unanswered(results.summary.invalid.lights)
    made = "asked for" if unanswered else "made"
    sentence = f"Over {over} the phone {made} {format_count(n_estimates, 'estimate')}"
    if n_estimates == 0 and not results.active_frames:
        return f"{sentence}: no position was in view."
    around = f" of the light around {format_count(n_objects, 'virtual object')}" if n_objects else ""
    return f"{sentence}{around}{unanswered}."


def _how_close(results: RunResults) -> str:
    comparison, estimator = results.comparison, results.settings.estimator
    if results.recording is not None:
        return escape(results.recording.said)
    if not comparison:
        return "No frame was compared with the ground truth."
    own, ambient = rmse_of(comparison, estimator), rmse_of(comparison, "ambient")
    lit = f"Lit by {code(estimator)}, the virtual objects"
    if own is None:
        return f"{lit} could not be measured against the ground truth."
    if estimator == "ambient" or ambient is None:
        return f"{lit} differ from the ground truth by an rmse of {format_number(own)}."
    if ambient == 0:
        match = "match the ground truth exactly, as they do"
        ending = match if own == 0 else "differ from the ground truth, which they match"
        return f"{lit} {ending} with <code>ambient</code>."
    numbers = f"rmse {format_number(own)} against {format_number(ambient)}"
    small = too_small_to_judge(results.summary.object_pixels)
    caveat = "" if small is None else f" But {small}."
    return f"{lit} {_against_ambient(1.0 - own / ambient)} ({numbers}).{caveat}"


def _against_ambient(closer: float) -> str:
    """`closeness` as the verb and the rest of a sentence: "are 31 % closer to the ground truth than with ambient"."""
    words = format_closeness(closer)
    if words == "as close":
        return "are as close to the ground truth as with <code>ambient</code>"
    if "times" in words:
        return f"have {words} that they have with <code>ambient</code>"
    return f"are {words} {'to' if closer > 0 else 'from'} the ground truth than with <code>ambient</code>"


def _key_figures(results: RunResults) -> str:
    summary = results.summary
    ambient = summary.ambient_shc_rmse
    against = "" if ambient is None else f"; {format_number(ambient)} with <code>ambient</code>"
    expected = "" if summary.expected_error is None else f"; {format_number(summary.expected_error)} was expected"
    estimates = f"estimate{'' if summary.n_estimates == 1 else 's'} in {format_count(len(results.frames), 'frame')}"
    errors = [
        (format_number(summary.mean_shc_rmse), f"mean light error (SHC RMSE){expected}{against}"),
        _closeness_figure(results),
    ]
    if results.recording is not None:
        errors = [(format_number(summary.expected_error), "mean light error (SHC RMSE) that was expected")]
    figures = [
        (str(summary.n_estimates), estimates),
        *errors,
        (
            format_quantity(summary.mean_step_ms, "ms"),
            "mean time of the chain in a frame, all positions together, without rendering",
        ),
        (format_bytes(sum(probe.payload_bytes for probe in results.probes)), "sent to the estimator in total"),
        _rendering_figure(summary),
    ]
    shown = "".join(f"<div><dt>{label}</dt><dd>{value}</dd></div>" for value, label in figures)
    return f'<dl class="figures">{shown}</dl>'


def _rendering_figure(summary: Summary) -> tuple[str, str]:
    parts = {
        "captures and light probes": summary.render_s,
        "compared pictures": summary.comparison_render_s,
        "choosing the samples": summary.pilot_s,
    }
    words = ", ".join(f"{format_quantity(seconds, 's')} for {part}" for part, seconds in parts.items() if seconds)
    return format_quantity(summary.all_render_s, "s"), f"of rendering{words and f': {words}'}"


def _closeness_figure(results: RunResults) -> tuple[str, str]:
    closer = closeness(results.comparison, results.settings.estimator)
    rounded = round(closer or 0.0, 3)
    direction = "further from" if rounded < 0 else "closer to"
    value = DASH if closer is None else format_percent(abs(rounded))
    return value, f"{direction} the ground truth than <code>ambient</code> (rmse)"
