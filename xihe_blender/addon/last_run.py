"""What does the panel tell of the last run? A few numbers out of its results.json, read once per file.

Panels are drawn many times a second, a results.json holds thousands of numbers. So the numbers that are shown are kept
by folder and time of change, and a draw costs one look at the file's date. Rejected: copies of the numbers as
properties of the scene, which would still be there when the run's folder is gone.

Nothing heavy is imported: this is read while the window draws.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from xihe_blender.errors import UserError

if TYPE_CHECKING:
    from xihe_blender.io.run_results import RunResults


@dataclass(frozen=True)
class LastRun:
    """The numbers of one finished run that the panel shows; None where a run has none.

    Parameters
    ----------
    estimator : its name
    n_frames, n_estimates : frames of the path, and estimates that triggers asked for
    shc_rmse, ambient_shc_rmse : mean error of the coefficients, and that of the phone's ambient light
    coverage : mean share of the sphere that was seen
    step_ms : mean time of the chain per frame, without rendering
    render_s : time that rendering took, comparisons included
    n_invalid_points : points that were left out, as every position counts them
    n_unknown_lights : how often the light at a position could not be known, so that the last one stayed
    coverage_by_position : share of the sphere that was seen, at the end of the run, by name of the estimation position
    """

    estimator: str
    n_frames: int
    n_estimates: int
    shc_rmse: float | None
    ambient_shc_rmse: float | None
    coverage: float | None
    step_ms: float | None
    render_s: float
    n_invalid_points: int
    n_unknown_lights: int
    coverage_by_position: Mapping[str, float]


def last_run(folder: str) -> LastRun | None:
    """The run in `folder`, as a scene remembers it; None without one, or where its results are gone or unreadable."""
    if not folder:
        return None
    path = Path(bpy.path.abspath(folder))
    try:
        return _read(path, path.joinpath("results.json").stat().st_mtime_ns)
    except OSError:
        return None


@functools.lru_cache(maxsize=4)
def _read(folder: Path, _changed: int) -> LastRun | None:
    from xihe_blender.io.run_results import read_results

    try:
        return _picked(read_results(folder))
    except UserError:
        return None


def _picked(content: RunResults) -> LastRun:
    summary = content.summary
    return LastRun(
        estimator=content.settings.estimator,
        n_frames=summary.n_frames,
        n_estimates=summary.n_estimates,
        shc_rmse=summary.mean_shc_rmse,
        ambient_shc_rmse=summary.ambient_shc_rmse,
        coverage=summary.mean_coverage,
        step_ms=summary.mean_step_ms,
        render_s=summary.render_s + summary.comparison_render_s,
        n_invalid_points=summary.n_invalid_points,
        n_unknown_lights=summary.n_unknown_lights,
        coverage_by_position={probe.name: probe.coverage for probe in content.probes},
    )
