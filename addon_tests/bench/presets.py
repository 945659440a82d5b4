"""Presets: does `accurate` have at most half of `draft`'s error, and does `balanced` lie between, on every scene?

    python addon_tests/bench/presets.py --out DIR SCENE.blend...        about 5 minutes a scene

The presets alone, as `xihe frontier` measures them, but in more --views, with more --seeds, and against a render with
more samples, --reference, than a frontier can afford. What is rendered is kept in DIR, and the same command goes on
from there. Printed are error of the light and processor time of a frame by preset, and accurate over draft, with the
range over views.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from given import given

from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.jobs import run_blocking
from xihe_blender.lab.frontier.choices import FULL, RenderCandidate
from xihe_blender.lab.frontier.compute import KINDS
from xihe_blender.lab.frontier.records import FrontierSettings, RenderChoice
from xihe_blender.lab.frontier.rendering import COMPUTED_BY, RenderStudy, SceneStudy, measure_rendering
from xihe_blender.lab.frontier.study import prepare, survey_scene
from xihe_blender.lab.frontier.timing import median_and_spread
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept
from xihenet.camera_path.placement import evenly_chosen

HEAD = """\
| scene | draft | balanced | accurate | accurate / draft in coefficients (by view) | in irradiance |
| --- | --- | --- | --- | --- | --- |"""


def measured(file, folder, study_size, seed):
    """What `measure_rendering` gives for the presets on one scene, and how many errors belong to one view."""
    scene = open_blend(file)
    plan, survey = survey_scene(scene)
    settings = FrontierSettings(seed=seed, study_size=study_size)
    study = SceneStudy(scene, plan, survey, folder / file.stem, settings)
    with scene_kept():
        prepared = run_blocking(prepare(study))
        capture = RenderSettings(plan.size, 1, seed, light_transport=prepared.light_transport)
        with open_scanner(scene, capture) as scanner:
            scanner.exposure = prepared.exposure
            positions_m = {probe.name: probe.position_m for probe in plan.probes}
            views = {
                frame: [positions_m[name] for name in names]
                for frame, names in evenly_chosen(list(survey.in_view.items()), study_size.n_views)
            }
            choices = [RenderCandidate(choice, name) for name, choice in prepared.presets.items()]
            exhaustive = RenderChoice(plan.size, study_size.reference_samples)
            renders = RenderStudy(
                **vars(study), scanner=scanner, capture=capture, views=views, choices=choices, exhaustive=exhaustive
            )
            nothing = dict.fromkeys(COMPUTED_BY, 0.0)
            alone, _ = run_blocking(measure_rendering(renders, nothing))
    return alone, [len(positions_m) * study_size.n_seeds for positions_m in views.values()]


def by_view(one, kind, sizes):
    """Root mean square error in each view."""
    squares = np.split(np.array(one.square_errors[kind]), np.cumsum(sizes)[:-1])
    return np.sqrt([each.mean() for each in squares])


def row(file, alone, sizes):
    """A line of the table."""
    overall = {kind: [np.sqrt(np.mean(one.square_errors[kind])) for one in alone] for kind in KINDS}
    times_s = [median_and_spread(one.times_ms)[0] / 1000 for one in alone]
    samples = ", ".join(str(one.settings.rendering.samples) for one in alone)
    cells = [f"{error:.2%} in {time_s:.2g} s" for error, time_s in zip(overall["coefficients"], times_s, strict=True)]
    for kind in KINDS:
        draft, balanced, accurate = overall[kind]
        views = by_view(alone[2], kind, sizes) / by_view(alone[0], kind, sizes)
        is_right = accurate <= draft / 2 and draft > balanced > accurate and times_s == sorted(times_s)
        cells.append(f"{accurate / draft:.2f} ({views.min():.2f} to {views.max():.2f}){'' if is_right else ' WRONG'}")
    return f"| `{file.stem}` ({samples} samples) | {' | '.join(cells)} |"


def main():
    options = given(__doc__, "scenes+", out=Path, reference=FULL.reference_samples, views=FULL.n_views, seeds=2, seed=0)
    study_size = replace(FULL, reference_samples=options.reference, n_views=options.views, n_seeds=options.seeds)
    with blender_output_aside() as (stdout, _):
        print(HEAD, file=stdout, flush=True)
        for file in options.scenes:
            print(row(file, *measured(file, options.out, study_size, options.seed)), file=stdout, flush=True)


if __name__ == "__main__":
    main()
