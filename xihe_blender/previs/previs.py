"""The main job: what would a phone on this camera path believe about the light, and how would its objects look?

    camera path -> capture -> unproject -> sample -> merge -> trigger -> encode -> estimate -> apply -> compare

What was rendered is kept in the run's folder, file by file. A run that was stopped goes on from there; the cheap stages
are simply done again, so a resumed run has the numbers of an undisturbed one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bpy

from xihe_blender.apply.lit_timeline import apply_lights
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Json, as_json
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.io.run_lights import last_surfaces
from xihe_blender.io.run_results import FrameResult, LightChange, RunResults
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs import results
from xihe_blender.previs.compare_path import compare_path, composite_path
from xihe_blender.previs.kept_session import kept_facts
from xihe_blender.previs.lit_blend import save_lit_blend
from xihe_blender.previs.phone_errors import measure_phone
from xihe_blender.previs.plan import made_of, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.recorded_run import prepare_recorded, recorded_session
from xihe_blender.previs.run_chain import ChainResult, run_chain
from xihe_blender.previs.settings import PrevisSettings, close_backends, load_estimators
from xihe_blender.report.page import write_report
from xihe_blender.scene.state import scene_kept
from xihenet.estimators.weights_format import weights_sha256
from xihenet.io.recording import write_session


def previs(
    scene: bpy.types.Scene,
    out: str | Path,
    settings: PrevisSettings,
    *,
    blend_file: Path | None = None,
    command: str = "",
) -> Job[Json]:
    """Run the chain on `scene` and leave results.json, report.html, pictures and a lit .blend in the folder `out`.

    A scene that shows a phone's recording is not rendered: the recording's frames are the captures, and in place of the
    comparison with ground truth the virtual objects are put over them.

    Parameters
    ----------
    scene : with a camera path and virtual objects; stays as it is, but for worlds and markers named "Xihe ..."
    out : folder of the run, made if needed. The same run is resumed; ValueError-like mistakes are UserError
    blend_file : where the scene comes from, for the results; None takes the open file
    command : what the user typed, for the report

    Gives the content of results.json.
    """
    recorded = recorded_session(scene, settings)
    if recorded is not None:
        settings = recorded.settings
    plan = plan_previs(scene, settings)
    if recorded is not None:
        recorded.check_camera(scene, plan)
    loaded = load_estimators(settings)
    file = blend_file or Path(bpy.data.filepath or "untitled.blend")
    outputs = RunOutputs(Path(out), file.stem)
    leaves = (outputs.results, outputs.report, outputs.lit_blend)
    names = (settings.estimator, *settings.others)
    decides = made_of("a run", scene, file, settings, plan) | {"weights": weights_sha256(names, settings.target)}
    if recorded is not None:
        decides |= {"recording": recorded.digest}
    manifest = FolderManifest(outputs.folder, outputs.settings, "a run", decides, leaves)
    is_whole = manifest.check() and all(path.exists() for path in leaves)
    finished = kept_record(RunResults, outputs.results) if is_whole else None
    if finished is not None:
        yield Progress(1, 1, f"this run is already done; delete {out} to do it again")
        return as_json(finished)
    yield Progress(0, 1, "surveying the path")
    survey = yield from survey_run(scene, plan, outputs)
    # Not before: a scene that cannot be run leaves no folder.
    with manifest.held():
        with scene_kept():
            if recorded is None:
                run = yield from prepare_run(scene, plan, survey, outputs, settings, loaded)
            else:
                run = yield from prepare_recorded(scene, plan, survey, outputs, recorded, loaded)
            chain = yield from run_chain(run, keeps_session=True)
            frames = yield from _compared(run, chain)
            errors = yield from measure_phone(run, chain)
        close_backends(loaded)
        yield run.progress("methods", 1, "applying the light and writing the report")
        changes = _apply(run, chain, frames)
        found = results.assemble(
            run,
            frames,
            lights=changes,
            phone=chain.phone,
            errors=errors,
            file=file,
            command=command,
            recording=None if recorded is None else recorded.said,
        )
        write_session(outputs.folder, kept_facts(run))
        # The results come last: their presence says that the run is done.
        write_report(found, outputs)
        content = as_json(found)
        write_json(outputs.results, content)
        return content


def _compared(run: PreparedRun, chain: ChainResult) -> Job[list[FrameResult]]:
    """A job: the frames of the chain beside their ground truth or, where there is none, over the recording."""
    if run.has_truth:
        compared = yield from compare_path(run, chain)
        return [replace(frame, compared=compared.get(frame.frame)) for frame in chain.frames]
    composited = yield from composite_path(run, chain)
    return [replace(frame, composited=composited.get(frame.frame, {})) for frame in chain.frames]


def _apply(run: PreparedRun, chain: ChainResult, frames: Sequence[FrameResult]) -> dict[str, tuple[LightChange, ...]]:
    """Put the estimated light onto the timeline, and save a copy of the file that shows it; the light by object."""
    estimated = {frame: methods[run.settings.estimator] for frame, methods in chain.lights.items()}
    changes = results.light_changes(run.plan.objects, estimated, run.outputs, run.exposure)
    has_key_light = run.settings.has_key_light
    apply_lights(run.scene, changes, chain.frames, run.exposure, run.outputs.folder, has_key_light=has_key_light)
    save_lit_blend(run.scene, run.plan.objects, last_surfaces(frames), run.outputs.lit_blend)
    return changes
