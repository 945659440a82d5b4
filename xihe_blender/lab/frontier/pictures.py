"""Error and time of each choice in the final picture.

A picture costs several renders, so only a few choices are measured: the presets, and other numbers of samples for the
comparison at the base's capture. The error of a choice is that of both pictures a comparison makes, the objects under
the estimated light and the path-traced ground truth they are held against, each against its exhaustive self: root mean
square of the displayed, sRGB-encoded colour inside the objects. Estimators are held against the exhaustive ground truth
("picture_truth").
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.compare.methods import Comparer, Comparison, display, open_comparer
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import write_json
from xihe_blender.lab.frontier.choices import RenderCandidate
from xihe_blender.lab.frontier.compute import ChoiceBackend, light_of_frame
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice, RenderChoice
from xihe_blender.lab.frontier.rendering import RenderStudy, View, rendered, use_threads
from xihe_blender.lab.frontier.steps import Steps, within
from xihe_blender.lab.frontier.timing import timed
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.settings import PRESETS
from xihenet.metrics import image_rmse
from xihenet.recording import load_frame
from xihenet.records import ArrayF64, RgbdFrame

METHODS = tuple(ComputeChoice(estimator=name) for name in ("lattice", "projection", "ambient"))
LADDER = (2, 8, 64)


@dataclass(frozen=True)
class PictureChoice:
    """A capture, and samples per pixel of the pictures of the comparison."""

    capture: RenderCandidate
    samples: int

    @property
    def label(self) -> str:
        return f"capture {self.capture.choice.label}; pictures {self.samples} samples"

    @property
    def key(self) -> str:
        return f"{self.capture.preset}: {self.label}"


@dataclass(frozen=True)
class PictureTaken:
    """A choice at a view: its milliseconds, and the mean of both pictures' squared errors."""

    ms: float
    square_error: float


@dataclass(frozen=True)
class PicturesTaken:
    """All choices at a view, by key, and by estimator the squared error of its picture."""

    choices: dict[str, PictureTaken]
    estimators: dict[str, float]


def picture_choices(presets: Mapping[str, RenderChoice]) -> list[PictureChoice]:
    """The presets, and a ladder of samples for the pictures alone."""
    own = [PictureChoice(RenderCandidate(one, name), PRESETS[name].comparison_samples) for name, one in presets.items()]
    others = [n for n in LADDER if n != PRESETS["balanced"].comparison_samples]
    return [*own, *(PictureChoice(RenderCandidate(presets["balanced"]), n) for n in others)]


@dataclass(frozen=True, eq=False)
class PictureStudy:
    """What pictures are measured with; `settings` are those of a comparison, with the scene's light transport."""

    renders: RenderStudy
    plan: PrevisPlan
    settings: RenderSettings
    choices: Sequence[PictureChoice]


def measure_pictures(
    study: PictureStudy, rng: np.random.Generator
) -> Steps[tuple[list[Measured], dict[str, tuple[float, ...]]]]:
    """The choices, and by estimator the squared errors of its pictures at the views."""
    rounds: list[PicturesTaken] = []
    views = study.renders.views[: study.renders.study_size.n_picture_views]
    for number, view in enumerate(views):
        path = study.renders.folder / f"pictures_{view.frame:04d}.json"
        if not path.exists():
            taken = yield from within(number / len(views), 1 / len(views), _view_measured(study, view, rng))
            write_json(path, as_json(taken))
        rounds.append(from_json(PicturesTaken, json.loads(path.read_text(encoding="utf-8"))))
    if not rounds:
        return [], {}
    measured = [
        Measured(
            choice.label,
            ChoiceSettings(rendering=choice.capture.choice, picture_samples=choice.samples),
            {"picture": tuple(one.choices[choice.key].square_error for one in rounds)},
            tuple(one.choices[choice.key].ms for one in rounds),
            choice.capture.preset,
        )
        for choice in study.choices
    ]
    return measured, {by.label: tuple(one.estimators[by.label] for one in rounds) for by in METHODS}


def _view_measured(study: PictureStudy, view: View, rng: np.random.Generator) -> Steps[PicturesTaken]:
    renders = study.renders
    yield 0.0, f"comparing frame {view.frame} exhaustively"
    renders.scanner.move_to(view.frame)
    captured = load_frame(renders.reference(view))
    lights = {by.label: _lights_of_objects(study, by, captured) for by in METHODS}
    with open_comparer(renders.scanner.scene, study.plan.objects, list(lights), study.settings) as comparer:
        # With all methods, on all cores, by another seed.
        seed = (renders.seed + renders.study_size.n_seeds) % MAX_SEED
        _set_up(comparer, renders.exhaustive.samples, seed, n_threads=0)
        truth = comparer.render_comparison(captured, lights)
    of_estimators = {
        by.label: _square_rmse(truth.methods[by.label], truth.ground_truth, truth.weights) for by in METHODS
    }
    taken: dict[str, PictureTaken] = {}
    base = METHODS[0].label
    with open_comparer(renders.scanner.scene, study.plan.objects, [base], study.settings) as comparer:
        _set_up(comparer, 1, renders.seed)
        comparer.render_comparison(captured, {base: lights[base]})
        for number in rng.permutation(len(study.choices)):
            choice = study.choices[number]
            yield 0.4 + 0.6 * len(taken) / len(study.choices), f"comparing frame {view.frame}: {choice.label}"
            made, ms = timed(_made, study, choice, comparer)
            squares = [
                _square_rmse(made.methods[base], truth.methods[base], truth.weights),
                _square_rmse(made.ground_truth, truth.ground_truth, truth.weights),
            ]
            taken[choice.key] = PictureTaken(ms, float(np.mean(squares)))
    return PicturesTaken(taken, of_estimators)


def _made(study: PictureStudy, choice: PictureChoice, comparer: Comparer) -> Comparison:
    """All that a run does for one frame: the capture, its light, both pictures."""
    captured = rendered(study.renders.scanner, choice.capture.choice, study.renders.seed)
    _set_up(comparer, choice.samples, study.renders.seed)
    base = METHODS[0]
    return comparer.render_comparison(captured, {base.label: _lights_of_objects(study, base, captured)})


def _set_up(comparer: Comparer, samples: int, seed: int, *, n_threads: int = 1) -> None:
    for scene in (comparer.ground_truth, comparer.lit):
        scene.cycles.samples, scene.cycles.seed = samples, seed
        use_threads(scene, n_threads)


def _lights_of_objects(study: PictureStudy, by: ComputeChoice, captured: RgbdFrame) -> dict[str, ArrayF64]:
    """(9, 3) by virtual object: the mean over its positions, from this frame alone."""
    backend, exposure = ChoiceBackend(by), study.renders.scanner.exposure

    def light_of(name: str) -> ArrayF64:
        positions_m = [probe.position_m for probe in study.plan.probes_of(name)]
        lights = [light_of_frame(by, backend, captured, position_m, exposure)[:9] for position_m in positions_m]
        mean: ArrayF64 = np.mean(lights, axis=0)
        return mean

    return {item.name: light_of(item.name) for item in study.plan.objects}


def _square_rmse(picture: ArrayF64, truth: ArrayF64, weights: ArrayF64) -> float:
    return (image_rmse(display(picture), display(truth), weights) or 0.0) ** 2
