"""Error and time of each way to render, in a few frames of a path.

Each frame is rendered exhaustively once, then by every choice in turn, with a few seeds; each render is timed and its
light estimated, so that nothing is rendered for its time alone. Before a frame's first timed render comes a small one
that loads the scene. One thread: two would be timed as waiting for each other. The exhaustive render, which nobody
times, takes all.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.render import MAX_SEED
from xihe_blender.capture.scanner import CyclesScanner
from xihe_blender.io.json_records import as_json, from_json
from xihe_blender.io.outputs import write_json
from xihe_blender.lab.frontier.choices import EXHAUSTIVE, RenderCandidate
from xihe_blender.lab.frontier.compute import ChoiceBackend, light_of_frame, square_errors
from xihe_blender.lab.frontier.points import Measured
from xihe_blender.lab.frontier.records import ChoiceSettings, ComputeChoice, RenderChoice, StudySize
from xihe_blender.lab.frontier.steps import Steps, within
from xihe_blender.lab.frontier.timing import timed
from xihenet.recording import load_frame, save_frame
from xihenet.records import ArrayF64, RgbdFrame

COMPUTED_BY = (ComputeChoice(), ComputeChoice(n_anchors=512), ComputeChoice(n_anchors=2048))
"""Ways to compute that are combined with every render; the first is what a render alone is judged by."""


@dataclass(frozen=True, eq=False)
class View:
    """A frame of the path and the positions (3,) in view of it."""

    frame: int
    positions_m: Sequence[ArrayF64]


@dataclass(frozen=True, eq=False)
class RenderStudy:
    """What rendering is measured with.

    Parameters
    ----------
    scanner : of the scene, at the session's exposure
    views : where; at least one
    choices : the ways to render, and `exhaustive`, which all are held against
    study_size : see there
    seed : of the run
    folder : keeps what is rendered, so that a run that was stopped goes on
    """

    scanner: CyclesScanner
    views: Sequence[View]
    choices: Sequence[RenderCandidate]
    exhaustive: RenderChoice
    study_size: StudySize
    seed: int
    folder: Path

    def reference(self, view: View) -> Path:
        return self.folder / f"exhaustive_{view.frame:04d}.npz"

    def round(self, view: View, seed: int) -> Path:
        return self.folder / f"round_{view.frame:04d}_{seed}.json"


@dataclass(frozen=True)
class Taken:
    """One render: its milliseconds, and by way to compute the light at each position, (25, 3)."""

    ms: float
    lights: dict[str, tuple[tuple[tuple[float, float, float], ...], ...]]


Round = Mapping[str, Taken]
"""Every choice once, by its key."""


def measure_rendering(
    study: RenderStudy, computing_ms: Mapping[ComputeChoice, float], rng: np.random.Generator
) -> Steps[tuple[list[Measured], list[Measured]]]:
    """Ways to render alone, and together with ways to compute, whose milliseconds per frame are known."""
    backends = {choice: ChoiceBackend(choice) for choice in COMPUTED_BY}
    all_backends = {**backends, EXHAUSTIVE: ChoiceBackend(EXHAUSTIVE)}
    rounds: list[Round] = []
    truths: list[dict[ComputeChoice, list[ArrayF64]]] = []
    n_parts = len(study.views) * (1 + study.study_size.n_seeds)
    for number, view in enumerate(study.views):
        before = number * (1 + study.study_size.n_seeds)
        yield before / n_parts, f"rendering frame {view.frame} exhaustively"
        exhaustive = _kept_reference(study, view)
        truths += [_lights(all_backends, exhaustive, view, study.scanner.exposure)] * study.study_size.n_seeds
        for seed in range(study.study_size.n_seeds):
            if not study.round(view, seed).exists():
                taken = _render_round(study, view, seed, backends, rng)
                content = yield from within((before + 1 + seed) / n_parts, 1 / n_parts, taken)
                write_json(study.round(view, seed), as_json(content))
            kept = json.loads(study.round(view, seed).read_text(encoding="utf-8"))
            rounds.append({key: from_json(Taken, one) for key, one in kept.items()})
    alone = [_measured(choice, COMPUTED_BY[0], rounds, truths) for choice in study.choices]
    together = [
        _measured(choice, by, rounds, truths, computing_ms[by]) for choice in study.choices for by in COMPUTED_BY
    ]
    return alone, together


def _kept_reference(study: RenderStudy, view: View) -> RgbdFrame:
    path = study.reference(view)
    if not path.exists():
        study.scanner.move_to(view.frame)
        seed = (study.seed + study.study_size.n_seeds) % MAX_SEED
        path.parent.mkdir(parents=True, exist_ok=True)
        save_frame(path, rendered(study.scanner, study.exhaustive, seed, n_threads=0))
    return load_frame(path)


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
    study: RenderStudy, view: View, seed: int, backends: Mapping[ComputeChoice, ChoiceBackend], rng: np.random.Generator
) -> Steps[Round]:
    """Every choice once, by its key, in random order."""
    scanner, taken = study.scanner, dict[str, Taken]()
    scanner.move_to(view.frame)
    rendered(scanner, RenderChoice((16, 16), 1, is_denoised=False), seed)
    choices = [candidate.choice for candidate in study.choices]
    costs = np.array([choice.samples * choice.size[0] * choice.size[1] for choice in choices], float)
    done = 0.0
    for number in rng.permutation(len(choices)):
        yield done, f"rendering frame {view.frame}: {choices[number].label}"
        frame, ms = timed(rendered, scanner, choices[number], (study.seed + seed) % MAX_SEED)
        lights = _lights(backends, frame, view, scanner.exposure)
        taken[study.choices[number].key] = Taken(ms, {by.label: np.array(lights[by]).tolist() for by in COMPUTED_BY})
        done += costs[number] / costs.sum()
    return taken


def _lights(
    backends: Mapping[ComputeChoice, ChoiceBackend], frame: RgbdFrame, view: View, exposure: float
) -> dict[ComputeChoice, list[ArrayF64]]:
    return {
        by: [light_of_frame(by, backend, frame, position, exposure) for position in view.positions_m]
        for by, backend in backends.items()
    }


def _measured(
    candidate: RenderCandidate,
    by: ComputeChoice,
    rounds: Sequence[Round],
    truths: Sequence[Mapping[ComputeChoice, list[ArrayF64]]],
    computing_ms: float | None = None,
) -> Measured:
    """Together with computing, where its time is given; else alone, against the exhaustive render computed alike."""
    is_alone, is_base = computing_ms is None, by == COMPUTED_BY[0]
    taken = [one[candidate.key] for one in rounds]
    lights = [np.array(light) for one in taken for light in one.lights[by.label]]
    errors = square_errors(lights, [light for truth in truths for light in truth[by if is_alone else EXHAUSTIVE]])
    times_ms = tuple(one.ms + (computing_ms or 0.0) for one in taken)
    words = candidate.choice.label if is_base else f"{candidate.choice.label}, {by.label}"
    settings = ChoiceSettings(rendering=candidate.choice, computing=None if is_alone else by)
    return Measured(words, settings, errors, times_ms, candidate.preset if is_base else None)
