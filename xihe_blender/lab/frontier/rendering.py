"""Error and time of each way to render, in a few frames of a path.

Each frame is rendered exhaustively once, then by every choice in turn, with a few seeds; each render is timed and its
light estimated, so that nothing is rendered for its time alone. Before a frame's first timed render comes a small one
that loads the scene. One thread: two would be timed as waiting for each other. The exhaustive render, which nobody
times, takes all.

Cycles lays out the noise of a kept scene for the most samples that it has rendered it with so far, never again for
fewer. The small render has as many as any other, so that no render depends on those before it.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.render import MAX_SEED, RenderSettings
from xihe_blender.capture.scanner import CyclesScanner
from xihe_blender.io.kept_files import kept_or_done, read_kept
from xihe_blender.jobs import Job, Progress, part_of
from xihe_blender.lab.frontier.choices import EXHAUSTIVE, FULL, QUICK, RenderCandidate
from xihe_blender.lab.frontier.compute import N_COEFFICIENTS, ChoiceBackend, Light, light_of_frame, square_errors
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice, FrontierSettings, RenderChoice, StudySize
from xihe_blender.lab.frontier.timing import timed
from xihe_blender.previs.plan import PrevisPlan
from xihe_blender.previs.survey import SceneSurvey
from xihenet.io.recording import load_frame, save_frame
from xihenet.records import ArrayF64, RgbdFrame

COMPUTED_BY = (ComputeChoice(), ComputeChoice(n_anchors=512), ComputeChoice(n_anchors=2048))
"""Ways to compute that are combined with every render; the first is what a render alone is judged by."""


@dataclass(frozen=True, eq=False)
class SceneStudy:
    """One scene to measure: the open scene, its plan, the survey of its path, and where its work is kept."""

    scene: bpy.types.Scene
    plan: PrevisPlan
    survey: SceneSurvey
    folder: Path
    settings: FrontierSettings

    @property
    def study_size(self) -> StudySize:
        return self.settings.study_size or (QUICK if self.settings.is_quick else FULL)


@dataclass(frozen=True, eq=False)
class RenderStudy(SceneStudy):
    """What rendering is measured with: a scanner at the session's exposure, which captures as `capture` says.

    `views` are frames of a captured walk, at least one, with the positions (3,) in view of each; all choices are
    held against `exhaustive`.
    """

    scanner: CyclesScanner
    capture: RenderSettings
    views: Mapping[int, Sequence[ArrayF64]]
    choices: Sequence[RenderCandidate]
    exhaustive: RenderChoice

    @property
    def exhaustive_seed(self) -> int:
        """One that no other render has."""
        return (self.settings.seed + self.study_size.n_seeds) % MAX_SEED

    def load_scene(self, seed: int) -> None:
        """Have the scanner's scene loaded, and its noise laid out for the most samples."""
        samples = max(self.capture.samples, *(one.choice.samples for one in self.choices), self.exhaustive.samples)
        rendered(self.scanner, RenderChoice((16, 16), samples, is_denoised=False), seed)

    def reference(self, frame: int) -> RgbdFrame:
        """The exhaustive render, made where it is not kept."""

        def render() -> RgbdFrame:
            self.load_scene(self.exhaustive_seed)
            return rendered(self.scanner, self.exhaustive, self.exhaustive_seed, n_threads=0)

        return kept_capture(self.folder / f"exhaustive_{frame:04d}.exr", self.scanner, frame, render)


@dataclass(frozen=True)
class Taken:
    """One render: its milliseconds, and by way to compute the light at each position, (25, 3)."""

    ms: float
    lights: dict[str, tuple[Light, ...]]


Round = dict[str, Taken]
"""Every choice once, by its key."""

LightsBy = Mapping[ComputeChoice, Sequence[ArrayF64]]
"""The light at each position, by way to compute."""


def kept_capture(path: Path, scanner: CyclesScanner, frame: int, render: Callable[[], RgbdFrame]) -> RgbdFrame:
    """The capture in the file; what `render` gives at `frame`, to which `scanner` goes, if there is none."""
    kept = read_kept(path, load_frame)
    if kept is None:
        scanner.move_to(frame)
        path.parent.mkdir(parents=True, exist_ok=True)
        save_frame(path, render())
        kept = load_frame(path)
    return kept


