"""What is measured on one scene, in which order, and what is kept of it?

Metering, effects and the presets' numbers of samples as in a run; a walk and its light probes; then computing,
rendering and pictures. What costs renders is kept file by file in the run's folder, and a run that was stopped takes
it up; what is only computed is done again.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import CyclesScanner, meter_exposure, open_scanner
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.lab.frontier.chain import Walk
from xihe_blender.lab.frontier.choices import (
    ComputeChoice,
    Effort,
    RenderChoice,
    compute_choices,
    render_choices,
)
from xihe_blender.lab.frontier.compute import AGAINST_TRUTH, loaded, measure_compute
from xihe_blender.lab.frontier.light_errors import ORDER
from xihe_blender.lab.frontier.measured import Measured
from xihe_blender.lab.frontier.pictures import PictureStudy, measure_pictures, picture_choices
from xihe_blender.lab.frontier.rendering import RenderStudy, View, measure_rendering
from xihe_blender.lab.frontier.steps import Steps, part_of
from xihe_blender.lab.frontier.timing import Spread
from xihe_blender.light_transport import EffectPlan
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.light_transport.plan import planned
from xihe_blender.previs.plan import PrevisPlan, evenly_chosen, plan_previs
from xihe_blender.previs.sample_count import capture_noise, pilot_samples, pilot_views, samples_taken
from xihe_blender.previs.settings import PRESETS, PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.state import scene_kept
from xihenet.recording import load_frame, save_frame

PROBE_NOISE = 0.02
"""Of the reference lights that estimates are held against, which are off by ten times as much."""

SHARES = {"preparing": 0.10, "walking": 0.15, "computing": 0.15, "rendering": 0.4, "pictures": 0.2}
"""About how long each part takes, for the time left."""


@dataclass(frozen=True, eq=False)
class SceneStudy:
    """One scene to measure: the open scene, its plan, the survey of its path, and where its work is kept."""

    scene: bpy.types.Scene
    name: str
    plan: PrevisPlan
    survey: SceneSurvey
    folder: Path
    is_quick: bool
    seed: int
    effort: Effort


@dataclass(frozen=True)
class Prepared:
    """What a run would settle before its first frame."""

    exposure: float
    light_transport: tuple[tuple[str, bool | int], ...]
    presets: Mapping[str, RenderChoice]


def measure_scene(study: SceneStudy, done: float, whole: float) -> Job[dict[str, Any]]:
    """All that was measured on a scene, as JSON: fronts [Measured], estimators that are missing, facts."""
    rng = np.random.default_rng(study.seed)
    effort, size = study.effort, study.plan.size

    def share(name: str, steps: Steps[Any]) -> Job[Any]:
        nonlocal done
        result = yield from part_of(whole, done, SHARES[name], steps, study.name)
        done += SHARES[name]
        return result

    with scene_kept():
        prepared = yield from share("preparing", prepare(study))
        capture = RenderSettings(size, effort.walk_samples, study.seed, light_transport=prepared.light_transport)
        with open_scanner(study.scene, capture) as scanner:
            scanner.exposure = prepared.exposure
            walk = yield from share("walking", _walk(study, prepared, scanner))
            backends, missing = loaded(compute_choices(is_quick=study.is_quick))
            computed = yield from share("computing", measure_compute(backends, walk, effort.n_rounds, rng))
            renders = RenderStudy(
                scanner,
                _views(walk, effort.n_views),
                render_choices(prepared.presets, size, effort, is_quick=study.is_quick),
                RenderChoice(size, effort.reference_samples),
                effort,
                study.seed,
                study.folder,
            )
            computing_ms = {
                choice: Spread.of(one.times_ms).median for choice, one in zip(backends, computed, strict=True)
            }
            rendered, together = yield from share("rendering", measure_rendering(renders, computing_ms, rng))
            comparison = replace(capture, samples=1)
            pictures = PictureStudy(renders, study.plan, comparison, picture_choices(prepared.presets), study.folder)
            pictured, estimators = yield from share("pictures", measure_pictures(pictures, rng))
    computed = [_with_pictures(one, estimators) for one in computed]
    content = {
        "fronts": {
            "render": [one.as_json() for one in [*rendered, *pictured]],
            "compute": [one.as_json() for one in computed],
            "total": [one.as_json() for one in [*together, *_with_computing(pictured, computing_ms)]],
        },
        "missing_estimators": missing,
        "exposure": prepared.exposure,
        "size": list(size),
        "n_walk_frames": len(walk.frames),
        "n_places": walk.n_places,
        "views": [view.frame for view in renders.views],
        "presets": {name: choice.as_json() for name, choice in prepared.presets.items()},
    }
    yield Progress(done, whole, f"{study.name}: measured")
    return content


def _with_pictures(one: Measured, estimators: Mapping[str, list[float]]) -> Measured:
    squares = estimators.get(one.label)
    if squares is None:
        return one
    return replace(one, square_errors={**one.square_errors, "picture" + AGAINST_TRUTH: squares})


def _with_computing(pictured: list[Measured], computing_ms: Mapping[ComputeChoice, float]) -> list[Measured]:
    added = computing_ms[ComputeChoice()]
    return [replace(one, times_ms=[ms + added for ms in one.times_ms]) for one in pictured]


def prepare(study: SceneStudy) -> Steps[Prepared]:
    """Measure it, or read what a run that was stopped has measured."""
    path = study.folder / "prepared.json"
    if not path.exists():
        yield 0.0, "metering the exposure, looking for effects"
        scene, plan = study.scene, study.plan
        exposure = meter_exposure(scene, plan.frames, study.seed)
        effects = planned(study.survey.verdicts, overrides_in_force(scene, {}))
        samples = {}
        for place, name in enumerate(PRESETS):
            yield (1 + place) / (1 + len(PRESETS)), f"measuring how many samples {name} takes"
            samples[name] = preset_samples(study, name, exposure, effects)
        write_json(path, {"exposure": exposure, "effects": effects.as_json(), "samples": samples})
    kept = json.loads(path.read_text(encoding="utf-8"))
    size = study.plan.size
    presets = {name: RenderChoice(size, kept["samples"][name], preset=name) for name in PRESETS}
    return Prepared(kept["exposure"], EffectPlan.from_json(kept["effects"]).light_transport, presets)


def preset_samples(study: SceneStudy, name: str, exposure: float, effects: EffectPlan) -> int:
    """Samples per pixel of captures that a run of a preset takes on a scene, measured as the run does it."""
    settings, preset = PrevisSettings(preset=name, seed=study.seed), PRESETS[name]
    scene, plan = study.scene, study.plan
    views = pilot_views(plan, study.survey)
    if not views:
        raise UserError(f"scene {scene.name!r} never has a virtual object in view: move the camera's path, or objects")
    capture = replace(settings.capture(plan.size, pilot_samples(preset)), light_transport=effects.light_transport)
    model = capture_noise(scene, views, capture, exposure, settings.n_anchors)
    return samples_taken(preset, model)


def _walk(study: SceneStudy, prepared: Prepared, scanner: CyclesScanner) -> Steps[Walk]:
    """Captures, and light probes at the positions in view, of frames spread over the path."""
    plan = study.plan
    positions = {probe.name: probe.position_m for probe in plan.probes}
    chosen = evenly_chosen(list(study.survey.in_view.items()), study.effort.n_walk_frames)
    probes = ProbeSettings(
        max_samples=study.effort.probe_samples, noise_target=PROBE_NOISE, seed=study.seed,
        light_transport=prepared.light_transport, order=ORDER,
    )  # fmt: skip
    places = {name: place for place, name in enumerate(positions)}
    frames, truths = [], []
    with open_reference_probe(study.scene, list(positions.values()), probes) as probe:
        for place, (frame, active) in enumerate(chosen):
            yield place / len(chosen), f"capturing frame {frame} and its light probes"
            captured, lights = study.folder / f"walk_{frame:04d}.npz", study.folder / f"probes_{frame:04d}.json"
            if not captured.exists():
                scanner.move_to(frame)
                captured.parent.mkdir(parents=True, exist_ok=True)
                save_frame(captured, scanner.acquire_environment_scan())
            if not lights.exists():
                measured = {n: probe.light_at(places[n], frame, prepared.exposure).measured for n in active}
                write_json(lights, {name: light.ldr.tolist() for name, light in measured.items()})
            frames.append(load_frame(captured))
            kept = json.loads(lights.read_text(encoding="utf-8"))
            truths.append({name: np.array(kept[name]) for name in active})
    return Walk(frames, [active for _, active in chosen], positions, truths, prepared.exposure)


def _views(walk: Walk, most: int) -> list[View]:
    numbers = evenly_chosen(list(range(len(walk.frames))), most)
    return [View(walk.frames[k].frame, [walk.positions[name] for name in walk.active[k]]) for k in numbers]


def survey_scene(scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> tuple[PrevisPlan, SceneSurvey]:
    """What a run on `scene` would do, and what its path is like; UserError as a run raises it."""
    plan = plan_previs(scene, PrevisSettings(size=size))
    return plan, survey_path(scene, plan)
