"""Tables of the numbers behind the pictures, and of what made them.

Tables hold what results.json holds: a number in the comparison keeps its full value in a `data` element, None is a dash
with its reason below the table. `truth` is no competitor, since no phone has it, so the best is marked among the other
methods.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence

from xihe_blender.io.json_records import Json, as_json
from xihe_blender.io.run_results import EffectResult, Metrics, PhoneResult, ProbeResult, RunResults
from xihe_blender.report.document import block, table
from xihe_blender.report.invalid import HEAD as INVALID_HEAD
from xihe_blender.report.invalid import format_undefined, invalid_otherwise, invalid_rows
from xihe_blender.report.pictures import method_meaning
from xihe_blender.report.timeline import Timeline, format_trigger
from xihe_blender.report.values import closeness, code, escape, format_closeness, mean
from xihenet.formats import (
    DASH,
    MINUS,
    format_bytes,
    format_list,
    format_number,
    format_percent,
    format_position,
    format_quantity,
    format_runs,
    format_setting,
)

# name, direction that is better, unit
METRICS = (
    ("psnr", "up", " (dB)"),
    ("ssim", "up", ""),
    ("rmse", "down", ""),
    ("si_rmse", "down", ""),
    ("angular_deg", "down", ""),
    ("ring_rmse", "down", ""),
)
_BETTER = {"up": "\N{UPWARDS ARROW} higher is better", "down": "\N{DOWNWARDS ARROW} lower is better"}


def numbers_section(results: RunResults) -> str:
    blocks = {
        "Comparison with the ground truth": _comparison(results),
        "Positions": _probes(Timeline.of(results)),
        "Effects": _effects(results.effects),
        "Phone": _phone(results),
        "What was invalid, and why": _invalid(results),
        "Notes": _notes(results.notes),
        "Command": _command(results.software.get("command", "")),
    }
    return "".join(itertools.starmap(block, blocks.items())) + _facts(results)


# ----------------------------------------------------------------------------------------------------- comparison


def _comparison(results: RunResults) -> str:
    comparison = results.comparison
    if not comparison:
        return "<p>No frame was compared with the ground truth.</p>"
    methods = sorted(comparison, key=lambda m: (m == "truth", m == "ambient"))
    columns = [_metric_column(comparison, methods, name, way) for name, way, _ in METRICS]
    lights, chosen = results.light_errors, results.settings.estimator
    rows = [
        [
            _method_name(chosen, m),
            *(column[i] for column in columns),
            _closer_cell(comparison, m),
            format_number(lights.get(m)),
            format_quantity(results.summary.estimate_ms.get(m), "ms"),
        ]
        for i, m in enumerate(methods)
    ]
    heads = [f'{name}{unit}<span class="way">{_BETTER[way]}</span>' for name, way, unit in METRICS]
    light_head = f'SHC RMSE<span class="way">{_BETTER["down"]}</span>'
    head = ["method", *heads, "rmse against <code>ambient</code>", light_head, "time of an estimate"]
    about = (
        "Averages over the compared frames, inside the virtual objects. psnr and ssim are taken on the sRGB pictures,"
        " the others on linear colour. SHC RMSE is the error of the light's coefficients, over all frames. The time"
        " is the median of the run; a dash stands where nothing is estimated."
    )
    star = "\N{BLACK STAR} marks the best method that a phone could run; <code>truth</code> is not one."
    honest = "No image metric tracks human preference: look at the pictures before you trust a ranking."
    notes = f'<p class="quiet">{star} {honest}</p>{_null_reasons(comparison, methods)}'
    return f"<p>{about}</p>{table(head, rows, 'stacking comparison')}{notes}"


def _method_name(estimator: str, method: str) -> str:
    tag = " (chosen)" if method == estimator else ""
    return f'{code(method)}{tag}<span class="way">{method_meaning(method)}</span>'


def _metric_column(comparison: Mapping[str, Metrics], methods: Sequence[str], name: str, way: str) -> list[str]:
    values: dict[str, float | None] = {method: getattr(comparison[method], name) for method in methods}
    rivals = [value for method, value in values.items() if value is not None and method != "truth"]
    best = (max if way == "up" else min)(rivals) if len(rivals) > 1 else None
    # Enough for three digits of the smallest.
    smallest = min((abs(value) for value in values.values() if value), default=1.0)
    decimals = min(8, max(2, 2 - math.floor(math.log10(smallest))))
    cells = []
    for method, value in values.items():
        shown = DASH if value is None else f'<data value="{value!r}">{value:,.{decimals}f}</data>'
        is_best = value is not None and value == best and method != "truth"
        cells.append(f'<strong class="best">\N{BLACK STAR} {shown}</strong>' if is_best else shown)
    return cells


def _closer_cell(comparison: Mapping[str, Metrics], method: str) -> str:
    if method == "ambient":
        return "the baseline"
    closer = closeness(comparison, method)
    return DASH if closer is None else format_closeness(closer)


def _null_reasons(comparison: Mapping[str, Metrics], methods: Sequence[str]) -> str:
    reasons = []
    for name, _, _ in METRICS:
        empty = [code(m) for m in methods if getattr(comparison[m], name) is None]
        if empty:
            reasons.append(f"{name} of {format_list(empty)} {format_undefined(name)}")
    if any(m != "ambient" and closeness(comparison, m) is None for m in methods):
        reasons.append("a method is compared with <code>ambient</code> only where both have an rmse above 0")
    return f'<p class="quiet">{DASH} means no value: {"; ".join(reasons)}.</p>' if reasons else ""


# --------------------------------------------------------------------------------------------------------- probes


def _probes(timeline: Timeline) -> str:
    if not timeline.probe_names:
        return "<p>No position was in view in any frame.</p>"
    head = [
        "position", "x, y, z (m)", "frames in view", "coverage, mean", "coverage, last", "estimates made",
        "SHC RMSE, mean", "payload",
    ]  # fmt: skip
    seen = {name: [probe for probe in timeline.probes if probe.name == name] for name in timeline.probe_names}
    rows = [_probe_row(index, name, of_one) for index, (name, of_one) in enumerate(seen.items())]
    details = "".join(_coefficients(name, of_one[-1]) for name, of_one in seen.items())
    return table(head, rows, "stacking probes") + details


def _probe_row(index: int, name: str, seen: Sequence[ProbeResult]) -> list[str]:
    reasons = [format_trigger(probe.reason) for probe in seen if probe.fired]
    place = format_position(seen[-1].position_m)
    by_reason = ", ".join(f"{reasons.count(reason)} {reason}" for reason in dict.fromkeys(reasons))
    return [
        f'<b class="key">{index + 1}</b> {escape(name)}',
        place if len({probe.position_m for probe in seen}) == 1 else f"moves to {place}",
        str(len(seen)),
        format_percent(mean(probe.coverage for probe in seen)),
        format_percent(seen[-1].coverage),
        f'{len(reasons)}<span class="way">{by_reason}</span>',
        format_number(mean(probe.shc_rmse for probe in seen)),
        format_bytes(sum(probe.payload_bytes for probe in seen)),
    ]


def _coefficients(name: str, last: ProbeResult) -> str:
    """The coefficients of the last frame that has the probe, beside those of the rendered one."""
    bands = [(degree, order) for degree in range(3) for order in range(-degree, degree + 1)]
    rows = [
        [f"l = {degree}, m = {order}", *(f"{value:.4f}" for value in estimate + truth)]
        for (degree, order), estimate, truth in zip(bands, last.sh, last.sh_truth or [()] * len(bands), strict=True)
    ]
    rows = [[cell.replace("-", MINUS) for cell in row] for row in rows]
    shown = ("estimate", "truth") if last.sh_truth else ("estimate",)
    head = ["", *(f"{what} {rgb}" for what in shown for rgb in ("R", "G", "B"))]
    summary = f"Last spherical harmonics of {escape(name)}: radiance, real orthonormal basis, at the session's exposure"
    return f"<details><summary>{summary}</summary>{table(head, rows, 'coefficients')}</details>"


# ------------------------------------------------------------------------------------------------- how it was made


def _effects(effects: Sequence[EffectResult]) -> str:
    rows = []
    for effect in effects:
        settings = as_json(effect.parameters).items()
        set_to = ", ".join(code(f"{name} {format_setting(value)}") for name, value in settings) or DASH
        state = f'<span class="state">{effect.state}</span>'
        rows.append([code(effect.name), state, escape(effect.reason), set_to])
    return table(["effect", "state", "why", "set to"], rows, "words") if rows else ""


def _phone(results: RunResults) -> str:
    rows = phone_rows(results.phone)
    if not rows:
        return format_phone(results)
    caption = (
        "Mean SHC RMSE over positions and frames of the light in use. Each row runs the whole session again from the "
        "recorded captures, with that effect left out; triggers may then fire in other frames, so small differences "
        "mean nothing."
    )
    head = ["effect", "SHC RMSE, all on", "without it", "it adds"]
    return f'{format_phone(results)}{table(head, rows)}<p class="quiet">{caption}</p>'


def phone_rows(phone: PhoneResult) -> list[list[str]]:
    """HTML cells of each effect that is on: its name, the error with all that are on, without it, what it costs."""
    if phone.shc_rmse is None:
        return []
    all_on, perfect = phone.shc_rmse.all_on, phone.shc_rmse.perfect
    without = {code(name): error for name, error in phone.shc_rmse.without.items()} | {"all of them": perfect}
    return [[what, _error(all_on), _error(error), _change(all_on, error)] for what, error in without.items()]


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


def format_phone(results: RunResults) -> str:
    """Which phone it was and how its estimates travelled, as a paragraph."""
    network, n_lost = results.network_in_use, results.summary.n_lost
    words = f"{escape(results.phone.name)}: {escape(results.phone.summary)}."
    if network is not None:
        latency = format_quantity(results.summary.mean_latency_ms, "ms")
        lost = {0: "none was lost", 1: "1 was lost"}.get(n_lost, f"{n_lost} were lost")
        words += f" Over {code(network)} an estimate took {latency} on average; {lost}."
    return f"<p>{words}</p>"


def _invalid(results: RunResults) -> str:
    rows, otherwise = invalid_rows(results), invalid_otherwise(results.summary.invalid)
    return (table(INVALID_HEAD, rows, "words") if rows else "") + (f"<p>{otherwise}</p>" if otherwise else "")


def _notes(notes: Sequence[str]) -> str:
    """A list, with what stands between backticks set as code."""
    with_code = (re.sub("`([^`]+)`", r"<code>\1</code>", escape(note)) for note in notes)
    return f"<ul>{''.join(f'<li>{note}</li>' for note in with_code)}</ul>" if notes else ""


def _command(command: str) -> str:
    if not command:
        return "<p>Not recorded.</p>"
    if not command.startswith("xihe "):
        # Where the run was started, such as Blender's panel, which is nothing to type.
        return f"<p>{escape(command)}</p>"
    return f'<pre id="command">{escape(command)}</pre><button type="button" id="copy" hidden>Copy the command</button>'


def _facts(results: RunResults) -> str:
    groups = {name: as_json(getattr(results, name)) for name in ("settings", "scene", "summary", "software", "machine")}
    groups["software"].pop("command", None)
    blocks = ""
    for group, facts in groups.items():
        names = [(escape(name).replace(".", ".<wbr>"), value) for name, value in _flat(facts)]
        rows = "".join(f'<tr><th scope="row">{name}</th><td>{value}</td></tr>' for name, value in names)
        blocks += block(group.capitalize(), rows and f'<table class="pairs"><tbody>{rows}</tbody></table>')
    return f'<div class="facts">{blocks}</div>'


def _flat(facts: Json, prefix: str = "") -> list[tuple[str, str]]:
    """Names and values, those of an inner object as "outer.inner"."""
    pairs: list[tuple[str, str]] = []
    for key, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", _fact(key, value)))
    return pairs


def _fact(key: str, value: Json) -> str:
    if value is None:
        return DASH
    if isinstance(value, bool):
        return "yes" if value else "no"
    if key == "frames":
        return f"{format_runs(value)} ({len(value)})"
    if key == "size":
        return " x ".join(map(str, value))
    if isinstance(value, list):
        return ", ".join(_fact("", inner) for inner in value) or "none"
    return escape(f"{value:.6g}" if isinstance(value, float) else value)
