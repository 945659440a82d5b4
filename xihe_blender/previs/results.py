"""The results of a run, gathered: what each frame and position came to, as `io.run_results` defines it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.capture.reference_probe import MeasuredLight, ProbeSettings
from xihe_blender.compare.methods import ERROR_AT_FULL_SCALE
from xihe_blender.io.json_records import from_json
from xihe_blender.io.outputs import finite_or_none
from xihe_blender.io.provenance import machine, software
from xihe_blender.io.run_results import (
    CaptureRender,
    Coefficients,
    EffectResult,
    Fault,
    FrameResult,
    LightChange,
    NoiseLevels,
    PhoneErrors,
    PhoneResult,
    ProbeRender,
    ProbeResult,
    Rendering,
    Rgb,
    RunResults,
    RunSettings,
    SampleCounts,
    SceneResult,
)
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.phone_capture import SimulatedPhone
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.results_notes import notes
from xihe_blender.previs.results_summary import mean_comparison, summary
from xihenet.camera import invalid_pixels
from xihenet.effects import Effect, Requirement, effects_as_json, plan_effects
from xihenet.invalid import CLAMPED
from xihenet.metrics import shc_rmse
from xihenet.phone import Request, first_frame_after
from xihenet.records import ArrayF64, RgbdFrame, StepReport


def inactive_frame(frame: int, time_s: float, *, is_delivered: bool = True) -> FrameResult:
    """A frame with no estimation position in view, or that the phone does not deliver: nothing rendered or computed."""
    return FrameResult(frame=frame, time_s=time_s, active=False, is_delivered=is_delivered)


def active_frame(
    seen: RgbdFrame,
    steps: Mapping[str, StepReport],
    probes: Sequence[ProbeResult],
    rendering: Rendering,
    times_s: tuple[float, float],
    *,
    n_lost: Mapping[str, int],
) -> FrameResult:
    """A frame, as the phone saw it, that went through the chain.

    `stage_ms` adds up its positions; `times_s` are of rendering and of all else, `n_lost` pixels that each effect took.
    """
    stage_ms: dict[str, float] = {}
    for step in steps.values():
        for stage, ms in step.stage_ms.items():
            stage_ms[stage] = stage_ms.get(stage, 0.0) + ms
    left_out = invalid_pixels(seen)
    clamped = {reason: n for reason, n in seen.invalid.items() if reason in CLAMPED}
    return FrameResult(
        frame=seen.frame,
        time_s=seen.time_s,
        active=True,
        exposure=seen.exposure,
        render_s=times_s[0],
        work_s=times_s[1],
        stage_ms=stage_ms,
        ambient_radiance=None if seen.ambient is None else as_rgb(seen.ambient),
        n_invalid_pixels=sum(left_out.values()),
        n_lost_pixels=dict(n_lost),
        invalid=left_out | clamped,
        probes=tuple(probes),
        rendering=rendering,
    )


def rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> Rendering:
    """What was rendered for `frame`, with how many samples and what noise, and what an earlier frame had already."""
    reuse, sample_count = run.reuse, run.sample_count
    return Rendering(
        capture=CaptureRender(
            **_source(frame, reuse.captures[frame]),
            samples=sample_count.capture_samples,
            noise=finite_or_none(sample_count.capture_noise),
        ),
        probes={
            name: _probe_render(_source(frame, reuse.probes[frame, name]), light, run)
            for name, light in references.items()
        },
    )


def _source(frame: int, source: int) -> dict[str, Any]:
    return {"rendered": source == frame, "same_as": None if source == frame else source}


def _probe_render(source: dict[str, Any], light: MeasuredLight, run: PreparedRun) -> ProbeRender:
    target = run.settings.target
    samples, noise = light.samples(target), light.noise(target)
    return ProbeRender(
        **source,
        samples=samples,
        noise=finite_or_none(noise),
        expected_error=finite_or_none(light.expected_error(target)),
        is_capped=is_capped(samples, noise, run.reference),
    )


def is_capped(samples: int, noise: float | None, settings: ProbeSettings) -> bool:
    """Whether a reference has the most samples and is still noisier than it should be."""
    if settings.noise_target is None or noise is None:
        return False
    return samples >= settings.max_samples and noise > settings.noise_target


def probe_result(
    probe: Probe,
    step: StepReport,
    arrives: tuple[int | None, float | None],
    *,
    lights: tuple[ArrayF64, ArrayF64, ArrayF64],
    light_frame: int | None,
    share_above_white: float | None,
) -> ProbeResult:
    """What one step did at one position.

    Parameters
    ----------
    arrives : frame and latency of its estimate; see `arrival`
    lights : (9, 3) each: in force after the step, estimated in `light_frame`; the probe's own; the ambient one
    """
    decision, (light, truth, ambient) = step.decision, lights
    return ProbeResult(
        name=probe.name,
        object=probe.object_name,
        position_m=as_rgb(probe.position_m),
        coverage=step.coverage,
        fired=decision.fire,
        reason=decision.reason,
        change=finite_or_none(decision.change),
        threshold=finite_or_none(decision.threshold),
        n_changed_anchors=decision.n_changed_anchors,
        n_skipped_points=step.n_invalid_points,
        n_invalid_points=step.n_invalid_points,
        invalid=dict(step.invalid),
        is_valid=not step.unknown_because,
        unknown_because=step.unknown_because or None,
        light_frame=light_frame,
        n_followed_anchors=step.n_followed_anchors,
        payload_bytes=step.payload_bytes,
        arrival_frame=arrives[0],
        latency_ms=arrives[1],
        sh=as_coefficients(light),
        sh_truth=as_coefficients(truth),
        shc_rmse=shc_rmse(light, truth),
        ambient_shc_rmse=shc_rmse(ambient, truth),
        share_above_white=share_above_white,
    )


def arrival(request: Request | None, times_s: Mapping[int, float]) -> tuple[int | None, float | None]:
    """Frame and latency, in ms, of one step's estimate; None without one, for a lost one, or after the last frame.

    `times_s` are those of the path's frames, by number.
    """
    if request is None:
        return None, None
    frames = list(times_s)
    index = int(first_frame_after([request.arrival_s], list(times_s.values()))[0])
    latency_s = request.latency_s
    return frames[index] if index < len(frames) else None, None if latency_s is None else 1e3 * latency_s


def as_coefficients(light: ArrayF64) -> Coefficients:
    """(K, 3) as results hold it."""
    return tuple(as_rgb(row) for row in light)


def as_rgb(row: ArrayF64) -> Rgb:
    """(3,) as results hold it."""
    return float(row[0]), float(row[1]), float(row[2])


def assemble(
    run: PreparedRun,
    frames: Sequence[FrameResult],
    *,
    lights: Mapping[str, Sequence[tuple[int, ArrayF64]]],
    phone: SimulatedPhone,
    errors: PhoneErrors | None,
    file: Path,
    command: str,
) -> RunResults:
    """The content of results.json.

    Parameters
    ----------
    frames : with what was compared
    lights : what the timeline of each virtual object is keyed with: (frame, coefficients) where they change
    phone : with the effects that were simulated
    errors : what these do to the light; None without any
    file : where the scene comes from
    command : what the user typed
    """
    scene = run.scene
    comparison = mean_comparison(frames)
    effects = effects_as_json({**run.effects, **other_effects(scene), **phone.effects})
    return RunResults(
        software=software(command),
        machine=machine() | {"cycles_device": cycles_device(scene)},
        settings=_settings(run),
        scene=SceneResult(
            file=file.name,
            name=scene.name,
            camera=scene.camera.name if scene.camera else None,
            fps=scene.render.fps / scene.render.fps_base,
            virtual_objects=tuple(item.name for item in run.plan.objects),
            view_transform=scene.view_settings.view_transform,
            faults=tuple(Fault(**asdict(fault)) for fault in run.survey.faults),
        ),
        effects=tuple(from_json(EffectResult, row) for row in effects),
        phone=PhoneResult(name=run.phone.profile.name, summary=run.phone.profile.summary, shc_rmse=errors),
        frames=tuple(frames),
        lights={
            name: tuple(LightChange(frame=frame, sh=as_coefficients(light)) for frame, light in of_one)
            for name, of_one in lights.items()
        },
        comparison=comparison,
        summary=summary(frames, comparison, run.sample_count.pilot_s),
        notes=tuple(notes(run, frames, phone)),
    )


def other_effects(scene: bpy.types.Scene) -> dict[str, Effect]:
    """What is always so, besides light transport and phone."""
    clamp = scene.cycles.sample_clamp_indirect
    required = {
        "indirect clamp": Requirement(clamp > 0, f"as the scene has it: {clamp:g}", {}, {}),
        "8-bit clipping": Requirement(True, "a phone delivers clipped, sRGB-encoded bytes", {}, {}),
    }
    return plan_effects(required, {})


def _settings(run: PreparedRun) -> RunSettings:
    settings, sample_count, preset = run.settings, run.sample_count, run.settings.preset_values
    has_target = settings.samples is None
    return RunSettings(
        estimator=settings.estimator,
        preset=settings.preset,
        target=settings.target,
        size=run.plan.size,
        frames=tuple(run.plan.frames),
        n_anchors=settings.n_anchors,
        codec="uint8_float16_stripped",
        seed=settings.seed,
        phone=settings.phone,
        network=settings.network,
        effect_choices=overrides_in_force(run.scene, settings.effect_choices),
        reference_exposure=run.exposure,
        metering=None if settings.exposure is not None else settings.metering_in_force,
        trigger=asdict(settings.trigger),
        following=None if settings.following is None else asdict(settings.following),
        samples=SampleCounts(
            capture=sample_count.capture_samples, truth=run.reference.max_samples, comparison=preset.comparison_samples
        ),
        noise_target=settings.noise_aim if has_target else None,
        noise=NoiseLevels(
            capture=sample_count.capture_noise, truth=run.reference.noise_target, trigger=sample_count.capture_change
        ),
        truth_size=(run.reference.size, run.reference.size),
        comparison_step=preset.comparison_step,
        comparison_view_transform="Standard",
        error_map_full_scale=ERROR_AT_FULL_SCALE,
    )


def cycles_device(scene: bpy.types.Scene) -> str:
    """What Cycles renders on, as the user's Blender is set up."""
    if scene.cycles.device == "CPU":
        return "CPU"
    addon = bpy.context.preferences.addons.get("cycles")
    kind = addon.preferences.compute_device_type if addon else "NONE"
    return "CPU" if kind == "NONE" else str(kind)
