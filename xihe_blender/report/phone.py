"""What did the phone's flaws and its network do to the estimated light? One table, one sentence.

Both come from results.json alone. A run with a perfect phone and no network has neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xihe_blender.report.values import DASH, MINUS, code, escape, finite, mapping, percent, with_unit


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
    share = f" ({percent(abs(added) / without_it)} {word})" if without_it else ""
    return f"{sign}{_error(abs(added))}{share}"


def _error(value: float | None) -> str:
    """All with the same decimals, so that they can be compared down a column."""
    return DASH if value is None else f"{value:.4f}"


def phone_in_words(results: Mapping[str, Any]) -> str:
    """Which phone it was and how its estimates travelled, as a paragraph; empty for older results."""
    name = mapping(results, "phone").get("name")
    about = mapping(results, "phone").get("summary") or DASH
    sentences = [f"{escape(name)}: {escape(about)}."] if name else []
    network, summary = mapping(results, "settings").get("network"), mapping(results, "summary")
    n_lost = finite(summary.get("n_lost"))
    if network is not None and n_lost is not None:
        latency = with_unit(finite(summary.get("mean_latency_ms")), "ms")
        lost = {0: "none was lost", 1: "1 was lost"}.get(round(n_lost), f"{n_lost:.0f} were lost")
        sentences.append(f"Over {code(network)} an estimate took {latency} on average; {lost}.")
    return f"<p>{' '.join(sentences)}</p>" if sentences else ""


def phone_caption() -> str:
    """What the numbers of the table are."""
    return (
        '<p class="quiet">Mean SHC RMSE over probes and frames of the light in force. Each row runs the whole session '
        "again from the recorded captures, with that effect left out; triggers may then fire in other frames, so small "
        "differences are chance.</p>"
    )
