"""Tables of the numbers behind the pictures, and of what made them.

Tables hold what results.json holds: a number in the comparison keeps its full value in a `data` element, a null is a
dash with its reason below the table. `truth` is no competitor, since no phone has it, so the best is marked among the
other methods.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from xihe_blender.report.document import block, table
from xihe_blender.report.invalid import HEAD as INVALID_HEAD
from xihe_blender.report.invalid import format_undefined, invalid_otherwise, invalid_rows
from xihe_blender.report.pictures import METHOD_MEANINGS
from xihe_blender.report.timeline import Timeline, format_trigger, probe_in, reason_of
from xihe_blender.report.values import (
    closeness,
    code,
    escape,
    finite,
    finite_only,
    format_closeness,
    items,
    mapping,
    mean,
)
from xihenet.formats import (
    DASH,
    MINUS,
    format_bytes,
    format_list,
    format_number,
    format_percent,
    format_quantity,
    format_runs,
    format_setting,
)

# name, direction that is better, unit
METRICS = (
    ("psnr", "up", "dB"),
    ("ssim", "up", ""),
    ("rmse", "down", ""),
    ("si_rmse", "down", ""),
    ("angular_deg", "down", ""),
)
_BETTER = {"up": "\N{UPWARDS ARROW} higher is better", "down": "\N{DOWNWARDS ARROW} lower is better"}


def numbers_section(results: Mapping[str, Any]) -> str:
    """All tables, from the comparison to the command."""
    timeline = Timeline.of(results)
    parts = [
        _comparison(results),
        block("Probes", _probes(timeline)),
        block("Effects", _effects(results)),
        block("Phone", _phone(results)),
        block("What was invalid, and why", _invalid(results)),
        block("Notes", _notes(results)),
        block("Command", _command(results)),
        _facts(results),
    ]
    return "".join(parts)


# ----------------------------------------------------------------------------------------------------- comparison


def _comparison(results: Mapping[str, Any]) -> str:
    comparison = mapping(results, "comparison")
    if not comparison:
        return block("Comparison with the ground truth", "<p>No frame was compared with the ground truth.</p>")
    methods = sorted(comparison, key=lambda m: (m == "truth", m == "ambient"))
    columns = [_metric_column(comparison, methods, name, way) for name, way, _ in METRICS]
    rows = [
        [_method_name(results, m), *(column[i] for column in columns), _closer_cell(comparison, m)]
        for i, m in enumerate(methods)
    ]
    head = ["method", *(_metric_head(*metric) for metric in METRICS), "rmse against <code>ambient</code>"]
    about = (
        "Averages over the compared frames, inside the virtual objects. psnr and ssim are taken on the sRGB pictures,"
        " the others on linear colour."
    )
    star = "\N{BLACK STAR} marks the best method that a phone could run; <code>truth</code> is not one."
    honest = "No image metric tracks human preference: look at the pictures before you trust a ranking."
    notes = f'<p class="quiet">{star} {honest}</p>{_null_reasons(comparison, methods)}'
    return block("Comparison with the ground truth", f"<p>{about}</p>{table(head, rows, 'stacking comparison')}{notes}")


def _metric_head(name: str, way: str, unit: str) -> str:
    return f'{name}{f" ({unit})" if unit else ""}<span class="way">{_BETTER[way]}</span>'


def _method_name(results: Mapping[str, Any], method: str) -> str:
    tag = " (chosen)" if method == mapping(results, "settings").get("estimator") else ""
    return f'{code(method)}{tag}<span class="way">{METHOD_MEANINGS.get(method, "")}</span>'


def _metric_column(comparison: Mapping[str, Any], methods: Sequence[str], name: str, way: str) -> list[str]:
    values = {method: finite(mapping(comparison, method).get(name)) for method in methods}
    rivals = finite_only(value for method, value in values.items() if method != "truth")
    best = (max if way == "up" else min)(rivals) if len(rivals) > 1 else None
    decimals = _column_decimals(finite_only(values.values()))
    cells = []
    for method, value in values.items():
        if value is None:
            cells.append(DASH)
            continue
        shown = f'<data value="{value!r}">{value:,.{decimals}f}</data>'
        is_best = value == best and method != "truth"
        cells.append(f'<strong class="best">\N{BLACK STAR} {shown}</strong>' if is_best else shown)
    return cells


def _column_decimals(values: Sequence[float]) -> int:
    """Decimals that show the smallest value that is not 0 with three format_number digits: 2 to 8."""
    smallest = min((abs(value) for value in values if value), default=1.0)
    return min(8, max(2, 2 - math.floor(math.log10(smallest))))


def _closer_cell(comparison: Mapping[str, Any], method: str) -> str:
    if method == "ambient":
        return "the yardstick"
    closer = closeness(comparison, method)
    return DASH if closer is None else format_closeness(closer)


def _null_reasons(comparison: Mapping[str, Any], methods: Sequence[str]) -> str:
    reasons = []
    for name, _, _ in METRICS:
        empty = [code(m) for m in methods if finite(mapping(comparison, m).get(name)) is None]
        if empty:
            reasons.append(f"{name} of {format_list(empty)} {format_undefined(name)}")
    if any(m != "ambient" and closeness(comparison, m) is None for m in methods):
        reasons.append("a method is measured against <code>ambient</code> only where both have an rmse above 0")
    return f'<p class="quiet">{DASH} means no value: {"; ".join(reasons)}.</p>' if reasons else ""


# --------------------------------------------------------------------------------------------------------- probes


def _probes(timeline: Timeline) -> str:
    if not timeline.probe_names:
        return "<p>No probe was in view in any frame.</p>"
    head = [
        "probe", "position x, y, z (m)", "frames in view", "coverage, mean", "coverage, last", "estimates made",
        "SHC RMSE, mean", "payload",
    ]  # fmt: skip
    rows = [_probe_row(timeline, index, name) for index, name in enumerate(timeline.probe_names)]
    details = "".join(_coefficients(timeline, name) for name in timeline.probe_names)
    return table(head, rows, "stacking probes") + details


def _probe_row(timeline: Timeline, index: int, name: str) -> list[str]:
    seen = [probe for frame in timeline.frames if (probe := probe_in(frame, name))]
    coverages = finite_only(probe.get("coverage") for probe in seen)
    reasons = [format_trigger(reason_of(probe)) for probe in seen if probe.get("fired")]
    by_reason = ", ".join(f"{reasons.count(reason)} {reason}" for reason in dict.fromkeys(reasons))
    return [
        f'<b class="key">{index + 1}</b> {escape(name)}',
        _position(seen[-1]),
        str(len(seen)),
        format_percent(mean(coverages)),
        format_percent(coverages[-1] if coverages else None),
        f'{len(reasons)}<span class="way">{by_reason}</span>',
        format_number(mean(probe.get("shc_rmse") for probe in seen)),
        format_bytes(sum(finite_only(probe.get("payload_bytes") for probe in seen))),
    ]


def _position(probe: Mapping[str, Any]) -> str:
    values = [finite(value) for value in items(probe, "position_m")]
    return ", ".join(DASH if value is None else f"{value:.2f}".replace("-", MINUS) for value in values) or DASH


def _coefficients(timeline: Timeline, name: str) -> str:
    """The coefficients of the last frame that has the probe, beside those of the rendered one."""
    last = next(probe for frame in reversed(timeline.frames) if (probe := probe_in(frame, name)))
    rows = [
        [
            f"l = {degree}, m = {order}".replace("-", MINUS),
            *(
                _coefficient(last, key, degree * degree + degree + order, rgb)
                for key in ("sh", "sh_truth")
                for rgb in range(3)
            ),
        ]
        for degree in range(3)
        for order in range(-degree, degree + 1)
    ]
    head = ["", *(f"{what} {rgb}" for what in ("estimate", "truth") for rgb in ("R", "G", "B"))]
    summary = f"Last spherical harmonics of {escape(name)}: radiance, real orthonormal basis, at the session's exposure"
    return f"<details><summary>{summary}</summary>{table(head, rows, 'coefficients')}</details>"


def _coefficient(probe: Mapping[str, Any], key: str, index: int, rgb: int) -> str:
    triples = items(probe, key)
    triple = triples[index] if index < len(triples) and isinstance(triples[index], list | tuple) else ()
    value = finite(triple[rgb]) if rgb < len(triple) else None
    return DASH if value is None else f"{value:.4f}".replace("-", MINUS)


# ------------------------------------------------------------------------------------------------- how it was made


def _effects(results: Mapping[str, Any]) -> str:
    rows = [
        [
            code(effect.get("name")),
            f'<span class="state">{escape(effect.get("state") or DASH)}</span>',
            escape(effect.get("reason") or DASH),
            _set_to(effect),
        ]
        for effect in items(results, "effects")
    ]
    return table(["effect", "state", "why", "set to"], rows, "words") if rows else ""


def _set_to(effect: Mapping[str, Any]) -> str:
    """What an effect was set to: "diffuse_bounces 17", "farthest_m 5"; a dash where nothing sets it."""
    settings = mapping(effect, "parameters").items()
    return ", ".join(code(f"{name} {format_setting(value)}") for name, value in settings) or DASH


def _phone(results: Mapping[str, Any]) -> str:
    rows = phone_rows(results)
    if not rows:
        return format_phone(results)
    caption = (
        "Mean SHC RMSE over probes and frames of the light in force. Each row runs the whole session again from the "
        "recorded captures, with that effect left out; triggers may then fire in other frames, so small differences "
        "are chance."
    )
    head = ["effect", "SHC RMSE, all on", "without it", "it adds"]
    return f'{format_phone(results)}{table(head, rows)}<p class="quiet">{caption}</p>'


def phone_rows(results: Mapping[str, Any]) -> list[list[str]]:
    """HTML cells of each effect that is on: its name, the error with all that are on, without it, what it costs."""
    measured = mapping(mapping(results, "phone"), "shc_rmse")
    all_on = finite(measured.get("all_on"))
    without = {name: finite(error) for name, error in mapping(measured, "without").items()}
    rows = [[code(name), _error(all_on), _error(error), _change(all_on, error)] for name, error in without.items()]
    if rows:
        perfect = finite(measured.get("perfect"))
        rows.append(["all of them", _error(all_on), _error(perfect), _change(all_on, perfect)])
    return rows


def _change(with_it: float | None, without_it: float | None) -> str:
    """What an effect adds to the error: "+0.0120 (8.1 % more)", or "nothing"."""
    if with_it is None or without_it is None:
        return DASH
    added = with_it - without_it
    if abs(added) < 0.00005:
        return "nothing"
    sign, word = (MINUS, "less") if added < 0 else ("+", "more")
    share = f" ({format_percent(abs(added) / without_it)} {word})" if without_it else ""
    return f"{sign}{_error(abs(added))}{share}"


def _error(value: float | None) -> str:
    """All with the same decimals, so that they can be compared down a column."""
    return DASH if value is None else f"{value:.4f}"


def format_phone(results: Mapping[str, Any]) -> str:
    """Which phone it was and how its estimates travelled, as a paragraph; empty for older results."""
    name = mapping(results, "phone").get("name")
    about = mapping(results, "phone").get("summary") or DASH
    sentences = [f"{escape(name)}: {escape(about)}."] if name else []
    network, summary = mapping(results, "settings").get("network"), mapping(results, "summary")
    n_lost = finite(summary.get("n_lost"))
    if network is not None and n_lost is not None:
        latency = format_quantity(finite(summary.get("mean_latency_ms")), "ms")
        lost = {0: "none was lost", 1: "1 was lost"}.get(round(n_lost), f"{n_lost:.0f} were lost")
        sentences.append(f"Over {code(network)} an estimate took {latency} on average; {lost}.")
    return f"<p>{' '.join(sentences)}</p>" if sentences else ""


def _invalid(results: Mapping[str, Any]) -> str:
    rows, otherwise = invalid_rows(results), invalid_otherwise(results)
    return (table(INVALID_HEAD, rows, "words") if rows else "") + (f"<p>{otherwise}</p>" if otherwise else "")


def _notes(results: Mapping[str, Any]) -> str:
    notes = "".join(f"<li>{_with_code(escape(note))}</li>" for note in items(results, "notes"))
    return f"<ul>{notes}</ul>" if notes else ""


def _with_code(words: str) -> str:
    """Escaped words, with what stands between backticks set as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", words)


