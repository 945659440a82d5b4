"""Error and time of the final picture: by preset, by samples, and by what objects are lit with.

A picture costs several renders, so only a few choices are measured: the presets, other numbers of samples for the
comparison at the base's capture, and the base with a key light and its shadow, and with reflections besides. What is
timed is all that a run does for a frame: its capture, the light, and both pictures. The light is all of it (HDR), as in
a run by default, and what a session has in use that came along the walk and estimates in every frame.

Two kinds of error are root mean squares of the displayed, sRGB-encoded colour inside the objects. "picture" is what
saving samples adds: both pictures that a comparison makes, the objects under the estimated light and the path-traced
ground truth, each against its exhaustive self; for spherical harmonics alone. "picture_truth" is how far the objects
are off the exhaustive ground truth, for all choices and for estimators; "ring_truth" the same in the ring around them,
where the shadow is, in linear colour.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from xihe_blender.compare.methods import Comparer, Comparison, display, open_comparer
from xihe_blender.compare.shadows import ring_rmse
from xihe_blender.io.kept_files import kept_or_done
from xihe_blender.jobs import Job, Progress, part_of
from xihe_blender.lab.frontier.choices import RenderCandidate
from xihe_blender.lab.frontier.compute import AGAINST_TRUTH, Walk
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice, RenderChoice
from xihe_blender.lab.frontier.rendering import RenderStudy, rendered, use_threads
from xihe_blender.lab.frontier.timing import timed
from xihe_blender.previs.compare_path import MOST_SEEN
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.settings import PREVIS_TRIGGER, PrevisSettings
from xihenet import estimators
from xihenet.camera_path.placement import evenly_chosen
from xihenet.light import LightParts
from xihenet.metrics import image_rmse
from xihenet.phone.session import PhoneSession
from xihenet.records import ArrayF64, ObjectLight, RgbdFrame

METHODS = tuple(ComputeChoice(estimator=name) for name in ("lattice", "projection", "ambient"))
LADDER = (2, 8, 64)
LIGHTS: tuple[LightParts, ...] = get_args(LightParts)
PICTURE = "picture"
OF_TRUTH = (PICTURE + AGAINST_TRUTH, "ring" + AGAINST_TRUTH)


@dataclass(frozen=True)
class PictureTaken:
    """A choice at a view: its milliseconds, and its squared errors by kind."""

    ms: float
    square_errors: dict[str, float]


@dataclass(frozen=True)
class PicturesTaken:
    """All choices at a view, by key, and by estimator the squared error of its picture."""

    choices: dict[str, PictureTaken]
    estimators: dict[str, float]


def picture_choices(presets: Mapping[str, RenderChoice]) -> list[RenderCandidate]:
    """The presets; a ladder of samples for the pictures alone; and more than spherical harmonics."""
    own = [RenderCandidate(choice, name, PRESETS[name].comparison_samples, "sh") for name, choice in presets.items()]
    base, base_samples = presets["balanced"], PRESETS["balanced"].comparison_samples
    ladder = [RenderCandidate(base, None, n, "sh") for n in LADDER if n != base_samples]
    lights = [RenderCandidate(base, None, base_samples, light) for light in LIGHTS if light != "sh"]
    return [*own, *ladder, *lights]


def measure_pictures(
    study: RenderStudy, walk: Walk, choices: Sequence[RenderCandidate]
) -> Job[tuple[list[Measured], dict[str, tuple[float, ...]]]]:
    """The choices, and by estimator the squared errors of its pictures at the views."""
    rounds: list[PicturesTaken] = []
    frames = list(study.views)[: study.study_size.n_picture_views]
    for number, frame in enumerate(frames):
        path = study.folder / f"pictures_{frame:04d}.json"
        job = part_of(len(frames), number, 1, _view_measured(study, walk, choices, frame))
        rounds.append((yield from kept_or_done(PicturesTaken, path, job, functools.partial(are_whole, choices))))
    if not rounds:
        return [], {}
    measured = []
    for choice in choices:
        taken = [one.choices[choice.key] for one in rounds]
        settings = ChoiceSettings(rendering=choice.choice, picture_samples=choice.picture_samples, light=choice.light)
        errors = {kind: tuple(one.square_errors[kind] for one in taken) for kind in error_kinds(choice)}
        measured.append(Measured(choice.label, settings, errors, tuple(one.ms for one in taken), choice.preset))
    return measured, {by.label: tuple(one.estimators[by.label] for one in rounds) for by in METHODS}


def are_whole(choices: Sequence[RenderCandidate], kept: PicturesTaken) -> bool:
    """Whether times and squared errors, of 0 or more, of all `choices` and estimators are there, and no others."""
    kinds = {key: one.square_errors.keys() for key, one in kept.choices.items()}
    figures = [figure for one in kept.choices.values() for figure in (one.ms, *one.square_errors.values())]
    return (
        kinds == {choice.key: set(error_kinds(choice)) for choice in choices}
        and kept.estimators.keys() == {by.label for by in METHODS}
        and min([*figures, *kept.estimators.values()]) >= 0
    )


def error_kinds(choice: RenderCandidate) -> tuple[str, ...]:
    """Light that has more parts saves nothing, so it is held against the truth alone."""
    return (PICTURE, *OF_TRUTH) if choice.light == "sh" else OF_TRUTH


def _view_measured(
    study: RenderStudy, walk: Walk, choices: Sequence[RenderCandidate], frame: int
) -> Job[PicturesTaken]:
    yield Progress(0, 1, f"comparing frame {frame} exhaustively")
    captured = study.reference(frame)
    study.scanner.move_to(frame)
    study.load_scene(study.settings.seed)
    rng = np.random.default_rng([study.settings.seed, frame])
    lights = {by.label: Session(study, walk, frame, by.estimator).lights_after(captured) for by in METHODS}
    comparison = replace(study.capture, samples=1)
    # Of the user's scene: in the scanner's there are no virtual objects.
    with open_comparer(study.scene, study.plan.objects, list(lights), comparison) as comparer:
        # With all methods, on all cores, by another seed.
        _set_up(comparer, study.exhaustive.samples, study.exhaustive_seed, n_threads=0)
        truth = comparer.render_comparison(captured, lights)
    of_estimators = {by: _square_rmse(truth.methods[by], truth.ground_truth, truth.weights) for by in lights}
    taken: dict[str, PictureTaken] = {}
    base = METHODS[0].label
    for has_key_light in (False, True):
        own = [choice for choice in choices if (choice.light != "sh") == has_key_light]
        with open_comparer(
            study.scene, study.plan.objects, [base], comparison, has_key_light=has_key_light
        ) as comparer:
            _set_up(comparer, max(choice.picture_samples or 1 for choice in own), study.settings.seed)
            comparer.render_comparison(captured, {base: lights[base]})
            for number in rng.permutation(len(own)):
                choice = own[number]
                share = 0.4 + 0.6 * len(taken) / len(choices)
                yield Progress(share, 1, f"comparing frame {frame}: {choice.label}")
                session = Session(study, walk, frame, METHODS[0].estimator, choice.light or "sh")
                made, ms = timed(_made, study, choice, comparer, session)
                errors = _square_errors(made, truth, base)
                taken[choice.key] = PictureTaken(ms, {kind: errors[kind] for kind in error_kinds(choice)})
    return PicturesTaken(taken, of_estimators)


class Session:
    """A phone that came along the walk and is now at the place of `frame`, which it has not captured yet."""

    def __init__(self, study: RenderStudy, walk: Walk, frame: int, estimator: str, light: LightParts = "sh") -> None:
        settings = PrevisSettings(seed=study.settings.seed, light=light, trigger=PREVIS_TRIGGER.scaled(0))
        self.plan = study.plan
        of_choice = estimators.load(estimator, settings.n_anchors, settings.target)
        self.chain = PhoneSession(study.plan.probes, settings.chain(walk.exposure), of_choice, None, seed=settings.seed)
        self.seen: list[RgbdFrame] = []
        for captured, active in zip(walk.frames, walk.active, strict=True):
            if captured.frame < frame:
                self._step(captured, active)
            elif captured.frame == frame:
                self.active = active

    def lights_after(self, captured: RgbdFrame) -> dict[str, ObjectLight]:
        """The light in use of every virtual object once it has seen `captured`, too."""
        self._step(captured, self.active)
        lights = {}
        for item in self.plan.objects:
            names = [probe.name for probe in self.plan.probes_of(item.name)]
            lights[item.name] = self.chain.object_light(names, captured.time_s)
        return lights

    def _step(self, captured: RgbdFrame, active: Iterable[str]) -> None:
        self.seen.append(captured)
        self.chain.step(captured, {}, list(active))


def _made(study: RenderStudy, choice: RenderCandidate, comparer: Comparer, session: Session) -> Comparison:
    """All that a run does for one frame: the capture, its light, both pictures."""
    captured = rendered(study.scanner, choice.choice, study.settings.seed)
    assert choice.picture_samples is not None
    _set_up(comparer, choice.picture_samples, study.settings.seed)
    lights = {METHODS[0].label: session.lights_after(captured)}
    surfaces = comparer.surfaces_around_objects(evenly_chosen(session.seen, MOST_SEEN), captured.frame)
    return comparer.render_methods(captured, lights, comparer.render_ground_truth(captured.frame), surfaces)


def _set_up(comparer: Comparer, samples: int, seed: int, *, n_threads: int = 1) -> None:
    for scene in (comparer.ground_truth, comparer.lit):
        scene.cycles.samples, scene.cycles.seed = samples, seed
        use_threads(scene, n_threads)


def _square_errors(made: Comparison, truth: Comparison, method: str) -> dict[str, float]:
    """By kind, of the picture of `method`; `truth` is exhaustive."""
    picture, weights = made.methods[method], truth.weights
    saved = [
        _square_rmse(picture, truth.methods[method], weights),
        _square_rmse(made.ground_truth, truth.ground_truth, weights),
    ]
    around = (ring_rmse(picture, truth.ground_truth, truth.ring) or 0.0) ** 2
    of_truth = _square_rmse(picture, truth.ground_truth, weights), around
    return {PICTURE: float(np.mean(saved)), **dict(zip(OF_TRUTH, of_truth, strict=True))}


def _square_rmse(picture: ArrayF64, truth: ArrayF64, weights: ArrayF64) -> float:
    return (image_rmse(display(picture), display(truth), weights) or 0.0) ** 2
