"""What does results.json say, and in which words? Schema version 1, as the README describes it.

Numbers only as JSON can hold them: None where a value is undefined, never NaN or Infinity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.capture.reference_probe import MeasuredLight, ProbeSettings
from xihe_blender.compare.methods import ERROR_AT_FULL_SCALE
from xihe_blender.io.outputs import finite_or_none
from xihe_blender.io.provenance import machine, software
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.phone_capture import SimulatedPhone
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.results_notes import notes
from xihe_blender.previs.results_summary import mean_comparison, summary
from xihenet.camera import invalid_pixels
from xihenet.invalid import CLAMPED
from xihenet.metrics import shc_rmse
from xihenet.phone import Request, first_frame_after
from xihenet.records import ArrayF64, RgbdFrame, StepReport

SCHEMA_VERSION = 1


def inactive_frame(frame: int, time_s: float, *, is_delivered: bool = True) -> dict[str, Any]:
    """A frame with no estimation position in view, or that the phone does not deliver: nothing rendered or computed."""
    return {
        "frame": frame,
        "time_s": time_s,
        "active": False,
        "is_delivered": is_delivered,
        "render_s": 0.0,
        "work_s": 0.0,
        "stage_ms": {},
        "n_invalid_pixels": 0,
        "n_lost_pixels": {},
        "invalid": {},
        "probes": [],
    }


def active_frame(
    seen: RgbdFrame,
    steps: Mapping[str, StepReport],
    probes: list[dict[str, Any]],
    render_s: float,
    work_s: float,
    *,
    n_lost: Mapping[str, int],
) -> dict[str, Any]:
    """A frame, as the phone saw it, that went through the chain.

    `stage_ms` adds up its positions, `work_s` is all that is not rendering, `n_lost` pixels that each effect took.
    """
    stage_ms: dict[str, float] = {}
    for step in steps.values():
        for stage, ms in step.stage_ms.items():
            stage_ms[stage] = stage_ms.get(stage, 0.0) + ms
    left_out = invalid_pixels(seen)
    clamped = {reason: n for reason, n in seen.invalid.items() if reason in CLAMPED}
    ambient = None if seen.ambient is None else seen.ambient.tolist()
    return {
        "frame": seen.frame,
        "time_s": seen.time_s,
        "active": True,
        "is_delivered": True,
        "exposure": seen.exposure,
        "render_s": render_s,
        "work_s": work_s,
        "stage_ms": stage_ms,
        "ambient_radiance": ambient,
        "n_invalid_pixels": sum(left_out.values()),
        "n_lost_pixels": dict(n_lost),
        "invalid": left_out | clamped,
        "probes": probes,
    }


def rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> dict[str, Any]:
    """What was rendered for `frame`, with how many samples and what noise, and what an earlier frame had already."""
    reuse, effort, target = run.reuse, run.effort, run.settings.target
    capture = _render(frame, reuse.captures[frame], effort.capture_samples, effort.capture_noise)
    probes = {
        name: _render(frame, reuse.probes[frame, name], light.samples(target), light.noise(target))
        | {"is_capped": is_capped(light.samples(target), light.noise(target), run.reference)}
        for name, light in references.items()
    }
    return {"rendering": {"capture": capture, "probes": probes}}


def is_capped(samples: int, noise: float | None, settings: ProbeSettings) -> bool:
    """Whether a reference has the most samples and is still noisier than it should be."""
    if settings.noise_target is None or noise is None:
        return False
    return samples >= settings.max_samples and noise > settings.noise_target


def _render(frame: int, source: int, samples: int, noise: float | None) -> dict[str, Any]:
    same_as = None if source == frame else source
    return {"rendered": same_as is None, "same_as": same_as, "samples": samples, "noise": finite_or_none(noise)}


def probe_entry(
    probe: Probe, step: StepReport, light: ArrayF64, truth: ArrayF64, *, light_frame: int | None
) -> dict[str, Any]:
    """What one step did at one position; `light` is the one in force after it, estimated in `light_frame`."""
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
        "n_skipped_points": step.n_invalid_points,
        "n_invalid_points": step.n_invalid_points,
        "invalid": dict(step.invalid),
        "is_valid": not step.unknown_because,
        "unknown_because": step.unknown_because or None,
        "light_frame": light_frame,
        "n_followed_anchors": step.n_followed_anchors,
        "payload_bytes": step.payload_bytes,
        "sh": light.tolist(),
        "sh_truth": truth.tolist(),
        "shc_rmse": shc_rmse(light, truth),
    }


def arrival(request: Request | None, times_s: Mapping[int, float]) -> dict[str, Any]:
    """When the estimate of one step arrives; null without one, for one that was lost, or after the last frame.

    `times_s` are those of the path's frames, by number.
    """
    if request is None:
        return {"arrival_frame": None, "latency_ms": None}
    frames = list(times_s)
    index = int(first_frame_after([request.arrival_s], list(times_s.values()))[0])
    latency_s = request.latency_s
    return {
        "arrival_frame": frames[index] if index < len(frames) else None,
        "latency_ms": None if latency_s is None else 1e3 * latency_s,
    }


def assemble(
    run: PreparedRun,
    frames: list[dict[str, Any]],
    *,
    lights: Mapping[str, Sequence[tuple[int, ArrayF64]]],
    phone: SimulatedPhone,
    errors: dict[str, Any] | None,
    file: Path,
    command: str,
) -> dict[str, Any]:
    """The content of results.json.

    Parameters
    ----------
    frames : its entries
    lights : what the timeline of each virtual object is keyed with: (frame, coefficients) where they change
    phone : with the effects that were simulated
    errors : what these do to the light; None without any
    file : where the scene comes from
    command : what the user typed
    """
    scene = run.scene
    comparison = mean_comparison(frames)
    return {
        "schema_version": SCHEMA_VERSION,
        "software": software(command),
        "machine": machine() | {"cycles_device": cycles_device(scene)},
        "settings": _settings(run),
        "scene": {
            "file": file.name,
            "name": scene.name,
            "camera": scene.camera.name if scene.camera else None,
            "fps": scene.render.fps / scene.render.fps_base,
            "virtual_objects": [item.name for item in run.plan.objects],
            "view_transform": scene.view_settings.view_transform,
            "faults": [asdict(fault) for fault in run.survey.faults],
        },
        "effects": [*run.effects.as_json(), *other_effects(scene), *phone.as_json()],
        "phone": {"name": run.phone.profile.name, "summary": run.phone.profile.summary, "shc_rmse": errors},
        "frames": frames,
        "lights": {
            name: [{"frame": frame, "sh": light.tolist()} for frame, light in of_one] for name, of_one in lights.items()
        },
        "comparison": comparison,
        "summary": summary(frames, comparison) | {"pilot_s": run.effort.pilot_s},
        "notes": notes(run, frames, phone),
    }


def other_effects(scene: bpy.types.Scene) -> list[dict[str, Any]]:
    """[{name, state, reason, parameters, origin}] of what is always so, besides light transport and phone."""
    clamp = scene.cycles.sample_clamp_indirect
    rows = [
        ("indirect clamp", clamp > 0, f"as the scene has it: {clamp:g}"),
        ("8-bit clipping", True, "a phone delivers clipped, sRGB-encoded bytes"),
    ]
    return [
        {"name": name, "state": "on" if is_on else "off", "reason": reason, "parameters": {}, "origin": "auto"}
        for name, is_on, reason in rows
    ]


def _settings(run: PreparedRun) -> dict[str, Any]:
    settings, effort, preset = run.settings, run.effort, run.settings.effort
    return {
        "estimator": settings.estimator,
        "preset": settings.preset,
        "target": settings.target,
        "size": list(run.plan.size),
        "frames": list(run.plan.frames),
        "n_anchors": settings.n_anchors,
        "codec": "uint8_float16_stripped",
        "seed": settings.seed,
        "phone": settings.phone,
        "network": settings.network,
        "effect_choices": overrides_in_force(run.scene, settings.effect_choices),
        "reference_exposure": run.exposure,
        "metering": None if settings.exposure is not None else settings.metering_in_force,
        "trigger": asdict(settings.trigger),
        "following": None if settings.following is None else asdict(settings.following),
        "samples": {
            "capture": effort.capture_samples,
            "truth": run.reference.max_samples,
            "comparison": preset.comparison_samples,
        },
        "noise_target": None if settings.samples is not None else settings.noise_aim,
        "noise": {
            "capture": effort.capture_noise,
            "truth": run.reference.noise_target,
            "trigger": effort.capture_change,
        },
        "truth_size": [run.reference.size, run.reference.size],
        "comparison_step": preset.comparison_step,
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
