"""What is said of one trial, and how do all of them become tables?

Nothing in the tables tells the time or the machine: the same batch gives the same bytes, whoever computes it. What it
cost stands with the units, in results.json and units.csv.
"""

from __future__ import annotations

import csv
import io
import statistics
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xihe_blender.io.outputs import written_whole

if TYPE_CHECKING:
    from xihe_blender.io.run_results import FrameResult
    from xihe_blender.previs.prepare import PreparedRun
    from xihe_blender.previs.run_chain import WalkedPath

METRICS = ("psnr", "ssim", "rmse", "si_rmse", "angular_deg")


def trial_record(
    run: PreparedRun,
    walked: WalkedPath,
    compared: Mapping[int, Mapping[str, float | None]],
    at_thetas: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """One trial: its means, its frames, and what a more or less eager trigger would have done.

    Means are over positions and frames, of image metrics over compared frames; None without any.
    """
    active = [entry for entry in walked.frames if entry.active]
    probes = [probe for entry in active for probe in entry.probes]
    n_fired = sum(probe.fired for probe in probes)
    frames = [_frame_row(entry, compared.get(entry.frame, {})) for entry in active]
    return {
        "phone": run.settings.phone,
        "estimator": run.settings.estimator,
        "n_frames": len(walked.frames),
        "n_active_frames": len(active),
        "n_compared_frames": len(compared),
        "n_estimates": n_fired,
        "estimates_per_minute": estimates_per_minute(walked, n_fired),
        "shc_rmse": mean(probe.shc_rmse for probe in probes),
        "coverage": mean(probe.coverage for probe in probes),
        **{metric: mean(row[metric] for row in frames) for metric in METRICS},
        "payload_bytes": sum(probe.payload_bytes for probe in probes),
        "frames": frames,
        "thetas": list(at_thetas),
    }


def _frame_row(entry: FrameResult, compared: Mapping[str, float | None]) -> dict[str, Any]:
    probes = entry.probes
    return {
        "frame": entry.frame,
        "time_s": entry.time_s,
        "n_fired": sum(probe.fired for probe in probes),
        "shc_rmse": mean(probe.shc_rmse for probe in probes),
        "coverage": mean(probe.coverage for probe in probes),
        **{metric: compared.get(metric) for metric in METRICS},
    }


def estimates_per_minute(walked: WalkedPath, n_fired: int) -> float | None:
    """Estimates per minute in which a position is in view, at the path's own frame rate; None without one in view."""
    times = [entry.time_s for entry in walked.frames]
    n_steps = sum(len(entry.probes) for entry in walked.frames)
    if n_steps == 0 or len(times) < 2:
        return None
    step_s: float = (times[-1] - times[0]) / (len(times) - 1)
    return 60 * n_fired / (n_steps * step_s)


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of the values that are not None; None without any."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def write_csv(path: Path, rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> None:
    """Write a table, whole or not at all; what is None or missing is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    with written_whole(path) as beside:
        beside.write_text(text.getvalue(), encoding="utf-8")
