"""The summary of a run: means and sums over its frames; what a reader is told of them is in results_notes.py."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from xihe_blender.io.run_results import METRICS, FrameResult, InvalidCounts, Metrics, Summary
from xihe_blender.report.values import mean
from xihenet.invalid import added, counted


def mean_comparison(frames: Sequence[FrameResult]) -> dict[str, Metrics]:
    """Every metric of every method, averaged over the compared frames in which it is defined."""
    compared = [frame.compared.comparison for frame in frames if frame.compared is not None]
    methods = list(compared[0]) if compared else []
    return {
        name: Metrics(**{metric: mean(getattr(of_frame[name], metric) for of_frame in compared) for metric in METRICS})
        for name in methods
    }


def summary(frames: Sequence[FrameResult], comparison: Mapping[str, Metrics], pilot_s: float) -> Summary:
    """The run in a few numbers."""
    active = [frame for frame in frames if frame.active]
    probes = [probe for frame in active for probe in frame.probes]
    compared = [frame.compared for frame in frames if frame.compared is not None]
    renderings = [frame.rendering for frame in active if frame.rendering is not None]
    lights = [light for rendering in renderings for light in rendering.probes.values()]
    render_s, work_s = sum(frame.render_s for frame in active), sum(frame.work_s for frame in active)
    return Summary(
        n_frames=len(frames),
        n_active_frames=len(active),
        n_compared_frames=len(compared),
        n_reused_captures=sum(not rendering.capture.rendered for rendering in renderings),
        n_reused_probes=sum(not light.rendered for light in lights),
        n_reused_comparisons=sum(of_frame.comparison_same_as is not None for of_frame in compared),
        n_estimates=sum(probe.fired for probe in probes),
        fired_share=mean(float(probe.fired) for probe in probes),
        mean_shc_rmse=mean(probe.shc_rmse for probe in probes),
        ambient_shc_rmse=mean(probe.ambient_shc_rmse for probe in probes),
        share_above_white=mean(probe.share_above_white for probe in probes),
        n_capped_probes=sum(light.is_capped for light in lights),
        mean_coverage=mean(probe.coverage for probe in probes),
        mean_step_ms=mean(sum(frame.stage_ms.values()) for frame in active),
        payload_bytes=sum(probe.payload_bytes for probe in probes),
        mean_latency_ms=mean(probe.latency_ms for probe in probes if probe.fired),
        n_lost=sum(probe.fired and probe.latency_ms is None for probe in probes),
        n_invalid_pixels=sum(frame.n_invalid_pixels for frame in active),
        n_invalid_points=sum(probe.n_invalid_points for probe in probes),
        n_followed_anchors=sum(probe.n_followed_anchors for probe in probes),
        n_unknown_lights=sum(not probe.is_valid for probe in probes),
        invalid=InvalidCounts(
            pixels=added(frame.invalid for frame in active),
            points=added(probe.invalid for probe in probes),
            lights=added({probe.unknown_because: 1} for probe in probes if probe.unknown_because is not None),
            metrics=added(undefined for of_frame in compared for undefined in _undefined(of_frame.comparison)),
            hues=added(counted(**of_frame.n_hueless_pixels) for of_frame in compared),
        ),
        render_s=render_s,
        comparison_render_s=sum(of_frame.comparison_render_s for of_frame in compared),
        overhead_share=work_s / render_s if render_s else None,
        rmse_against_ambient={
            name: _ratio(metrics.rmse, comparison["ambient"].rmse) for name, metrics in comparison.items()
        },
        pilot_s=pilot_s,
    )


def _undefined(comparison: Mapping[str, Metrics]) -> list[dict[str, int]]:
    """Once for each method's metric that has no value."""
    return [{name: 1} for metrics in comparison.values() for name in METRICS if getattr(metrics, name) is None]


def _ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None
