"""The sample count: what do a noise target and renders that are not made twice save, at equal noise of the light?

    python addon_tests/bench/sample_count.py [--size 128x96] [--presets balanced,draft]

A walk: capture, light probes and, at every n-th frame, the comparison of three methods; nothing is stored, and the
chain is left out. Before, each frame renders all of it with fixed numbers of samples. Now the walk has its pilot and
its look at what changes, both counted, takes the samples that reach the preset's noise target, and takes over what an
earlier frame has already. Light transport is planned in both.

A table for each preset, of `living_room` with a phone that stops and goes: of 24 frames it walks four and holds its
pose for four, three times, or walks four and holds for eight, twice. Fixed numbers are those that the pilot finds, so
that noise is equal and what is saved is renders. Seconds are of processor time, all threads together, which a busy
machine stretches less than the clock's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import bpy
from given import given, words

from xihe_blender.capture.reference_probe import open_reference_probe
from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.cli.arguments import picture_size
from xihe_blender.compare.methods import open_comparer
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.jobs import run_blocking
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.render_reuse import SceneState, each_its_own, plan_render_reuse
from xihe_blender.previs.plan import PrevisPlan, plan_previs
from xihe_blender.previs.sample_count import SampleCount, measure_sample_count
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept
from xihenet.effects import plan_effects
from xihenet.records import ObjectLight

SCENE = Path(__file__).resolve().parents[2] / "blend_scenes" / "living_room.blend"
METHODS = ("projection", "ambient", "truth")


class Stage(NamedTuple):
    """A scene that is ready to be walked through."""

    scene: bpy.types.Scene
    plan: PrevisPlan
    survey: SceneSurvey
    settings: PrevisSettings
    exposure: float
    light_transport: tuple


class Walked(NamedTuple):
    """Processor seconds of captures and light probes, those of comparisons, and how many of each it rendered."""

    walk_s: float
    compare_s: float
    captures: int
    probes: int
    comparisons: int

    @property
    def seconds(self) -> float:
        return self.walk_s + self.compare_s


def open_stage(settings: PrevisSettings, held: int) -> Stage:
    scene = open_blend(SCENE)
    stop_and_go(scene, held)
    plan = plan_previs(scene, settings)
    survey = run_blocking(survey_path(scene, plan))
    transport = cycles_settings(plan_effects(survey.required, {}))
    return Stage(scene, plan, survey, settings, run_blocking(meter_exposure(scene, plan.frames)), transport)


def stop_and_go(scene: bpy.types.Scene, held: int) -> None:
    """Key the phone anew: it walks four frames along its path, holds its pose for `held`, and so on."""
    phone, poses = scene.camera, []
    for frame in range(1, 25):
        scene.frame_set(frame)
        poses.append((phone.location.copy(), phone.rotation_euler.copy()))
    for frame in range(1, 25):
        block, place = divmod(frame - 1, 4 + held)
        phone.location, phone.rotation_euler = poses[(4 + held) * block + min(place, 3)]
        phone.keyframe_insert("location", frame=frame)
        phone.keyframe_insert("rotation_euler", frame=frame)


def walk(stage: Stage, sample_count: SampleCount, states: Mapping[int, SceneState]) -> Walked:
    """Render what no earlier frame of the same state has."""
    scene, plan, survey, settings, exposure, transport = stage
    reuse = plan_render_reuse(states, survey.in_view, {})
    start = time.process_time()
    capture = replace(settings.capture(plan.size, sample_count.capture_samples), light_transport=transport)
    reference = replace(settings.reference, light_transport=transport)
    comparison = replace(settings.comparison(plan.size), light_transport=transport)
    captured, lights, compared, n_probes = {}, {}, {}, 0
    with (
        open_scanner(scene, capture) as scanner,
        open_reference_probe(scene, [probe.position_m for probe in plan.probes], reference) as reference_probe,
    ):
        scanner.exposure = exposure
        for frame, names in survey.in_view.items():
            scanner.move_to(frame)
            if reuse.captures[frame] == frame:
                captured[frame] = scanner.acquire_environment_scan()
            for index, probe in enumerate(plan.probes):
                if probe.name in names and reuse.probes[frame, probe.name] == frame:
                    lights[probe.object_name] = reference_probe.light_at(index, frame, exposure).measured.hdr
                    n_probes += 1
            compared[frame] = reuse.captures[frame], dict(lights)
    walk_s, start, made = time.process_time() - start, time.process_time(), {}
    with open_comparer(scene, plan.objects, METHODS, comparison) as comparer:
        for frame in list(compared)[:: settings.preset_values.comparison_step]:
            source, light = compared[frame]
            by_name = [light[name].tobytes() for name in sorted(light)]
            if made.setdefault(reuse.comparison(frame, str(source).encode(), *by_name), frame) == frame:
                anywhere = next(iter(light.values()))
                of_each = {item.name: ObjectLight(light.get(item.name, anywhere)) for item in plan.objects}
                comparer.render_comparison(captured[source], dict.fromkeys(METHODS, of_each))
    return Walked(walk_s, time.process_time() - start, len(captured), n_probes, len(made))


def adaptive_walk(stage: Stage) -> tuple[Walked, SampleCount]:
    """As a run does it: `walk_s` holds survey, pilot and walk."""
    start = time.process_time()
    survey = run_blocking(survey_path(stage.scene, stage.plan))
    sample_count = run_blocking(measure_sample_count(*stage))
    before_s = time.process_time() - start
    walked = walk(stage, sample_count, survey.states)
    return walked._replace(walk_s=before_s + walked.walk_s), sample_count


def still_table(settings: PrevisSettings) -> Iterator[str]:
    """The table, line by line."""
    walks = {}
    for held in (4, 8):
        stage = open_stage(settings, held)
        with scene_kept():
            walks[f"now, holds for {held} of {4 + held}"], sample_count = adaptive_walk(stage)
            if held == 4:
                before = walk(stage, sample_count, each_its_own(stage.survey.frames))
    took = f"{sample_count.capture_samples} samples ({sample_count.capture_noise:.1%} noise)"
    yield f"living_room, stop and go, {settings.preset}, captures {took}"
    yield f"{'':<26}{'captures, probes':>24}{'compared':>16}{'all':>16}"
    for name, walked in {"fixed, every frame": before, **walks}.items():
        counts = f"{walked.captures:3} {walked.probes:3}"
        parts = [(walked.walk_s, before.walk_s), (walked.compare_s, before.compare_s), (walked.seconds, before.seconds)]
        walk_part, compare_part, all_of_it = (f"{now:7.1f} s{was / now:5.2f}x" for now, was in parts)
        yield f"{name:<26}{counts} {walk_part:>16}{walked.comparisons:3}{compare_part:>16}{all_of_it:>16}"


def main() -> None:
    options = given(__doc__, size=(picture_size, (128, 96)), presets=(words, ["balanced", "draft"]))
    with blender_output_aside() as (stdout, _):
        for preset in options.presets:
            for line in still_table(PrevisSettings(size=options.size, preset=preset)):
                print(line, file=stdout, flush=True)


if __name__ == "__main__":
    main()
