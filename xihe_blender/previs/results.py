"""The results of a run, gathered: what each frame and position came to, as `io.run_results` defines it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.reference_probe import MeasuredLight
from xihe_blender.compare.methods import ERROR_AT_FULL_SCALE
from xihe_blender.io import run_results as records
from xihe_blender.io.json_records import from_json
from xihe_blender.io.outputs import finite_or_none
from xihe_blender.io.provenance import machine, software
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.phone_capture import SimulatedPhone
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.results_notes import mean_object_pixels, notes, recorded_notes, recorded_warnings, warnings
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.report.values import mean
from xihenet.controller import ControllerSettings
from xihenet.effects import Effect, Requirement, effects_as_json, plan_effects
from xihenet.invalid import added, counted
from xihenet.phone import Request, first_frame_after
from xihenet.records import ArrayF64, KeyLight
from xihenet.surfaces import Surface

AS_SET = {part.name for part in fields(records.RunSettings)} & {part.name for part in fields(PrevisSettings)}
"""Settings that results hold under the same names; some of them as they came to be, see `_settings`."""


def rendering(frame: int, references: Mapping[str, MeasuredLight], run: PreparedRun) -> records.Rendering:
    """What was rendered for `frame`, with how many samples and what noise, and what an earlier frame had already."""
    source, count = run.reuse.captures[frame], run.sample_count
    capture = records.CaptureRender(
        rendered=source == frame,
        same_as=None if source == frame else source,
        samples=count.capture_samples,
        noise=finite_or_none(count.capture_noise),
    )
    probes = {
        name: _probe_render(frame, run.reuse.probes[frame, name], light, run) for name, light in references.items()
    }
    return records.Rendering(capture=capture, probes=probes)


def _probe_render(frame: int, source: int, light: MeasuredLight, run: PreparedRun) -> records.ProbeRender:
    target, aim = run.settings.target, run.reference
    samples, noise = light.samples(target), light.noise(target)
    is_too_noisy = noise is not None and aim.noise_target is not None and noise > aim.noise_target
    return records.ProbeRender(
        rendered=source == frame,
        same_as=None if source == frame else source,
        samples=samples,
        noise=finite_or_none(noise),
        expected_error=finite_or_none(light.expected_error(target)),
        is_capped=is_too_noisy and samples >= aim.max_samples,
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


def as_key(key: KeyLight | None) -> records.KeyLightResult | None:
    """A key light as results.json has it."""
    if key is None:
        return None
    return records.KeyLightResult(
        direction=as_rgb(key.direction),
        irradiance=as_rgb(key.irradiance),
        angular_radius=float(key.angular_radius),
        is_seen=bool(key.is_seen),
        certainty=float(key.certainty),
    )


def as_surface_result(surface: Surface) -> records.SurfaceResult:
    """A surface that catches shadows as results.json has it."""
    return records.SurfaceResult(
        outline_m=tuple(as_rgb(corner) for corner in surface.outline_m.round(5)), normal=as_rgb(surface.normal)
    )


def last_surfaces(frames: Sequence[records.FrameResult]) -> dict[str, list[Surface]]:
    """By object, where its shadow falls, as the last compared frame has it."""
    compared = [frame.compared for frame in frames if frame.compared is not None]
    found = compared[-1].surfaces if compared else {}
    return {
        name: [Surface(np.array(one.outline_m), np.array(one.normal), 0.0) for one in of_one]
        for name, of_one in found.items()
    }


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
    lights: Mapping[str, Sequence[records.LightChange]],
    phone: SimulatedPhone,
    errors: records.PhoneErrors | None,
    file: Path,
    command: str,
    recording: records.RecordingResult | None = None,
) -> records.RunResults:
    """The content of results.json.

    Parameters
    ----------
    frames : with what was compared
    lights : what the timeline of each virtual object is keyed with
    errors : what the effects of `phone` do to the light; None without any
    file, command : where the scene comes from, and what the user typed
    recording : that the run is on; None where captures were rendered
    """
    scene, profile = run.scene, run.phone.profile
    comparison = _mean_comparison(frames)
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
        phone=records.PhoneResult(
            name=profile.name if recording is None else recording.name,
            summary=profile.summary if recording is None else f"the phone that recorded it ({recording.format})",
            shc_rmse=errors,
        ),
        frames=tuple(frames),
        lights={name: tuple(of_one) for name, of_one in lights.items()},
        comparison=comparison,
        summary=_summary(frames, comparison, run.sample_count.pilot_s),
        notes=tuple(notes(run, frames, phone) if recording is None else recorded_notes(run, frames, recording)),
        warnings=tuple(warnings(run, frames) if recording is None else recorded_warnings(run)),
        recording=recording,
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
    as_set = {name: getattr(settings, name) for name in AS_SET}
    came_to_be = dict[str, Any](
        size=run.plan.size,
        frames=run.plan.frames,
        codec=ControllerSettings.codec,
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
    return records.RunSettings(**as_set | came_to_be)


def _cycles_device(scene: bpy.types.Scene) -> str:
    """What Cycles renders on, as the user's Blender is set up."""
    addon = bpy.context.preferences.addons.get("cycles")
    kind = addon.preferences.compute_device_type if addon and scene.cycles.device != "CPU" else "NONE"
    return "CPU" if kind == "NONE" else str(kind)


