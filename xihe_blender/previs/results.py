"""The results of a run, gathered: what each frame and position came to, as `io.run_results` defines it."""

from __future__ import annotations

import statistics
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import bpy

from xihe_blender.apply.reflection_pictures import has_sun_for_lamp
from xihe_blender.capture.cycles_device import device_of
from xihe_blender.io import run_results as records
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.json_records import from_json
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.io.provenance import machine, software
from xihe_blender.io.run_lights import as_coefficients, as_key
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.results_notes import mean_object_pixels, notes_and_warnings
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.simulated_phone import SimulatedPhone
from xihe_blender.report.values import mean
from xihe_blender.scene.units import metres_per_unit
from xihenet.controller import ControllerSettings
from xihenet.effects import Effect, Requirement, effects_as_json, plan_effects
from xihenet.formats import format_number
from xihenet.invalid import added, counted
from xihenet.light.environments import laid_out
from xihenet.light.reflections import light_of_rough, reflection_panorama
from xihenet.records import ObjectLight

AS_SET = {part.name for part in fields(records.RunSettings)} & {part.name for part in fields(PrevisSettings)}
"""Settings that results hold under the same names; some of them as they came to be, see `_settings`."""


def light_changes(
    objects: Sequence[bpy.types.Object],
    lights: Mapping[int, Mapping[str, ObjectLight]],
    outputs: RunOutputs,
    exposure: float,
) -> dict[str, tuple[records.LightChange, ...]]:
    """The light of each virtual object wherever it changes; what it reflects is written to `outputs`.

    `lights` are by frame and virtual object, and carry `exposure`.
    """
    changes: dict[str, tuple[records.LightChange, ...]] = {}
    for index, item in enumerate(objects):
        of_one: list[records.LightChange] = []
        has_sun = has_sun_for_lamp(item)
        pictures: dict[bytes, records.ReflectionsResult] = {}
        for frame, light in ((frame, of_all[item.name]) for frame, of_all in lights.items()):
            reflected = None
            shown = light_of_rough(light).reflections if has_sun else light.reflections
            if shown is not None:
                pixels = shown.radiance.tobytes()
                if pixels not in pictures:
                    path = outputs.reflections(index, item.name, len(pictures) + 1)
                    write_radiance(path, laid_out(reflection_panorama(shown) / exposure, "+X"))
                    pictures[pixels] = records.ReflectionsResult(
                        picture=outputs.relative(path), seen_share=float(shown.seen_share), has_lamp=not has_sun
                    )
                reflected = pictures[pixels]
            sh, key = as_coefficients(light.sh), as_key(light.key)
            change = records.LightChange(frame=frame, sh=sh, key=key, reflections=reflected)
            if not of_one or replace(of_one[-1], frame=frame) != change:
                of_one.append(change)
        changes[item.name] = tuple(of_one)
    return changes


def assemble(
    run: PreparedRun,
    frames: Sequence[records.FrameResult],
    *,
    lights: Mapping[str, Sequence[records.LightChange]],
    phone: SimulatedPhone,
    errors: records.PhoneErrors | None,
    file: Path,
    command: str,
    recording: records.RecordingResult | None,
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
    notes, warnings = notes_and_warnings(run, frames, phone, recording)
    effects = effects_as_json({**run.effects, **_other_effects(scene, run.exposure), **phone.effects})
    return records.RunResults(
        software=software(command),
        machine=machine() | {"cycles_device": device_of(scene)},
        settings=_settings(run),
        scene=records.SceneResult(
            file=file.name,
            name=scene.name,
            camera=scene.camera.name if scene.camera else None,
            fps=scene.render.fps / scene.render.fps_base,
            virtual_objects=tuple(item.name for item in run.plan.objects),
            view_transform=scene.view_settings.view_transform,
            faults=run.survey.faults,
            unit_m=metres_per_unit(scene),
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
        summary=_summary(frames, comparison, run.sample_count.pilot_s, run.settings.estimator),
        notes=notes,
        warnings=warnings,
        recording=recording,
    )


def _other_effects(scene: bpy.types.Scene, exposure: float) -> dict[str, Effect]:
    """What is always so, besides light transport and phone."""
    clamp = scene.cycles.sample_clamp_indirect
    beside_white = f", {format_number(clamp * exposure, 2)} times white at this exposure" if clamp > 0 else ""
    required = {
        "indirect clamp": Requirement(clamp > 0, f"as the scene has it: {clamp:g}{beside_white}", {}, {}),
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
        trigger=asdict(settings.trigger_in_use),
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
        error_map_full_scale=records.ERROR_AT_FULL_SCALE,
    )
    return records.RunSettings(**as_set | came_to_be)


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
    frames: Sequence[records.FrameResult], comparison: Mapping[str, records.Metrics], pilot_s: float, estimator: str
) -> records.Summary:
    """The run of `estimator` in a few numbers."""
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
        estimate_ms=_estimate_ms(active, estimator),
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


def _estimate_ms(frames: Sequence[records.FrameResult], estimator: str) -> dict[str, float]:
    """Of one estimate, by estimator: the median over the frames that made some."""
    times: dict[str, list[float]] = defaultdict(list)
    for frame in frames:
        n_made = sum(probe.fired and probe.is_valid for probe in frame.probes)
        if n_made:
            for name, ms in ({estimator: frame.stage_ms.get("estimate", 0.0)} | frame.others_ms).items():
                times[name].append(ms / n_made)
    return {name: statistics.median(each) for name, each in times.items()}
