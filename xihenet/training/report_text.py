"""Markdown of a report, for the README and the model card.

Errors of coefficients are ratios to the mean predictor's; a figure of several seeds has its standard deviation behind
a plus-minus sign. Nothing is worked out here but the number of digits.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from xihenet.light_picture import SPHERES


def report_markdown(report: Mapping[str, Any]) -> str:
    """A report as text, one section for each part that has figures."""
    head = report["head"]
    lines = [
        f"# Estimators on the {head['split']} rooms, {head['target']}",
        "",
        f"Split: {head['split']}, target: {head['target']}. The mean predictor, whose error divides the others', "
        f"and the fits come from {head['n_clouds_fitted']} clouds of {head['n_rooms_fitted']} training rooms. "
        "± is the standard deviation over seeds.",
        "",
    ]
    for table in report["tables"]:
        lines += _table_section(table, head)
    lines += _learning_section(report["learning"])
    lines += _calibration_section(report["calibration"], head)
    lines += _room_section(report["rooms"])
    lines += _stress_section(report["stress"], head)
    return "\n".join(lines).rstrip() + "\n"


def _table_section(table: Mapping[str, Any], head: Mapping[str, Any]) -> list[str]:
    seen = table["coverage"]
    title = f"## {table['name'][:1].upper()}{table['name'][1:]}: {table['n_clouds']} clouds, {table['n_rooms']} rooms"
    if not table["n_clouds"]:
        return [title, "", "No such clouds.", ""]
    coverage = f"Coverage, 5th/50th/95th percentile: {seen['p5']:.0%}/{seen['p50']:.0%}/{seen['p95']:.0%}."
    left_out = table["rows"][0]["figures"]["dominant"]["n_left_out"]
    angle = (
        f"The angle of the dominant light is the median over the clouds whose l = 1 vector of luminance is longer than "
        f"{head['dominant_share']} of l = 0: {left_out} are left out."
    )
    ratios = ["SHC RMSE / mean predictor's", "all", "l = 0", "l = 1", "l = 2", *_format_groups(table, head)]
    others = ["predictor", "SHC RMSE", "irradiance", "mean, %", "dominant, °"]
    others += [f"{sphere}: {error}" for sphere in SPHERES for error in ("RMSE", "si-RMSE", "angle, °")]
    return [title, "", coverage, "", *_table(ratios, [_ratio_row(row) for row in table["rows"]]), "",
            *_table(others, [_error_row(row) for row in table["rows"]]), "", angle, ""]  # fmt: skip


def _format_groups(table: Mapping[str, Any], head: Mapping[str, Any]) -> list[str]:
    edges = itertools.pairwise(head["coverage_edges"])
    return [f"{a:.0%} to {b:.0%} seen ({n})" for (a, b), n in zip(edges, table["n_in_coverage"], strict=True)]


def _ratio_row(row: Mapping[str, Any]) -> list[str]:
    mean, spread = row["figures"], row["spread"]
    cells = [_cell(mean["ratio"], spread["ratio"])]
    for part in ("ratio_by_band", "ratio_by_coverage"):
        cells += [_cell(a, b) for a, b in zip(mean[part], spread[part], strict=True)]
    return [row["name"], *cells]


def _error_row(row: Mapping[str, Any]) -> list[str]:
    mean, spread = row["figures"], row["spread"]
    cells = [_cell(mean["rmse"], spread["rmse"], 4), _cell(mean["irradiance"], spread["irradiance"])]
    cells.append(_cell(mean["irradiance_percent"], spread["irradiance_percent"], 1))
    cells.append(_cell(mean["dominant"]["median_deg"], spread["dominant"]["median_deg"], 1))
    for sphere in SPHERES:
        for error, digits in (("rmse", 3), ("si_rmse", 3), ("angular_deg", 2)):
            cells.append(_cell(mean["spheres"][sphere][error], spread["spheres"][sphere][error], digits))
    return [row["name"], *cells]


def _learning_section(learning: Sequence[Mapping[str, Any]]) -> list[str]:
    if not learning:
        return []
    groups = [name for name, value in learning[0].items() if isinstance(value, dict)]
    rows = [
        [str(point["n_rooms"]), str(point["n_seeds"]), *(_cell(*point[group].values()) for group in groups)]
        for point in learning
    ]
    return ["## Number of training rooms", "", *_table(["rooms", "seeds", *groups], rows), ""]


def _calibration_section(calibration: Sequence[Mapping[str, Any]], head: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    promised = [f"promised {share:.0%}" for share in head["shares_promised"]]
    for row in calibration:
        figures = row["figures"]
        parts = {"one view and all views": figures["all"], **figures["groups"], **figures["tables"]}
        rows = [
            [name, str(part["n_clouds"]), _cell(part["expected"], None, 4), _cell(part["made"], None, 4)]
            + ["" if kept is None else f"{kept:.0%}" for kept in part["kept"]]
            for name, part in parts.items()
        ]
        law = ", ".join(_law(one) for one in row["by_seed"])
        words = f"Expected error from the validation rooms: {law}. Correlation with the error made: "
        lines += [
            f"## Does {row['name']} know its error?",
            "",
            words + f"{_cell(figures['correlation'], None, 2)}.",
            "",
        ]
        lines += [*_table(["clouds", "number", "expected", "made", *promised], rows), ""]
    return lines


def _law(of_seed: Mapping[str, Any]) -> str:
    return f"{of_seed['factor']:.3g} x raw^{of_seed['power']:.3g} x exp({of_seed['slope']:.3g} x coverage)"


def _room_section(rooms: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rooms or not rooms[0]["worst_rooms"]:
        return []
    share = f"{rooms[0]['worst_share']:.0%}"
    names = [f"worst {share} of clouds", f"worst {share} of rooms", "worst rooms (share of squared error)"]
    table = [
        [
            row["name"],
            _percent(row["of_worst_clouds"]),
            _percent(row["of_worst_rooms"]),
            ", ".join(f"{one['room']} ({_percent(one['share'])})" for one in row["worst_rooms"]),
        ]
        for row in rooms
    ]
    return ["## Where the squared error lies, one view", "", *_table(["predictor", *names], table), ""]


def _stress_section(stress: Sequence[Mapping[str, Any]], head: Mapping[str, Any]) -> list[str]:
    if not stress:
        return []
    names = [row["name"] for row in stress[0]["rows"]]
    lines = []
    for group in stress:
        known = {row["name"]: row for row in group["rows"]}
        seen = _percent(group["coverage"])
        cells = [_stress_cell(known[name]) if name in known else "" for name in names]
        lines.append([group["name"], str(group["n_anchors"]), str(group["n_clouds"]), seen, *cells])
    about = (
        f"SHC RMSE / `ambient`'s on the same clouds of one view. At most {head['stress_limit']:.2f} is asked for; what "
        "is above, or is not finite, is marked with an exclamation mark."
    )
    return ["## Under disturbances", "", about, "", *_table(["clouds", "anchors", "number", "seen", *names], lines), ""]


def _stress_cell(row: Mapping[str, Any]) -> str:
    figure = _cell(row["ratio"], row.get("spread")) if row["is_finite"] else "not finite"
    return figure if row["is_within"] else f"{figure} !"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    head = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
    return head + [f"| {' | '.join(row)} |" for row in rows]


def _cell(value: float | None, spread: float | None, digits: int = 3) -> str:
    if value is None:
        return ""
    return f"{value:.{digits}f}" + ("" if spread is None else f" ± {spread:.{digits}f}")


def _percent(share: float | None) -> str:
    return "" if share is None else f"{share:.0%}"
