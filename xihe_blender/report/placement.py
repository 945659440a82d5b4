"""The report of a placement map: the room from above and through the camera, and the best and the worst places.

Blue is a place where the light will be right, red one where it will fail, grey one of which nothing is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from xihe_blender.io.placement_results import ENOUGH, N_EXTREMES, RAMP, Place, PlacementResults, error_range
from xihe_blender.report.document import document, png_url, table, write_document
from xihe_blender.report.values import escape
from xihenet.formats import format_count, format_number, format_position


def write_placement_report(path: Path, results: PlacementResults, pictures: Sequence[Path]) -> None:
    """One self-contained page."""
    low, high = error_range(results.places)
    ramp = ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in RAMP)
    legend = (
        f'<p>Expected error (SHC RMSE) {low:.3f} <span style="display: inline-block; width: 12em; height: 0.8em; '
        f'background: linear-gradient(to right, {ramp})"></span> {high:.3f} and more; grey: nothing is known.</p>'
    )
    above, camera = (
        f'<img src="{png_url(file.read_bytes())}" alt="{file.stem}" style="max-width: 100%">' for file in pictures
    )
    rings = f"<p>White rings: the {N_EXTREMES} best places; black: the {N_EXTREMES} worst. The bar is a metre.</p>"
    best = results.best_first
    sections = [
        ("above", "From above", legend + above + rings),
        ("camera", "Through the phone", legend + camera),
        ("best", "The best places", _table(best[:N_EXTREMES])),
        ("worst", "The worst places", _table(best[::-1][:N_EXTREMES])),
        ("right", "How far this is right", _verified(results)),
    ]
    heading = f"Where AR light will fail: {escape(results.scene)}"
    write_document(path, document(heading, _opening(results), sections))


def _opening(results: PlacementResults) -> str:
    errors = [place.expected_error for place in results.best_first if place.expected_error is not None]
    estimator = escape(results.settings["estimator"])
    said = f"Light by <code>{estimator}</code> after {format_count(len(results.frames), 'frame')} of the camera path, "
    said += f"at {format_count(len(results.places), 'place')} {results.spacing_m:.2f} m apart."
    if errors:
        said += f" Half of them have an expected error below {median(errors):.3f}."
    if results.n_unknown:
        said += f" Of {results.n_unknown} nothing is known: they were not in view."
    return f"<p>{said} {' '.join(escape(note) for note in results.notes)}</p>"


def _table(places: Sequence[Place]) -> str:
    head = ["x, y, z (m)", "expected error", "coverage", "irradiance, upwards (RGB, radiance times sr)", "true error"]
    rows = [
        [
            format_position(place.position_m),
            _number(place.expected_error),
            f"{place.coverage:.0%}",
            "unknown" if place.irradiance is None else ", ".join(map(format_number, place.irradiance)),
            _number(place.true_error),
        ]
        for place in places
    ]
    return table(head, rows) if rows else "<p>No place is known.</p>"


def _number(value: float | None) -> str:
    return "not measured" if value is None else f"{value:.3f}"


def _verified(results: PlacementResults) -> str:
    found = results.verified
    if found is None:
        return (
            "<p>No light probe was rendered: <code>--verify N</code> renders some, and tells how right the map is.</p>"
        )
    places = format_count(found.n_places, "place")
    said = f"Light probes were rendered at {places}, chosen evenly over the expected error. "
    if found.rank_correlation is not None:
        said += f"The rank correlation of expected and true error is {format_number(found.rank_correlation, 2)}"
        between = " to ".join(format_number(end, 2) for end in found.interval or ())
        said += f" ({between} with 95 %). " if between else ". "
    if found.n_places < ENOUGH:
        said += f"So few tell little: give <code>--verify</code> {ENOUGH} places or more. "
    if found.mean_error_of_best is not None and found.mean_error_of_worst is not None:
        said += f"The best of them have a true error of {found.mean_error_of_best:.3f} in the mean, "
        said += f"the worst {found.mean_error_of_worst:.3f}."
    return f"<p>{said}</p>"
