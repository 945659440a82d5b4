"""The results of a run, gathered: what each frame and position came to, as `io.run_results` defines it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.capture.reference_probe import MeasuredLight
from xihe_blender.compare.methods import ERROR_AT_FULL_SCALE
from xihe_blender.io import run_results as records
from xihe_blender.io.json_records import from_json
from xihe_blender.io.outputs import finite_or_none
from xihe_blender.io.provenance import machine, software
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.phone_capture import SimulatedPhone
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.results_notes import notes
from xihe_blender.previs.results_summary import mean_comparison, summary
from xihenet.effects import Effect, Requirement, effects_as_json, plan_effects
from xihenet.metrics import shc_rmse
from xihenet.phone import Request, first_frame_after
from xihenet.records import ArrayF64, StepReport

AS_SET = ("estimator", "preset", "target", "n_anchors", "seed", "phone", "network")
"""Settings that results hold under the same names."""


def rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> records.Rendering:
    """What was rendered for `frame`, with how many samples and what noise, and what an earlier frame had already."""
    reuse, count = run.reuse, run.sample_count
    captured = _render(frame, reuse.captures[frame], count.capture_samples, count.capture_noise)
    return records.Rendering(
        capture=records.CaptureRender(**captured),
        probes={
            name: _probe_render(frame, reuse.probes[frame, name], light, run) for name, light in references.items()
        },
    )


def _render(frame: int, source: int, samples: int, noise: float | None) -> dict[str, Any]:
    """The fields of a CaptureRender of `frame` that `source` has already."""
    same_as = None if source == frame else source
    return {"rendered": same_as is None, "same_as": same_as, "samples": samples, "noise": finite_or_none(noise)}


def _probe_render(frame: int, source: int, light: MeasuredLight, run: PreparedRun) -> records.ProbeRender:
    target, aim = run.settings.target, run.reference
    samples, noise = light.samples(target), light.noise(target)
    is_too_noisy = noise is not None and aim.noise_target is not None and noise > aim.noise_target
    return records.ProbeRender(
        **_render(frame, source, samples, noise),
        expected_error=finite_or_none(light.expected_error(target)),
        is_capped=is_too_noisy and samples >= aim.max_samples,
    )


def probe_result(
    probe: Probe,
    step: StepReport,
    arrives: tuple[int | None, float | None],
    *,
    lights: tuple[ArrayF64, ArrayF64, ArrayF64],
    light_frame: int | None,
    share_above_white: float | None,
) -> records.ProbeResult:
    """What one step did at one position.

    `arrives` is as of `arrival`. `lights` are (9, 3) each: in force after the step, estimated in `light_frame`; the
    probe's own; the ambient one.
    """
    decision, (light, truth, ambient) = step.decision, lights
    return records.ProbeResult(
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


def as_coefficients(light: ArrayF64) -> records.Coefficients:
    """(K, 3) as results hold it."""
    return tuple(as_rgb(row) for row in light)


def as_rgb(row: ArrayF64) -> records.Rgb:
    """(3,) as results hold it."""
    return float(row[0]), float(row[1]), float(row[2])


def assemble(
    run: PreparedRun,
    frames: Sequence[records.FrameResult],
    *,
    lights: Mapping[str, Sequence[tuple[int, ArrayF64]]],
    phone: SimulatedPhone,
    errors: records.PhoneErrors | None,
    file: Path,
    command: str,
) -> records.RunResults:
    """The content of results.json.

    Parameters
    ----------
    frames : with what was compared
    lights : what the timeline of each virtual object is keyed with: (frame, (9, 3) coefficients) where they change
    errors : what the effects of `phone` do to the light; None without any
    file, command : where the scene comes from, and what the user typed
    """
    scene, profile = run.scene, run.phone.profile
    comparison = mean_comparison(frames)
    effects = effects_as_json({**run.effects, **_other_effects(scene), **phone.effects})
    return records.RunResults(
        software=software(command),
        machine=machine() | {"cycles_device": _cycles_device(scene)},
        settings=_settings(run),
        scene=records.SceneResult(
            file=file.name,
            name=scene.name,
            camera=scene.camera.name if scene.camera else None,
            fps=scene.render.fps / scene.render.fps_base,
            virtual_objects=tuple(item.name for item in run.plan.objects),
            view_transform=scene.view_settings.view_transform,
            faults=run.survey.faults,
        ),
        effects=tuple(from_json(records.EffectResult, row) for row in effects),
        phone=records.PhoneResult(name=profile.name, summary=profile.summary, shc_rmse=errors),
        frames=tuple(frames),
        lights={
            name: tuple(records.LightChange(frame=frame, sh=as_coefficients(light)) for frame, light in of_one)
            for name, of_one in lights.items()
        },
        comparison=comparison,
        summary=summary(frames, comparison, run.sample_count.pilot_s),
        notes=tuple(notes(run, frames, phone)),
    )


def _other_effects(scene: bpy.types.Scene) -> dict[str, Effect]:
    """What is always so, besides light transport and phone."""
    clamp = scene.cycles.sample_clamp_indirect
    required = {
        "indirect clamp": Requirement(clamp > 0, f"as the scene has it: {clamp:g}", {}, {}),
        "8-bit clipping": Requirement(True, "a phone delivers clipped, sRGB-encoded bytes", {}, {}),
    }
    return plan_effects(required, {})


def _settings(run: PreparedRun) -> records.RunSettings:
    settings, count, preset, reference = run.settings, run.sample_count, run.settings.preset_values, run.reference
    return records.RunSettings(
        **{name: getattr(settings, name) for name in AS_SET},
        size=run.plan.size,
        frames=run.plan.frames,
        codec="uint8_float16_stripped",
        effect_choices=overrides_in_force(run.scene, settings.effect_choices),
        reference_exposure=run.exposure,
        metering=None if settings.exposure is not None else settings.metering_in_force,
        trigger=asdict(settings.trigger),
        following=None if settings.following is None else asdict(settings.following),
        samples=records.SampleCounts(
            capture=count.capture_samples, truth=reference.max_samples, comparison=preset.comparison_samples
        ),
        noise_target=settings.noise_aim if settings.samples is None else None,
        noise=records.NoiseLevels(
            capture=count.capture_noise, truth=reference.noise_target, trigger=count.capture_change
        ),
        truth_size=(reference.size, reference.size),
        comparison_step=preset.comparison_step,
        comparison_view_transform="Standard",
        error_map_full_scale=ERROR_AT_FULL_SCALE,
    )


def _cycles_device(scene: bpy.types.Scene) -> str:
    """What Cycles renders on, as the user's Blender is set up."""
    addon = bpy.context.preferences.addons.get("cycles")
    kind = addon.preferences.compute_device_type if addon and scene.cycles.device != "CPU" else "NONE"
    return "CPU" if kind == "NONE" else str(kind)
