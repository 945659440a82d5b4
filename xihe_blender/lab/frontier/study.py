"""Study of a frontier, `xihe frontier`: every scene measured, its fronts found, and all of it written down.

Of a scene: metering, effects and the presets' numbers of samples as in a run; a walk and its light probes; then
computing, rendering and pictures. What costs renders is kept file by file in the run's folder, and a run that was
stopped takes it up; what is only computed is done again. A scene that is done is kept whole. The folder belongs to one
set of scenes and one seed; another is refused, as for `xihe previs`.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TypeVar

import bpy
import numpy as np

from xihe_blender.capture.cycles_device import device_of
from xihe_blender.capture.reference_probe import ProbeSettings, open_reference_probe
from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.capture.scanner import CyclesScanner, meter_exposure, open_scanner
from xihe_blender.errors import UserError, of_file
from xihe_blender.io.folder_manifest import FolderManifest, contents_sha256
from xihe_blender.io.json_records import as_json
from xihe_blender.io.kept_files import kept_or_done
from xihe_blender.io.outputs import check_names_differ, write_csv, write_json
from xihe_blender.io.provenance import machine, software
from xihe_blender.jobs import Job, Progress, part_of, run_blocking, shown
from xihe_blender.lab.frontier.answers import answers
from xihe_blender.lab.frontier.choices import compute_choices, render_choices
from xihe_blender.lab.frontier.compute import N_COEFFICIENTS, ORDER, ChoiceBackend, Light, Walk, measure_compute
from xihe_blender.lab.frontier.pictures import OF_TRUTH, measure_pictures, picture_choices
from xihe_blender.lab.frontier.points import MeasuredScene, is_whole_scene, points_of
from xihe_blender.lab.frontier.records import (
    ComputeChoice,
    Frontier,
    FrontierPoint,
    FrontierScene,
    FrontierSettings,
    RenderChoice,
    StudySize,
)
from xihe_blender.lab.frontier.rendering import RenderStudy, SceneStudy, kept_capture, measure_rendering
from xihe_blender.lab.frontier.report import report_page
from xihe_blender.lab.frontier.timing import median_and_spread
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.files_read import files_read
from xihe_blender.previs.plan import PrevisPlan, check_is_rendered, plan_previs
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.sample_count import measure_sample_count, pilot_views
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import SceneSurvey, survey_path
from xihe_blender.report.document import write_document
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.state import scene_kept
from xihenet import __version__
from xihenet.camera_path.placement import evenly_chosen
from xihenet.effects import plan_effects
from xihenet.estimators.weights_format import weights_sha256

Result = TypeVar("Result")
COLUMNS = (
    "scene", "front", "error_kind", "label", "preset", "error", "error_spread", "time_ms", "spread_ms",
    "on_front", "front_share", "instead", "settings",
)  # fmt: skip

PROBE_NOISE = 0.02
"""Of the reference lights that estimates are held against, which are off by ten times as much."""

EXHAUSTIVE_OVER_PRESETS = 2
"""Samples of the exhaustive render over those of any preset, at least: `accurate` takes up to 256 in noisy rooms, whose
noise then makes its error a fifth too large; against 96 it would be nearly twice what it is."""

SHARES = {"preparing": 0.10, "walking": 0.15, "computing": 0.15, "rendering": 0.4, "pictures": 0.2}
"""About how long each part takes, for the time left."""


def frontier(files: Sequence[Path], out: Path, settings: FrontierSettings, command: str = "") -> Job[Frontier]:
    """Measure the .blend `files` one after the other and leave frontier.json, frontier.csv and report.html in `out`.

    Returns the content of frontier.json. UserError, before anything is measured, for a file that is none or a scene
    that cannot be run, for two files of one name, for a folder that holds something else, and for a seed out of range.
    """
    if not 0 <= settings.seed <= MAX_SEED:
        raise UserError(f"a seed of {settings.seed} is out of Cycles' range: give 0 to {MAX_SEED}")
    check_names_differ(files)
    patterns, devices = [], {}
    for file in files:
        scene = open_blend(file)
        devices[file.stem] = device_of(scene)
        with of_file(file):
            survey_scene(scene, settings.size)
        patterns += files_read()
        yield Progress(0, len(files), f"{file.stem}: looked at the scene")
    contents = {file: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    provenance = {
        "xihe": __version__,
        "blender": bpy.app.version_string,
        "scenes": {file.stem: content for file, content in contents.items()},
        "linked_sha256": contents_sha256(patterns),
        "settings": asdict(settings),
        "weights": weights_sha256({choice.estimator for choice in compute_choices(is_quick=False)}, "ldr"),
        # Times of two machines are not to be compared; a newer system on the same one is no other.
        "machine": {name: value for name, value in machine().items() if name != "platform"} | devices,
    }
    results = (out / "frontier.json", out / "report.html")
    with FolderManifest(out, out / "work" / "settings.json", "a frontier", provenance, results).held():
        return (yield from _measured(contents, out, settings, command))


def _measured(contents: Mapping[Path, str], out: Path, settings: FrontierSettings, command: str) -> Job[Frontier]:
    """`contents` are SHA-256 of the files: one may be saved anew while others are measured."""
    names, kept = [file.stem for file in contents], []
    for number, (file, content) in enumerate(contents.items()):
        if hashlib.sha256(file.read_bytes()).hexdigest() != content:
            raise UserError(f"{file} has changed meanwhile: put it back as it was, or choose another folder for --out")
        path = out / "work" / file.stem / "measured.json"
        job = part_of(len(contents), number, 1, measure_scene(file, path.parent, settings), file.stem)
        kept.append((yield from kept_or_done(MeasuredScene, path, job, functools.partial(is_whole_scene, file.stem))))
    points = [p for name, one in zip(names, kept, strict=True) for p in points_of(name, one.fronts, settings.seed)]
    found = Frontier(
        software=software(command),
        machine=machine(),
        settings=settings,
        scenes=tuple(one.scene for one in kept if one.scene is not None),
        answers=tuple(answers(names, points)),
        points=tuple(points),
    )
    # The report and the table first: frontier.json says that all is there.
    write_document(out / "report.html", report_page(found))
    write_csv(out / "frontier.csv", [_table_row(point) for point in points], COLUMNS)
    write_json(out / "frontier.json", as_json(found))
    yield Progress(1, 1, "measured and written")
    return found


def _table_row(point: FrontierPoint) -> Mapping[str, object]:
    """Settings other than the kind of error are JSON in the last column."""
    settings = {name: value for name, value in as_json(point.settings).items() if name != "error_kind"}
    return {**vars(point), "error_kind": point.kind, "settings": json.dumps(settings)}


@dataclass(frozen=True)
class Prepared:
    """What a run would settle before its first frame."""

    exposure: float
    light_transport: tuple[tuple[str, bool | int], ...]
    presets: dict[str, RenderChoice]


def is_whole(kept: Prepared) -> bool:
    samples = {name: choice.samples for name, choice in kept.presets.items()}
    return kept.exposure > 0 and samples.keys() == PRESETS.keys() and min(samples.values()) >= 1


def measure_scene(file: Path, folder: Path, settings: FrontierSettings) -> Job[MeasuredScene]:
    """All that is measured on the scene in `file`; work is kept in `folder`."""
    scene = open_blend(file)
    study = SceneStudy(scene, *survey_scene(scene, settings.size), folder, settings)
    study_size, size, done = study.study_size, study.plan.size, 0.0

    def share(name: str, job: Job[Result]) -> Job[Result]:
        nonlocal done
        result = yield from part_of(1, done, SHARES[name], job)
        done += SHARES[name]
        return result

    with scene_kept():
        preparing = kept_or_done(Prepared, folder / "prepared.json", prepare(study), is_whole)
        prepared = yield from share("preparing", preparing)
        presets, transport = prepared.presets, prepared.light_transport
        capture = RenderSettings(size, study_size.walk_samples, settings.seed, light_transport=transport)
        with open_scanner(scene, capture) as scanner:
            scanner.exposure = prepared.exposure
            walk = yield from share("walking", _walk(study, prepared, scanner))
            backends = {choice: ChoiceBackend(choice) for choice in compute_choices(is_quick=settings.is_quick)}
            rng = np.random.default_rng(settings.seed)
            computed = yield from share("computing", measure_compute(backends, walk, study_size.n_rounds, rng))
            seen = evenly_chosen(list(zip(walk.frames, walk.active, strict=True)), study_size.n_views)
            renders = RenderStudy(
                **vars(study),
                scanner=scanner,
                capture=capture,
                views={frame.frame: [walk.at(name, frame.frame) for name in names] for frame, names in seen},
                choices=render_choices(presets, size, study_size, is_quick=settings.is_quick),
                exhaustive=exhaustive_render(size, study_size, presets),
            )
            medians = [median_and_spread(one.times_ms)[0] for one in computed]
            computing_ms = dict(zip(backends, medians, strict=True))
            rendered, together = yield from share("rendering", measure_rendering(renders, computing_ms))
            job = measure_pictures(renders, walk, picture_choices(presets))
            pictured, of_estimators = yield from share("pictures", job)
    of_pictures = {label: {OF_TRUTH[0]: errors} for label, errors in of_estimators.items()}
    computed = [replace(one, square_errors=one.square_errors | of_pictures.get(one.label, {})) for one in computed]
    added = computing_ms[ComputeChoice()]
    with_computing = [replace(one, times_ms=tuple(ms + added for ms in one.times_ms)) for one in pictured]
    measured = FrontierScene(
        name=file.stem,
        exposure=prepared.exposure,
        size=size,
        n_walk_frames=len(walk.frames),
        n_places=walk.n_places,
        views=tuple(renders.views),
        presets=presets,
        exhaustive_samples=renders.exhaustive.samples,
    )
    yield Progress(done, 1, "measured")
    render, total = (*rendered, *pictured), (*together, *with_computing)
    return MeasuredScene(fronts={"render": render, "compute": tuple(computed), "total": total}, scene=measured)


def exhaustive_render(
    size: tuple[int, int], study_size: StudySize, presets: Mapping[str, RenderChoice]
) -> RenderChoice:
    """Of frames of `size`; no preset may be held against a render that is noisier than itself."""
    most = max(choice.samples for choice in presets.values())
    return RenderChoice(size, max(study_size.reference_samples, EXHAUSTIVE_OVER_PRESETS * most))


def prepare(study: SceneStudy) -> Job[Prepared]:
    """Measure it as a run does."""
    scene, plan = study.scene, study.plan
    step = Progress(0, 1, "metering the exposure, looking for effects")
    yield step
    exposure = yield from shown(meter_exposure(scene, plan.frames, study.settings.seed), step)
    effects = plan_effects(study.survey.required, overrides_in_force(scene, {}))
    transport, presets = cycles_settings(effects), {}
    for index, name in enumerate(PRESETS):
        settings = PrevisSettings(preset=name, seed=study.settings.seed)
        measuring = measure_sample_count(scene, plan, study.survey, settings, exposure, transport)
        count = yield from part_of(1 + len(PRESETS), 1 + index, 1, measuring, name)
        presets[name] = RenderChoice(plan.size, count.capture_samples)
    return Prepared(exposure, transport, presets)


def _walk(study: SceneStudy, prepared: Prepared, scanner: CyclesScanner) -> Job[Walk]:
    """Captures, and light probes at the positions in view, of frames spread over the path."""
    plan = study.plan
    at = {probe.name: probe for probe in plan.probes}
    positions = {name: probe.position_m for name, probe in at.items()}
    chosen = evenly_chosen(list(study.survey.in_view.items()), study.study_size.n_walk_frames)
    probes = ProbeSettings(
        max_samples=study.study_size.probe_samples, noise_target=PROBE_NOISE, seed=study.settings.seed,
        light_transport=prepared.light_transport, order=ORDER,
    )  # fmt: skip
    indices = {name: index for index, name in enumerate(positions)}
    frames, truths = [], []
    with open_reference_probe(study.scene, list(positions.values()), probes) as probe:

        def measured(frame: int, active: Sequence[str]) -> Job[dict[str, Light]]:
            lights = {}
            for done, name in enumerate(active):
                yield Progress(done, len(active), f"measuring the true light at {name} in frame {frame}")
                probe.move(indices[name], at[name].at(frame))
                lights[name] = probe.light_at(indices[name], frame, prepared.exposure).measured.ldr.tolist()
            return lights

        for index, (frame, active) in enumerate(chosen):
            yield Progress(index, len(chosen), f"capturing frame {frame}")
            path = study.folder / f"walk_{frame:04d}.exr"
            frames.append(kept_capture(path, scanner, frame, scanner.acquire_environment_scan))
            path = study.folder / f"probes_{frame:04d}.json"
            job = part_of(len(chosen), index, 1, measured(frame, active))
            lights = yield from kept_or_done(dict[str, Light], path, job, functools.partial(are_whole_truths, active))
            truths.append({name: np.array(light) for name, light in lights.items()})
    return Walk(frames, [active for _, active in chosen], positions, truths, prepared.exposure, study.survey.moved)


def are_whole_truths(names: Sequence[str], kept: Mapping[str, Light]) -> bool:
    """Whether a walk has the light, (25, 3), at each of the positions `names` of a frame, and no others."""
    return kept.keys() == set(names) and {np.shape(light) for light in kept.values()} <= {(N_COEFFICIENTS, 3)}


def survey_scene(scene: bpy.types.Scene, size: tuple[int, int] | None = None) -> tuple[PrevisPlan, SceneSurvey]:
    """What a run on `scene` would do, and what its path is like.

    UserError as a run raises it, and where no virtual object is ever in view.
    """
    check_is_rendered(scene)
    plan = plan_previs(scene, PrevisSettings(size=size))
    survey = run_blocking(survey_path(scene, plan))
    if not pilot_views(plan, survey):
        raise UserError(f"scene {scene.name!r} never has a virtual object in view: move the camera's path, or objects")
    return survey.followed(plan), survey
