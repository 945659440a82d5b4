"""What do a noise target and renders that are not made twice save, at equal noise of the light?

    python addon_tests/bench/sample_count.py [--size 128x96] [--presets balanced,draft] [--step 3]

A walk: capture, light probes and, at every n-th frame, the comparison of three methods; nothing is stored, and the
chain is left out. Before, each frame renders all of it with fixed numbers of samples. Now the walk has its pilot and
its look at what changes, both counted, takes the samples that reach the preset's noise target, and takes over what an
earlier frame has already. Light transport is planned in both.

First table, for each preset: `living_room` with a phone that stops and goes: of 24 frames it walks four and holds its
pose for four, three times, or walks four and holds for eight, twice. Fixed numbers are those that the pilot finds, so
that noise is equal and what is saved is renders.
Second table: each scene on its own walk in the last of the presets (every `--step`-th frame timed, renders counted over
all). Fixed numbers are those of the scene that needs the most, since a number that is fixed for all scenes must reach
the target there as well.
Seconds are of processor time, all threads together, which a busy machine stretches less than the clock's.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import bpy

from xihe_blender.capture.reference_probe import open_reference_probe
from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.cli.arguments import picture_size
from xihe_blender.compare.methods import open_comparer
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.render_reuse import RenderReuse, each_its_own, plan_render_reuse
from xihe_blender.previs.plan import PrevisPlan, plan_previs
from xihe_blender.previs.sample_count import SampleCount, measure_sample_count
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept
from xihenet.effects import plan_effects
from xihenet.records import ObjectLight

SCENES = Path(__file__).resolve().parents[2] / "blend_scenes"
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


def open_stage(name: str, settings: PrevisSettings, held: int = 0) -> Stage:
    scene = open_blend(SCENES / f"{name}.blend")
    if held:
        stop_and_go(scene, held)
    plan = plan_previs(scene, settings)
    survey = survey_path(scene, plan)
    transport = cycles_settings(plan_effects(survey.required, {}))
    return Stage(scene, plan, survey, settings, meter_exposure(scene, plan.frames), transport)


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


def as_surveyed(survey: SceneSurvey) -> RenderReuse:
    """What a run renders."""
    return plan_render_reuse({frame: one.state for frame, one in survey.frames.items()}, survey.in_view, {})


def every_frame(survey: SceneSurvey) -> RenderReuse:
    """Nothing is ever the same, so that every frame is rendered."""
    return plan_render_reuse(each_its_own(survey.frames), survey.in_view, {})


def walk(stage: Stage, sample_count: SampleCount, reuse: RenderReuse) -> Walked:
    """Render what no earlier frame has."""
    scene, plan, survey, settings, exposure, transport = stage
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
            for place, probe in enumerate(plan.probes):
                if probe.name in names and reuse.probes[frame, probe.name] == frame:
                    lights[probe.object_name] = reference_probe.light_at(place, frame, exposure).measured.hdr
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
    survey = survey_path(stage.scene, stage.plan)
    sample_count = measure_sample_count(*stage)
    before_s = time.process_time() - start
    walked = walk(stage, sample_count, as_surveyed(survey))
    return walked._replace(walk_s=before_s + walked.walk_s), sample_count


def still_table(settings: PrevisSettings) -> Iterator[str]:
    """The table, line by line."""
    walks = {}
    for held in (4, 8):
        stage = open_stage("living_room", settings, held)
        with scene_kept():
            walks[f"now, holds for {held} of {4 + held}"], sample_count = adaptive_walk(stage)
            if held == 4:
                before = walk(stage, sample_count, every_frame(stage.survey))
    yield f"living_room, stop and go, {settings.preset}, {said(sample_count)}"
    yield f"{'':<26}{'captures, probes':>24}{'compared':>16}{'all':>16}"
    for name, walked in {"fixed, every frame": before, **walks}.items():
        counts = f"{walked.captures:3} {walked.probes:3}"
        parts = [(walked.walk_s, before.walk_s), (walked.compare_s, before.compare_s), (walked.seconds, before.seconds)]
        walk_part, compare_part, all_of_it = (f"{now:7.1f} s{was / now:5.2f}x" for now, was in parts)
        yield f"{name:<26}{counts} {walk_part:>16}{walked.comparisons:3}{compare_part:>16}{all_of_it:>16}"


def said(sample_count: SampleCount) -> str:
    return f"captures {sample_count.capture_samples} samples ({sample_count.capture_noise:.1%} noise)"


def kept_counts(name: str, settings: PrevisSettings) -> str:
    """Captures and probes that the scene's whole own walk renders, of those that it needs."""
    scene = open_blend(SCENES / f"{name}.blend")
    reuse = as_surveyed(survey_path(scene, plan_previs(scene, settings)))
    captures = [source == frame for frame, source in reuse.captures.items()]
    probes = [source == frame for (frame, _), source in reuse.probes.items()]
    return f"{sum(captures):5} /{len(captures):3}{sum(probes):8} /{len(probes):3}"


def scene_table(size: tuple[int, int], preset: str, step: int) -> Iterator[str]:
    """The table, line by line."""
    names = sorted(path.stem for path in SCENES.glob("*.blend"))
    settings = PrevisSettings(size=size, preset=preset, frames=tuple(range(1, 25, step)))
    most = SampleCount(max(measure_sample_count(*open_stage(name, settings)).capture_samples for name in names))
    yield f"own walks, {preset}, fixed: captures {most.capture_samples} samples"
    yield f"{'':<20}{'captures':>10}{'probes':>12}{'fixed s':>10}{'now s':>8}{'':>8}  samples now"
    for name in names:
        stage = open_stage(name, settings)
        with scene_kept():
            now, sample_count = adaptive_walk(stage)
            before = walk(stage, most, every_frame(stage.survey))
        counts = kept_counts(name, PrevisSettings(size=size, preset=preset))
        ratio = f"{before.seconds / now.seconds:7.2f}x"
        yield f"{name:<20}{counts}{before.seconds:10.1f}{now.seconds:8.1f}{ratio}  {said(sample_count)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=picture_size, default=(128, 96))
    parser.add_argument("--presets", default="balanced,draft", type=lambda text: text.split(","))
    parser.add_argument("--step", type=int, default=3)
    options = parser.parse_args()
    with blender_output_aside() as (stdout, _):
        still = [still_table(PrevisSettings(size=options.size, preset=preset)) for preset in options.presets]
        scenes = scene_table(options.size, options.presets[-1], options.step)
        for line in itertools.chain(*still, [""], scenes):
            print(line, file=stdout, flush=True)


if __name__ == "__main__":
    main()
