"""Markdown of a report, for the README and the model card.

Errors of coefficients are ratios to the mean predictor's; a figure of several seeds has its standard deviation behind
a plus-minus sign. Nothing is worked out here but the number of digits.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from xihenet.light.light_picture import SPHERES
from xihenet.training.calibration import CalibrationRow
from xihenet.training.report import Figures, LearningPoint, Report, ReportHead, RoomFigures, Table, TableRow
from xihenet.training.stress import StressGroup, StressRow


def report_markdown(report: Report) -> str:
    """A report as text, one section for each part that has figures."""
    head = report.head
    about = (
        f"Split: {head.split}, target: {head.target}. The mean predictor, whose error divides the others', "
        f"and the fits come from {head.n_clouds_fitted} clouds of {head.n_rooms_fitted} training rooms. "
        "± is the standard deviation over seeds."
    )
    lines = [f"# Estimators on the {head.split} rooms, {head.target}", "", about, ""]
    for table in report.tables:
        lines += _table_section(table, head)
    lines += _learning_section(report.learning)
    for row in report.calibration:
        lines += _calibration_section(row, head)
    lines += _room_section(report.rooms)
    lines += _stress_section(report.stress, head)
    return "\n".join(lines).rstrip() + "\n"


def _table_section(table: Table, head: ReportHead) -> list[str]:
    of_rooms = "one room" if table.n_rooms == 1 else f"{table.n_rooms} rooms"
    title = f"## {table.name[:1].upper()}{table.name[1:]}: {table.n_clouds} clouds, {of_rooms}"
    if not table.n_clouds:
        return [title, "", "No such clouds.", ""]
    seen = "/".join(map(_percent, table.coverage.values()))
    edges = zip(itertools.pairwise(head.coverage_edges), table.n_in_coverage, strict=True)
    groups = [f"{a:.0%} to {b:.0%} seen ({n})" for (a, b), n in edges]
    ratios = ["SHC RMSE / mean predictor's", "all", "l = 0", "l = 1", "l = 2", *groups]
    others = ["predictor", "SHC RMSE", "irradiance", "mean, %", "dominant, °"]
    others += [f"{sphere}: {error}" for sphere in SPHERES for error in ("RMSE", "si-RMSE", "angle, °")]
    angle = (
        f"The angle of the dominant light is the median over the clouds whose l = 1 vector of luminance is longer than "
        f"{head.dominant_share} of l = 0: {table.rows[0].figures.dominant.n_left_out} are left out."
    )
    return [title, "", f"Coverage, 5th/50th/95th percentile: {seen}.", "",
            *_table(ratios, [_ratio_row(row) for row in table.rows]), "",
            *_table(others, [_error_row(row) for row in table.rows]), "", angle, ""]  # fmt: skip


def _ratio_row(row: TableRow) -> list[str]:
    mean, spread = row.figures, row.spread
    by_part = map(_cell, mean.ratio_by_band + mean.ratio_by_coverage, spread.ratio_by_band + spread.ratio_by_coverage)
    return [row.name, _cell(mean.ratio, spread.ratio), *by_part]


def _error_row(row: TableRow) -> list[str]:
    digits = [4, 3, 1, 1, *[3, 3, 2] * len(SPHERES)]
    return [row.name, *map(_cell, _errors(row.figures), _errors(row.spread), digits)]


def _errors(figures: Figures) -> list[float | None]:
    """In the order of the columns."""
    errors = [figures.rmse, figures.irradiance, figures.irradiance_percent, figures.dominant.median_deg]
    for sphere in SPHERES:
        own = figures.spheres[sphere]
        errors += [own.rmse, own.si_rmse, own.angular_deg]
    return errors


def _learning_section(learning: Sequence[LearningPoint]) -> list[str]:
    if not learning:
        return []
    rows = [[str(one.n_rooms), str(one.n_seeds), *(_cell(*ratio) for ratio in one.groups.values())] for one in learning]
    return ["## Number of training rooms", "", *_table(["rooms", "seeds", *learning[0].groups], rows), ""]


def _calibration_section(row: CalibrationRow, head: ReportHead) -> list[str]:
    figures = row.figures
    parts = {"one view and all views": figures.all, **figures.groups, **figures.tables}
    rows = [
        [name, str(one.n_clouds), _cell(one.expected, None, 4), _cell(one.made, None, 4), *map(_percent, one.kept)]
        for name, one in parts.items()
    ]
    law = ", ".join(f"{one.factor:.3g} x raw^{one.power:.3g} x exp({one.slope:.3g} x coverage)" for one in row.by_seed)
    words = f"Expected error from the validation rooms: {law}. Correlation with the error made: "
    promised = [f"promised {share:.0%}" for share in head.shares_promised]
    return [f"## Does {row.name} know its error?", "", f"{words}{_cell(figures.correlation, None, 2)}.", "",
            *_table(["clouds", "number", "expected", "made", *promised], rows), ""]  # fmt: skip


def _room_section(rooms: Sequence[RoomFigures]) -> list[str]:
    if not rooms[0].worst_rooms:
        return []
    share = f"{rooms[0].worst_share:.0%}"
    names = [f"worst {share} of clouds", f"worst {share} of rooms", "worst rooms (share of squared error)"]
    table = []
    for row in rooms:
        worst = ", ".join(f"{one.room} ({_percent(one.share)})" for one in row.worst_rooms)
        table.append([row.name, _percent(row.of_worst_clouds), _percent(row.of_worst_rooms), worst])
    return ["## Where the squared error lies, one view", "", *_table(["predictor", *names], table), ""]


def _stress_section(stress: Sequence[StressGroup], head: ReportHead) -> list[str]:
    columns = ["clouds", "anchors", "number", "seen", *(row.name for row in stress[0].rows)]
    table = []
    for group in stress:
        numbers = [str(group.n_anchors), str(group.n_clouds), _percent(group.coverage)]
        table.append([group.name, *numbers, *map(_stress_cell, group.rows)])
    about = (
        f"SHC RMSE / `ambient`'s on the same clouds of one view. At most {head.stress_limit:.2f} is asked for; what "
        "is above, or is not finite, is marked with an exclamation mark."
    )
    return ["## Under disturbances", "", about, "", *_table(columns, table), ""]


def _stress_cell(row: StressRow) -> str:
    figure = _cell(row.ratio, row.spread) if row.is_finite else "not finite"
    return figure if row.is_within else f"{figure} !"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    head = [f"| {' | '.join(columns)} |", "|" + " --- |" * len(columns)]
    return head + [f"| {' | '.join(row)} |" for row in rows]


def _cell(value: float | None, spread: float | None, digits: int = 3) -> str:
    if value is None:
        return ""
    return f"{value:.{digits}f}" + ("" if spread is None else f" ± {spread:.{digits}f}")


def _percent(share: float | None) -> str:
    return "" if share is None else f"{share:.0%}"
