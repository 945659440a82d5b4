"""The report of the better path: a sentence for each object, and the room from above with the looks as arrows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from xihe_blender.io.look_results import LookResults, ObjectAdvice
from xihe_blender.report.document import document, png_url, table, write_document
from xihe_blender.report.values import escape
from xihenet.formats import format_count, format_percent

ABOVE = (
    "<p>White: the phone's path. Blue: where light is estimated. An orange arrow starts where the phone should stand "
    "and points where it should look; one that is short points up or down. The bar is a metre.</p>"
)


def write_look_report(path: Path, results: LookResults, above: Path) -> None:
    """One self-contained page."""
    items = "".join(f"<li><strong>{escape(one.name)}</strong>: {escape(one.sentence)}.</li>" for one in results.objects)
    shown = f'<img src="{png_url(above.read_bytes())}" alt="{above.stem}" style="max-width: 100%">'
    sections = [
        ("looks", "Where to look", f"<ul>{items}</ul>"),
        ("above", "From above", ABOVE + shown),
        ("numbers", "In numbers", _table(results.objects)),
        ("right", "How far this is right", _verified(results.objects)),
    ]
    write_document(path, document(f"A better path: {escape(results.scene)}", _opening(results), sections))


def _opening(results: LookResults) -> str:
    said = f"After {format_count(len(results.frames), 'frame')} of the camera path, light by "
    said += f"<code>{escape(results.settings['estimator'])}</code>. Looks were tried on what the path shows; what it "
    said += "does not show is guessed."
    return f"<p>{said} {' '.join(escape(note) for note in results.notes)}</p>"


def _table(objects: Sequence[ObjectAdvice]) -> str:
    head = ["object", "frame", "look", "turn", "in all", "directions seen", "expected error"]
    rows = []
    for one in objects:
        look = one.look
        what = ["", "nothing", "", ""] if look is None else [
            str(look.frame), escape(look.words), f"{look.turn_deg:.0f}°", f"{look.whole_s:.1f} s"
        ]  # fmt: skip
        seen = f"{format_percent(one.coverage)} to {format_percent(one.predicted_coverage)}"
        errors = f"{_number(one.expected_error)} to {_number(one.predicted_error)}"
        rows.append([escape(one.name), *what, seen, errors])
    return table(head, rows)


def _verified(objects: Sequence[ObjectAdvice]) -> str:
    known = [(one, one.true_errors) for one in objects if one.true_errors is not None]
    if not known:
        return "<p>Nothing was rendered to find out: <code>--verify</code> renders the looks and light probes.</p>"
    head = ["object", "true error before", "after", "lowered by", "after a random look", "lowered by"]
    rows = [
        [
            escape(one.name),
            _number(true.before),
            _number(true.after),
            format_percent(true.lowered),
            ", ".join(map(_number, true.random_after)) or "not tried",
            format_percent(true.lowered_by_random),
        ]
        for one, true in known
    ]
    return "<p>The looks and a light probe at each object were rendered. Errors are SHC RMSE.</p>" + table(head, rows)


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"
