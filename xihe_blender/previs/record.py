"""A recording: what the phone of a scene would have stored of its camera path, and beside it, if asked, the true light.

The captures are a run's, kept in the folder's `work` and taken up again there. With virtual objects in the scene they
are those of its run to the last bit, without any they take the samples of the preset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.three_spheres import open_three_spheres
from xihe_blender.errors import UserError
from xihe_blender.io.exr import write_radiance
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import as_json
from xihe_blender.io.outputs import RunOutputs, write_json, write_picture
from xihe_blender.io.provenance import software
from xihe_blender.jobs import Job, Progress, shown
from xihe_blender.light_transport.render_reuse import plan_render_reuse
from xihe_blender.previs.kept_session import kept_facts, path_plan
from xihe_blender.previs.plan import PrevisPlan, Probe, made_of, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import phone_of_captures, render_captures
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.captures.writing import WRITERS
from xihenet.colour import linear_to_srgb
from xihenet.formats import format_count
from xihenet.io.recording import SESSION_FILE, load_frame, save_frame, write_session
from xihenet.records import RgbdFrame

WORK = "a recording"
TRUTH_FILE = "truth.json"
OURS = "xihe"
RECORD3D_FILE = "recording.r3d"


@dataclass(frozen=True)
class RecordWishes:
    """What is recorded beside the frames.

    Parameters
    ----------
    layout : OURS, or that of another app or data set, one of WRITERS
    has_truth : whether the true light is rendered
    at_m : (x, y, z) world, metres, of where; empty takes the virtual objects' estimation positions
    """

    layout: str = OURS
    has_truth: bool = False
    at_m: Sequence[tuple[float, float, float]] = ()


def record_session(
    scene: bpy.types.Scene,
    out: Path,
    settings: PrevisSettings,
    wishes: RecordWishes,
    *,
    blend_file: Path,
    command: str = "",
) -> Job[list[str]]:
    """A job: record the camera path of `scene` in the folder `out`; in words what it left.

    UserError for a scene without a camera, for a folder that holds something else, where the true light is asked for
    and there is no place to measure it, and without a package that the layout takes.
    """
    settings, plan = _planned(scene, settings)
    places = truth_places(plan, wishes) if wishes.has_truth else ()
    outputs = RunOutputs(out, blend_file.stem)
    manifest = _manifest(scene, outputs, settings, plan, wishes.layout, blend_file)
    manifest.check()
    survey = yield from survey_run(scene, plan, outputs)
    with manifest.held(), scene_kept():
        run = yield from prepare_run(scene, plan, survey, outputs, settings, ())
        yield from render_captures(run)
        yield Progress(1, 1, "writing the recording")
        said = _write(out, _frames(run), run, wishes.layout)
        if places:
            # Where objects move their places do, as the survey has found.
            yield from _measure_truth(run, truth_places(run.plan, wishes), out, command)
            said.append(f"the true light at {format_count(len(places), 'place')} in {TRUTH_FILE}")
        if wishes.layout == OURS:
            # Last: it says that the recording is whole.
            write_session(out, replace(kept_facts(run), files=()))
        return said


def check_recording(scene: bpy.types.Scene, out: Path, settings: PrevisSettings, *, blend_file: Path) -> None:
    """UserError where `out` holds anything but such a recording in our own form, or one of files that have changed."""
    _manifest(scene, RunOutputs(out, blend_file.stem), *_planned(scene, settings), OURS, blend_file).check()


def _planned(scene: bpy.types.Scene, settings: PrevisSettings) -> tuple[PrevisSettings, PrevisPlan]:
    settings = replace(settings, captured="path", light="sh")
    return (settings, plan_previs(scene, settings)) if virtual_objects(scene) else path_plan(scene, settings)


def _manifest(
    scene: bpy.types.Scene, outputs: RunOutputs, settings: PrevisSettings, plan: PrevisPlan, layout: str, file: Path
) -> FolderManifest:
    decides = made_of(WORK, scene, file, settings, plan) | {"layout": layout}
    return FolderManifest(outputs.folder, outputs.settings, WORK, decides, (outputs.folder / SESSION_FILE,))


def _frames(run: PreparedRun) -> Iterator[RgbdFrame]:
    phone = phone_of_captures(run)
    for frame in sorted(run.needs.captured):
        seen, _ = phone.see(load_frame(run.outputs.capture(frame)), run.outputs)
        yield seen


def _write(out: Path, frames: Iterator[RgbdFrame], run: PreparedRun, layout: str) -> list[str]:
    if layout == OURS:
        for number, seen in enumerate(frames):
            save_frame(out / f"frame_{number:06d}.exr", seen)
        return [f"{format_count(len(run.needs.captured), 'frame')} in {out}"]
    path = out / RECORD3D_FILE if layout == "record3d" else out
    try:
        written = WRITERS[layout](path, frames)
    except (ImportError, ValueError) as error:
        raise UserError(f"--as {layout}: {error}") from error
    said = [f"{format_count(written.n_frames, 'frame')} in {path}"]
    if written.n_unheld:
        said.append(f"{written.n_unheld} pixels are too far or too near for this layout and have no depth")
    return said


def truth_places(plan: PrevisPlan, wishes: RecordWishes) -> tuple[Probe, ...]:
    """Where the true light is measured. UserError where there is no place."""
    if wishes.at_m:
        return tuple(Probe(f"place_{k}", "", np.array(at)) for k, at in enumerate(wishes.at_m))
    if not plan.probes:
        raise UserError("there is no virtual object at which the true light could be measured: give --at X,Y,Z")
    return plan.probes


def _measure_truth(run: PreparedRun, places: Sequence[Probe], out: Path, command: str) -> Job[None]:
    """Light probes and spheres at `places`, in the first frame and wherever the light or the place is another."""
    frames = run.plan.frames
    names = {frame: tuple(place.name for place in places) for frame in frames}
    source = plan_render_reuse(run.survey.states, names, run.survey.moved).probes
    asked = [(k, place, f) for f in frames for k, place in enumerate(places) if source[f, place.name] == f]
    found = []
    lights, pictures = [], []
    # All of one kind before the other: Cycles keeps a room's geometry between the renders of one scene.
    with run.open_probes(places) as probe:
        probe.settings = replace(run.reference, aims_at_ldr=True)
        for done, (k, place, frame) in enumerate(asked):
            said = Progress(done, 2 * len(asked), f"measuring the true light at {place.name} in frame {frame}")
            probe.move(k, place.at(frame))
            lights.append((yield from shown(probe.light_by_steps(k, frame, run.exposure), said)))
    with open_three_spheres(run.scene, run.comparison) as spheres:
        for done, (_, place, frame) in enumerate(asked, start=len(asked)):
            yield Progress(done, 2 * len(asked), f"rendering three spheres at {place.name} in frame {frame}")
            pictures.append(spheres.seen_at(frame, place.at(frame), run.exposure))
    for (k, place, frame), light, seen in zip(asked, lights, pictures, strict=True):
        stem = f"truth/{k}_{frame:04d}"
        files = {"panorama": f"{stem}_panorama.exr", "spheres": f"{stem}_spheres.exr", "shown": f"{stem}_spheres.png"}
        write_radiance(out / files["panorama"], light.panorama * np.float32(run.exposure))
        write_radiance(out / files["spheres"], seen)
        write_picture(out / files["shown"], linear_to_srgb(seen.clip(0, 1)))
        found.append(
            {
                "name": place.name,
                "position_m": [float(x) for x in place.at(frame)],
                "frame": frame,
                "time_s": run.survey.frames[frame].time_s,
                **as_json(light.measured),
                "files": files,
            }
        )
    content: dict[str, Any] = {
        "schema_version": 1,
        "software": software(command),
        "axes": "right-handed, +Z up, metres; the basis of docs/conventions.md",
        "exposure": run.exposure,
        "light": "hdr: all light that arrives; ldr: what a camera sees, clipped at white; both carry the exposure",
        "valid": "from its frame on, until the next of its name",
        "places": found,
    }
    write_json(out / TRUTH_FILE, content)
