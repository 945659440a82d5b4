"""How close does every trial's light come in the picture? One path-traced picture per frame, for all trials of a unit.

Each trial is a method of the comparison: a view layer per virtual object, which costs little beside the picture that
they are all held against. Pictures are kept of the worst frame of each trial only: a batch would otherwise leave
gigabytes that nobody looks at. A frame's numbers are written once all of its pictures are, so a stopped unit goes on.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from xihe_blender.compare.methods import Comparer, display, error_map, measure, open_comparer
from xihe_blender.io.outputs import write_json, write_picture
from xihe_blender.jobs import Progress
from xihe_blender.lab.batch.worst_pictures import WORST_KINDS, worst_frame, worst_picture
from xihe_blender.previs.compare_path import compared_frames
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import WalkedPath
from xihenet.recording import load_frame
from xihenet.records import ArrayF64

Light = Mapping[str, ArrayF64]
"""(9, 3) coefficients by virtual object."""


@dataclass(frozen=True, eq=False)
class ComparedUnit:
    """The metrics of each trial by frame, and the seconds that rendering all of them took."""

    by_trial: list[dict[int, dict[str, float | None]]]
    render_s: float


def compare_unit(runs: Sequence[PreparedRun], walks: Sequence[WalkedPath]) -> Generator[Progress, None, ComparedUnit]:
    """A job: every trial against the truth, at the frames that `xihe previs` would compare."""
    first = runs[0]
    wanted = [compared_frames(walked.frames, first.settings.effort.comparison_step) for walked in walks]
    frames = sorted(frozenset[int]().union(*wanted))
    by_trial: list[dict[int, dict[str, float | None]]] = [{} for _ in runs]
    render_s, n_frames = 0.0, len(first.plan.frames)
    sources: dict[tuple[Any, ...], int] = {}
    with contextlib.ExitStack() as stack:
        comparer = None
        for done, frame in enumerate(frames):
            yield Progress(
                n_frames + 3 * done, max(first.total, n_frames + 3 * len(frames)), f"comparing frame {frame}"
            )
            trials = [place for place, of_trial in enumerate(wanted) if frame in of_trial]
            lights = {str(place): _light(runs[place], walks[place], frame) for place in trials}
            source = sources.setdefault(_made_from(first, frame, lights), frame)
            file = first.outputs.compared(source)
            if not file.exists():
                if comparer is None:
                    methods = [str(place) for place in range(len(runs))]
                    opened = open_comparer(first.scene, first.plan.objects, methods, first.comparison)
                    comparer = stack.enter_context(opened)
                write_json(file, _compared(first, frame, lights, comparer, by_trial))
            content = json.loads(file.read_text(encoding="utf-8"))
            render_s += content["render_s"] if source == frame else 0.0
            for place in trials:
                by_trial[place][frame] = content["metrics"][str(place)]
    return ComparedUnit(by_trial, render_s)


def _light(run: PreparedRun, walked: WalkedPath, frame: int) -> Light:
    """What the objects are lit by in a trial."""
    return walked.lights[frame][run.settings.estimator]


def _made_from(run: PreparedRun, frame: int, lights: Mapping[str, Light]) -> tuple[Any, ...]:
    """Equal for frames whose comparisons are: scene, camera, capture and every trial's light are the same."""
    captured = load_frame(run.outputs.capture(frame))
    of_all = [light.tobytes() for of_trial in lights.values() for light in of_trial.values()]
    names = ",".join(lights).encode()
    return run.reuse.comparison(frame, captured.srgb_u8.tobytes(), captured.plane_depth_m.tobytes(), names, *of_all)


def _compared(
    run: PreparedRun,
    frame: int,
    lights: Mapping[str, Light],
    comparer: Comparer,
    so_far: Sequence[Mapping[int, Mapping[str, float | None]]],
) -> dict[str, Any]:
    """Metrics of each trial at `frame`; pictures are written of those that are worse than `so_far`."""
    dark = {item.name: np.zeros((9, 3)) for item in run.plan.objects}
    of_all = {method: lights.get(method, dark) for method, _ in comparer.worlds}
    compared = comparer.render_comparison(load_frame(run.outputs.capture(frame)), of_all)
    metrics = {}
    for trial in lights:
        picture = compared.methods[trial]
        metrics[trial] = measure(picture, compared.ground_truth, compared.weights)
        if worst_frame({**so_far[int(trial)], frame: metrics[trial]}) == frame:
            shown = (
                display(compared.ground_truth),
                display(picture),
                error_map(picture, compared.ground_truth, compared.weights),
            )
            for kind, pixels in zip(WORST_KINDS, shown, strict=True):
                write_picture(worst_picture(run.outputs.folder, int(trial), kind), pixels)
    return {"metrics": metrics, "render_s": compared.render_s}