def command_line(results: Mapping[str, Any]) -> str:
    """The command that made the results, as it would be typed; empty where it is not recorded."""
    command = mapping(results, "software").get("command")
    return shlex.join(map(str, command)) if isinstance(command, list | tuple) else str(command or "")


def _command(results: Mapping[str, Any]) -> str:
    command = command_line(results)
    if not command:
        return "<p>Not recorded.</p>"
    return f'<pre id="command">{escape(command)}</pre><button type="button" id="copy" hidden>Copy the command</button>'


def _facts(results: Mapping[str, Any]) -> str:
    software = {key: value for key, value in mapping(results, "software").items() if key != "command"}
    groups = {key: mapping(results, key) for key in ("settings", "scene", "summary", "machine")} | {
        "software": software
    }
    order = ("settings", "scene", "summary", "software", "machine")
    blocks = [block(name.capitalize(), _fact_table(groups[name])) for name in order if groups[name]]
    return f'<div class="facts">{"".join(blocks)}</div>'


def _fact_table(facts: Mapping[str, Any]) -> str:
    rows = "".join(
        f'<tr><th scope="row">{escape(name).replace(".", ".<wbr>")}</th><td>{value}</td></tr>'
        for name, value in _flat(facts)
    )
    return f'<table class="pairs"><tbody>{rows}</tbody></table>'


def _flat(facts: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Names and values, those of an inner object as "outer.inner"."""
    pairs: list[tuple[str, str]] = []
    for key, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", _fact(key, value)))
    return pairs


def _fact(key: str, value: Any) -> str:
    if value is None:
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    if key == "frames" and isinstance(value, list) and all(isinstance(v, int) for v in value):
        return f"{format_runs(value)} ({len(value)})"
    if key == "size" and isinstance(value, list | tuple):
        return " x ".join(_fact("", length) for length in value)
    if isinstance(value, list | tuple):
        return ", ".join(_fact("", inner) for inner in value) or "none"
    return escape(f"{value:.6g}" if isinstance(value, float) else value)
