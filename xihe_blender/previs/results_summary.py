"""What do the frames of a run come to? Means and sums; what is said of them is in results_notes.py."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from xihenet.invalid import added, counted

METRICS = ("psnr", "ssim", "rmse", "si_rmse", "angular_deg")


def mean_comparison(frames: Sequence[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Every metric of every method, averaged over the compared frames in which it is defined."""
    compared = [entry["comparison"] for entry in frames if "comparison" in entry]
    methods = list(compared[0]) if compared else []
    return {name: {metric: _mean(entry[name][metric] for entry in compared) for metric in METRICS} for name in methods}


def summary(frames: Sequence[dict[str, Any]], comparison: Mapping[str, Mapping[str, float | None]]) -> dict[str, Any]:
    """The run in a few numbers."""
    active = [entry for entry in frames if entry["active"]]
    probes = [probe for entry in active for probe in entry["probes"]]
    compared = [entry for entry in frames if "comparison" in entry]
    render_s, work_s = sum(e["render_s"] for e in active), sum(e["work_s"] for e in active)
    return {
        "n_frames": len(frames),
        "n_active_frames": len(active),
        "n_compared_frames": len(compared),
        "n_reused_captures": sum(not e["rendering"]["capture"]["rendered"] for e in active),
        "n_reused_probes": sum(not p["rendered"] for e in active for p in e["rendering"]["probes"].values()),
        "n_reused_comparisons": sum(entry.get("comparison_same_as") is not None for entry in frames),
        "n_estimates": sum(probe["fired"] for probe in probes),
        "fired_share": _mean(float(probe["fired"]) for probe in probes),
        "mean_shc_rmse": _mean(probe["shc_rmse"] for probe in probes),
        "ambient_shc_rmse": _mean(probe["ambient_shc_rmse"] for probe in probes),
        "share_above_white": _mean(probe["share_above_white"] for probe in probes),
        "n_capped_probes": sum(p["is_capped"] for e in active for p in e["rendering"]["probes"].values()),
        "mean_coverage": _mean(probe["coverage"] for probe in probes),
        "mean_step_ms": _mean(sum(entry["stage_ms"].values()) for entry in active),
        "payload_bytes": sum(probe["payload_bytes"] for probe in probes),
        "mean_latency_ms": _mean(probe["latency_ms"] for probe in probes if probe["fired"]),
        "n_lost": sum(probe["fired"] and probe["latency_ms"] is None for probe in probes),
        "n_invalid_pixels": sum(entry["n_invalid_pixels"] for entry in active),
        "n_invalid_points": sum(probe["n_invalid_points"] for probe in probes),
        "n_followed_anchors": sum(probe["n_followed_anchors"] for probe in probes),
        "n_unknown_lights": sum(not probe["is_valid"] for probe in probes),
        "invalid": {
            "pixels": added(entry["invalid"] for entry in active),
            "points": added(probe["invalid"] for probe in probes),
            "lights": added({p["unknown_because"]: 1} for p in probes if not p["is_valid"]),
            "metrics": added(undefined for entry in compared for undefined in _undefined(entry["comparison"])),
            "hues": added(counted(**entry["n_hueless_pixels"]) for entry in compared),
        },
        "render_s": render_s,
        "comparison_render_s": sum(entry.get("comparison_render_s", 0.0) for entry in frames),
        "overhead_share": work_s / render_s if render_s else None,
        "rmse_against_ambient": {
            name: _ratio(metrics["rmse"], comparison["ambient"]["rmse"]) for name, metrics in comparison.items()
        },
    }


def _undefined(comparison: Mapping[str, Mapping[str, float | None]]) -> list[dict[str, int]]:
    """Once for each method's metric that has no value."""
    return [{name: 1} for metrics in comparison.values() for name, value in metrics.items() if value is None]


def _mean(values: Any) -> float | None:
    """Mean of the values that are not None; None without any."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def _ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None