def measure_rendering(
    study: RenderStudy, computing_ms: Mapping[ComputeChoice, float]
) -> Job[tuple[list[Measured], list[Measured]]]:
    """Ways to render alone, and together with ways to compute, whose milliseconds per frame are known."""
    backends = {choice: ChoiceBackend(choice) for choice in COMPUTED_BY}
    all_backends = {**backends, EXHAUSTIVE: ChoiceBackend(EXHAUSTIVE)}
    rounds: list[tuple[Round, LightsBy]] = []
    n_seeds = study.study_size.n_seeds
    n_parts = len(study.views) * (1 + n_seeds)
    for number, (frame, positions_m) in enumerate(study.views.items()):
        before = number * (1 + n_seeds)
        yield Progress(before, n_parts, f"rendering frame {frame} exhaustively")
        truth = _lights(all_backends, study.reference(frame), positions_m)
        is_whole = functools.partial(is_whole_round, study.choices, len(positions_m))
        for seed in range(n_seeds):
            job = part_of(n_parts, before + 1 + seed, 1, _render_round(study, frame, seed, backends))
            path = study.folder / f"round_{frame:04d}_{seed}.json"
            rounds.append(((yield from kept_or_done(Round, path, job, is_whole)), truth))
    alone = [_measured(choice, COMPUTED_BY[0], rounds) for choice in study.choices]
    together = [_measured(choice, by, rounds, computing_ms[by]) for choice in study.choices for by in COMPUTED_BY]
    return alone, together


def is_whole_round(choices: Sequence[RenderCandidate], n_positions: int, kept: Round) -> bool:
    """Whether a round has the light at each position for all `choices`, and no others."""
    shapes = {np.shape(one.lights[by.label]) for one in kept.values() for by in COMPUTED_BY}
    are_all = kept.keys() == {choice.key for choice in choices} and shapes == {(n_positions, N_COEFFICIENTS, 3)}
    return are_all and min(one.ms for one in kept.values()) >= 0


def rendered(scanner: CyclesScanner, choice: RenderChoice, seed: int, *, n_threads: int = 1) -> RgbdFrame:
    """One capture as `choice` says at the scanner's frame; 0 threads take all cores."""
    scene = scanner.scene
    use_threads(scene, n_threads)
    scene.render.resolution_x, scene.render.resolution_y = choice.size
    cycles = scene.cycles
    cycles.samples, cycles.seed = choice.samples, seed
    before = {name: getattr(cycles, name) for name in (*BOUNCES, "use_denoising")}
    try:
        cycles.use_denoising = choice.is_denoised and before["use_denoising"]
        if choice.max_bounces is not None:
            for name in BOUNCES:
                setattr(cycles, name, min(before[name], choice.max_bounces))
        return scanner.acquire_environment_scan()
    finally:
        for name, value in before.items():
            setattr(cycles, name, value)


BOUNCES = ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces")


def use_threads(scene: bpy.types.Scene, n_threads: int) -> None:
    """Have `scene` rendered on so many threads; 0 takes all cores."""
    scene.render.threads_mode = "FIXED" if n_threads else "AUTO"
    if n_threads:
        scene.render.threads = n_threads


def _render_round(
    study: RenderStudy, frame: int, seed: int, backends: Mapping[ComputeChoice, ChoiceBackend]
) -> Job[Round]:
    """In random order."""
    scanner, taken = study.scanner, dict[str, Taken]()
    scanner.move_to(frame)
    study.load_scene(seed)
    rng = np.random.default_rng([study.settings.seed, frame, seed])
    choices = [candidate.choice for candidate in study.choices]
    costs = np.array([choice.samples * choice.size[0] * choice.size[1] for choice in choices], float)
    done = 0.0
    for number in rng.permutation(len(choices)):
        yield Progress(done, 1, f"rendering frame {frame}: {choices[number].label}")
        captured, ms = timed(rendered, scanner, choices[number], (study.settings.seed + seed) % MAX_SEED)
        lights = _lights(backends, captured, study.views[frame])
        taken[study.choices[number].key] = Taken(ms, {by.label: np.array(lights[by]).tolist() for by in COMPUTED_BY})
        done += costs[number] / costs.sum()
    return taken


def _lights(
    backends: Mapping[ComputeChoice, ChoiceBackend], captured: RgbdFrame, positions_m: Sequence[ArrayF64]
) -> LightsBy:
    return {
        by: [light_of_frame(backend, captured, position_m) for position_m in positions_m]
        for by, backend in backends.items()
    }


def _measured(
    candidate: RenderCandidate,
    by: ComputeChoice,
    rounds: Sequence[tuple[Round, LightsBy]],
    computing_ms: float | None = None,
) -> Measured:
    """Together with computing, where its time is given; else alone, against the exhaustive render computed alike."""
    is_alone, is_base = computing_ms is None, by == COMPUTED_BY[0]
    taken = [one[candidate.key] for one, _ in rounds]
    lights = [np.array(light) for one in taken for light in one.lights[by.label]]
    errors = square_errors(lights, [light for _, truth in rounds for light in truth[by if is_alone else EXHAUSTIVE]])
    times_ms = tuple(one.ms + (computing_ms or 0.0) for one in taken)
    words = candidate.label if is_base else f"{candidate.label}, {by.label}"
    settings = ChoiceSettings(rendering=candidate.choice, computing=None if is_alone else by)
    return Measured(words, settings, errors, times_ms, candidate.preset if is_base else None)