def _mean_comparison(frames: Sequence[records.FrameResult]) -> dict[str, records.Metrics]:
    """Every metric of every method, averaged over the compared frames in which it is defined."""
    compared = [frame.compared.comparison for frame in frames if frame.compared is not None]
    methods = list(compared[0]) if compared else []
    return {
        name: records.Metrics(
            **{metric: mean(getattr(of_frame[name], metric) for of_frame in compared) for metric in records.METRICS}
        )
        for name in methods
    }


def _summary(
    frames: Sequence[records.FrameResult], comparison: Mapping[str, records.Metrics], pilot_s: float
) -> records.Summary:
    """The run in a few numbers."""
    active, captured = ([one for one in frames if getattr(one, kind)] for kind in ("active", "captured"))
    probes = [probe for frame in active for probe in frame.probes]
    compared = [frame.compared for frame in frames if frame.compared is not None]
    renderings = [frame.rendering for frame in captured if frame.rendering is not None]
    lights = [light for rendering in renderings for light in rendering.probes.values()]
    of_methods = [metrics for of_frame in compared for metrics in of_frame.comparison.values()]
    undefined = Counter(name for metrics in of_methods for name in records.METRICS if getattr(metrics, name) is None)
    ambient = comparison["ambient"].rmse if comparison else None
    render_s, work_s = sum(frame.render_s for frame in captured), sum(frame.work_s for frame in captured)
    return records.Summary(
        n_frames=len(frames),
        n_active_frames=len(active),
        n_captured_frames=len(captured),
        n_compared_frames=len(compared),
        n_reused_captures=sum(not rendering.capture.rendered for rendering in renderings),
        n_reused_probes=sum(not light.rendered for light in lights),
        n_reused_comparisons=sum(of_frame.comparison_same_as is not None for of_frame in compared),
        n_estimates=sum(probe.fired for probe in probes),
        fired_share=mean(float(probe.fired) for probe in probes),
        mean_shc_rmse=mean(probe.shc_rmse for probe in probes),
        expected_error=mean(probe.expected_error for probe in probes),
        ambient_shc_rmse=mean(probe.ambient_shc_rmse for probe in probes),
        others_shc_rmse={
            name: mean(probe.others[name].shc_rmse for probe in probes) for name in (probes[0].others if probes else ())
        },
        share_above_white=mean(probe.share_above_white for probe in probes),
        n_capped_probes=sum(light.is_capped for light in lights),
        mean_coverage=mean(probe.coverage for probe in probes),
        mean_step_ms=mean(sum(frame.stage_ms.values()) for frame in active),
        payload_bytes=sum(probe.payload_bytes for probe in probes),
        mean_latency_ms=mean(probe.latency_ms for probe in probes if probe.fired),
        n_lost=sum(probe.fired and probe.latency_ms is None for probe in probes),
        n_invalid_pixels=sum(frame.n_invalid_pixels for frame in captured),
        n_invalid_points=sum(probe.n_invalid_points for probe in probes),
        n_followed_anchors=sum(probe.n_followed_anchors for probe in probes),
        n_carried_lights=sum(set(probe.light_gain) != {1.0} for probe in probes),
        n_unknown_lights=sum(not probe.is_valid for probe in probes),
        invalid=records.InvalidCounts(
            pixels=added(frame.invalid for frame in captured),
            points=added(probe.invalid for probe in probes),
            lights=added({probe.unknown_because: 1} for probe in probes if probe.unknown_because is not None),
            metrics=dict(undefined),
            hues=added(counted(**of_frame.n_hueless_pixels) for of_frame in compared),
        ),
        render_s=render_s,
        comparison_render_s=sum(of_frame.comparison_render_s for of_frame in compared),
        overhead_share=work_s / render_s if render_s else None,
        object_pixels=mean_object_pixels(frames),
        rmse_against_ambient={
            name: None if metrics.rmse is None or not ambient else metrics.rmse / ambient
            for name, metrics in comparison.items()
        },
        pilot_s=pilot_s,
    )
