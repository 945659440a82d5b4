"""A captured path: the camera path of a scene, rendered once without virtual objects, as the session of a phone.

What asks about light at many places, or about other views, needs this and no ground truth. The captures are kept in the
folder and taken up again there, for the same scene and settings, whatever is asked of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.reference_probe import MeasuredLight, open_reference_probe
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Parameters, as_json
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.io.provenance import machine, software
from xihe_blender.jobs import Job, Progress, shown
from xihe_blender.previs.kept_session import KeptSession, kept_session
from xihe_blender.previs.plan import (
    PrevisPlan,
    captured_size,
    check_is_rendered,
    check_nothing_is_missing,
    made_of,
    planned_frames,
)
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import run_chain
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihenet.records import ArrayF64


@dataclass(frozen=True, eq=False)
class CapturedPath:
    """The prepared run, and the session of its phone."""

    run: PreparedRun
    session: KeptSession

    @property
    def frames(self) -> tuple[int, ...]:
        return tuple(one.seen.frame for one in self.session.frames)


def path_facts(run: PreparedRun, blend_file: Path, command: str, asked: Parameters) -> dict[str, Any]:
    """The fields of `PathResults`, with what was `asked` among the settings."""
    names = ("estimator", "target", "preset", "samples", "seed", "phone", "network", "n_anchors")
    chosen = {name: getattr(run.settings, name) for name in names}
    return {
        "software": software(command),
        "machine": {**machine()},
        "scene": blend_file.name,
        "settings": {**chosen, "size": run.plan.size, **asked},
        "frames": tuple(sorted(run.needs.captured)),
        "exposure": run.exposure,
        "notes": tuple(fault.said for fault in run.survey.faults),
    }


def path_plan(scene: bpy.types.Scene, settings: PrevisSettings) -> tuple[PrevisSettings, PrevisPlan]:
    """`settings` with the samples of the preset, and the plan of the path alone. UserError as of `plan_previs`."""
    check_nothing_is_missing(scene)
    check_is_rendered(scene)
    samples = settings.samples or settings.preset_values.path_samples
    settings = replace(settings, captured="path", samples=samples, light="sh")
    frames = tuple(planned_frames(scene, settings.frames))
    return settings, PrevisPlan(frames, captured_size(scene, settings), (), ())


def capture_path(
    scene: bpy.types.Scene, out: Path, settings: PrevisSettings, work: str, held: contextlib.ExitStack, *,
    blend_file: Path,
) -> Job[CapturedPath]:  # fmt: skip
    """A job: capture the path of `scene` in the folder `out`, which then is of this kind of `work` alone.

    Nobody else can work in the folder until `held` is closed.
    Renders change animated values in the scene: see `scene_kept`. UserError for a scene without a camera.
    """
    settings, plan = path_plan(scene, settings)
    outputs, loaded = RunOutputs(out, blend_file.stem), load_estimators(settings)
    content = made_of(work, scene, blend_file, settings, plan)
    manifest = FolderManifest(out, outputs.settings, work, content, (out / "report.html",))
    manifest.check()
    survey = yield from survey_run(scene, plan, outputs)
    held.enter_context(manifest.held())
    run = yield from prepare_run(scene, plan, survey, outputs, settings, loaded)
    yield from run_chain(run, keeps_session=True)
    session = yield from kept_session(outputs, run.settings, run.exposure, sorted(run.needs.captured))
    return CapturedPath(run, session)


def measured_lights(run: PreparedRun, positions_m: Sequence[ArrayLike]) -> Job[list[ArrayF64]]:
    """A job: (9, 3) of a light probe at each of the positions (3,) in the last frame; probes are kept."""
    frame, lights = run.plan.frames[-1], []
    places_m = [np.asarray(position_m, np.float64) for position_m in positions_m]
    with open_reference_probe(run.scene, places_m, run.reference) as probe:
        for index, place_m in enumerate(places_m):
            doing = f"rendering light probe {index + 1} of {len(places_m)}"
            progress = Progress(index, len(places_m), doing, {"light probes": len(places_m) - index})
            yield progress
            path = run.outputs.reference(0, "-".join(f"{c:.3f}" for c in place_m), frame)
            light = kept_record(MeasuredLight, path)
            if light is None:
                steps = probe.light_by_steps(index, frame, run.exposure)
                light = (yield from shown(steps, progress)).measured
                write_json(path, as_json(light))
            lights.append(light.of(run.settings.target))
    return lights
