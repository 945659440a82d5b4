"""What does results.json say, and in which words? Schema version 1, as the README describes it.

Numbers only as JSON can hold them: None where a value is undefined, never NaN or Infinity.
"""

from __future__ import annotations

import os
import platform
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.compare import ERROR_AT_FULL_SCALE
from xihe_blender.effects import simulated_effects
from xihe_blender.outputs import finite_or_none
from xihe_blender.plan import PrevisPlan, Probe
from xihe_blender.previs_settings import PrevisSettings
from xihenet import __version__
from xihenet.camera import valid_plane_depth
from xihenet.metrics import shc_rmse
from xihenet.records import ArrayF64, RgbdFrame, StepReport

SCHEMA_VERSION = 1
METRICS = ("psnr", "ssim", "rmse", "si_rmse", "angular_deg")


def inactive_frame(frame: int, time_s: float) -> dict[str, Any]:
    """A frame in which no estimation position is in view: nothing was rendered, nothing computed."""
    return {
        "frame": frame,
        "time_s": time_s,
        "active": False,
        "render_s": 0.0,
        "work_s": 0.0,
        "stage_ms": {},
        "n_invalid_pixels": 0,
        "probes": [],
    }


def active_frame(
    captured: RgbdFrame,
    steps: Mapping[str, StepReport],
    probes: list[dict[str, Any]],
    render_s: float,
    work_s: float,
) -> dict[str, Any]:
    """A frame that went through the chain; `stage_ms` adds up its positions, `work_s` is all that is not rendering."""
    stage_ms: dict[str, float] = {}
    for step in steps.values():
        for stage, ms in step.stage_ms.items():
            stage_ms[stage] = stage_ms.get(stage, 0.0) + ms
    valid = valid_plane_depth(captured.plane_depth_m)
    ambient = None if captured.ambient is None else captured.ambient.tolist()
    return {
        "frame": captured.frame,
        "time_s": captured.time_s,
        "active": True,
        "render_s": render_s,
        "work_s": work_s,
        "stage_ms": stage_ms,
        "ambient_radiance": ambient,
        "n_invalid_pixels": int(valid.size - np.count_nonzero(valid)),
        "probes": probes,
    }


def probe_entry(probe: Probe, step: StepReport, light: ArrayF64, truth: ArrayF64) -> dict[str, Any]:
    """What one step did at one position; `light` is the one in force after it."""
    decision = step.decision
    return {
        "name": probe.name,
        "object": probe.object_name,
        "position_m": probe.position_m.tolist(),
        "coverage": step.coverage,
        "fired": decision.fire,
        "reason": decision.reason,
        "change": finite_or_none(decision.change),
        "threshold": finite_or_none(decision.threshold),
        "n_changed_anchors": decision.n_changed_anchors,
        "n_skipped_points": step.n_skipped_points,
        "is_valid": step.estimate is None or step.estimate.is_valid,
        "payload_bytes": step.payload_bytes,
        "sh": light.tolist(),
        "sh_truth": truth.tolist(),
        "shc_rmse": shc_rmse(light, truth),
    }


def assemble(
    scene: bpy.types.Scene,
    file: Path,
    plan: PrevisPlan,
    settings: PrevisSettings,
    exposure: float,
    frames: list[dict[str, Any]],
    *,
    command: str,
) -> dict[str, Any]:
    """The content of results.json."""
    comparison = mean_comparison(frames)
    return {
        "schema_version": SCHEMA_VERSION,
        "software": {
            "xihe": __version__,
            "blender": bpy.app.version_string,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "command": command,
        },
        "machine": {
            "platform": platform.platform(),
            "processor": platform.machine(),
            "n_cores": os.cpu_count(),
            "cycles_device": cycles_device(scene),
        },
        "settings": _settings(plan, settings, exposure),
        "scene": {
            "file": file.name,
            "name": scene.name,
            "camera": scene.camera.name if scene.camera else None,
            "fps": scene.render.fps / scene.render.fps_base,
            "virtual_objects": [item.name for item in plan.objects],
            "view_transform": scene.view_settings.view_transform,
        },
        "effects": simulated_effects(scene),
        "frames": frames,
        "comparison": comparison,
        "summary": summary(frames, comparison),
        "notes": notes(scene, frames),
    }


def _settings(plan: PrevisPlan, settings: PrevisSettings, exposure: float) -> dict[str, Any]:
    effort = settings.effort
    return {
        "estimator": settings.estimator,
        "preset": settings.preset,
        "target": settings.target,
        "size": list(plan.size),
        "frames": list(plan.frames),
        "n_anchors": settings.n_anchors,
        "codec": "uint8_float16_stripped",
        "seed": settings.seed,
        "reference_exposure": exposure,
        "trigger": asdict(settings.trigger),
        "samples": {
            "capture": effort.capture_samples,
            "truth": effort.truth_samples,
            "comparison": effort.comparison_samples,
        },
        "truth_size": [effort.truth_width, effort.truth_width // 2],
        "comparison_step": effort.comparison_step,
        "comparison_view_transform": "Standard",
        "error_map_full_scale": ERROR_AT_FULL_SCALE,
    }


def cycles_device(scene: bpy.types.Scene) -> str:
    """What Cycles renders on, as the user's Blender is set up."""
    if scene.cycles.device == "CPU":
        return "CPU"
    addon = bpy.context.preferences.addons.get("cycles")
    kind = addon.preferences.compute_device_type if addon else "NONE"
    return "CPU" if kind == "NONE" else str(kind)


def mean_comparison(frames: Sequence[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Every metric of every method, averaged over the compared frames in which it is defined."""
    compared = [entry["comparison"] for entry in frames if "comparison" in entry]
    methods = list(compared[0]) if compared else []
    return {name: {metric: _mean(entry[name][metric] for entry in compared) for metric in METRICS} for name in methods}


def summary(frames: Sequence[dict[str, Any]], comparison: Mapping[str, Mapping[str, float | None]]) -> dict[str, Any]:
    """The run in a few numbers."""
    active = [entry for entry in frames if entry["active"]]
    probes = [probe for entry in active for probe in entry["probes"]]
    render_s, work_s = sum(e["render_s"] for e in active), sum(e["work_s"] for e in active)
    return {
        "n_frames": len(frames),
        "n_active_frames": len(active),
        "n_compared_frames": sum("comparison" in entry for entry in frames),
        "n_estimates": sum(probe["fired"] for probe in probes),
        "fired_share": _mean(float(probe["fired"]) for probe in probes),
        "mean_shc_rmse": _mean(probe["shc_rmse"] for probe in probes),
        "ambient_shc_rmse": _mean(probe["ambient_shc_rmse"] for probe in probes),
        "mean_coverage": _mean(probe["coverage"] for probe in probes),
        "mean_step_ms": _mean(sum(entry["stage_ms"].values()) for entry in active),
        "payload_bytes": sum(probe["payload_bytes"] for probe in probes),
        "n_invalid_pixels": sum(entry["n_invalid_pixels"] for entry in active),
        "render_s": render_s,
        "comparison_render_s": sum(entry.get("comparison_render_s", 0.0) for entry in frames),
        "overhead_share": work_s / render_s if render_s else None,
        "rmse_against_ambient": {
            name: _ratio(metrics["rmse"], comparison["ambient"]["rmse"]) for name, metrics in comparison.items()
        },
    }


def notes(scene: bpy.types.Scene, frames: Sequence[dict[str, Any]]) -> list[str]:
    """What a reader of the numbers has to know, in plain sentences."""
    own = scene.view_settings.view_transform
    aside = "as the scene has it" if own == "Standard" else f"the scene's own, {own}, would bend the comparison"
    said = [
        f"Pictures are made with the Standard view transform: {aside}.",
        "Image metrics count the pixels that virtual objects cover, by how much they cover; psnr and ssim on "
        "sRGB-encoded colour, the others on linear colour at the session's exposure.",
        "The shadow that a virtual object casts on the room is in the ground truth but not in the methods' pictures.",
        "In the pictures `truth` is the whole light of the rendered probe as order-2 SH, not clipped.",
    ]
    inactive = [entry["frame"] for entry in frames if not entry["active"]]
    if inactive:
        frames_were = ("1 frame", "was") if len(inactive) == 1 else (f"{len(inactive)} frames", "were")
        said.append("{} had no estimation position in view and {} not captured.".format(*frames_were))
    invalid = sum(entry["n_invalid_pixels"] for entry in frames)
    if invalid:
        said.append(f"{invalid} captured pixels had no plane depth (open sky or a window) and gave no point.")
    return said


def _mean(values: Any) -> float | None:
    """Mean of the values that are not None; None without any."""
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None


def _ratio(value: float | None, reference: float | None) -> float | None:
    return value / reference if value is not None and reference else None
