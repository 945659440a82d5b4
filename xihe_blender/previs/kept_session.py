"""The session of a run, kept: what its phone saw, from which light at any other place follows without a render.

The captures of a run hide the virtual objects and do not depend on them, see `xihenet.camera_path.kept_path`. What
needs a render is not here: reference light and ground truth.

What asks about light at many places, or about other views, captures the path alone, without ground truth. The captures
are kept in the folder and taken up again there, for the same scene and settings, whatever is asked of them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture.reference_probe import MeasuredLight, open_reference_probe
from xihe_blender.errors import UserError
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import Parameters, as_json
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.io.provenance import machine, software
from xihe_blender.io.run_results import RunResults, read_results
from xihe_blender.jobs import Job, Progress, shown
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
from xihenet.camera import unproject_frame
from xihenet.camera_path.kept_path import FoundLight, KeptPath, SeenFrame
from xihenet.camera_path.other_cores import find_light_on_all_cores
from xihenet.io.recording import SessionFacts, load_frame, read_session
from xihenet.light_change import LightFollowing
from xihenet.records import ArrayF64
from xihenet.trigger import TriggerSettings

OF_CHAIN = ("estimator", "target", "light", "n_anchors", "seed", "captured", "between_estimates", "network")
"""Settings by which the chain runs, under the names that results have for them too."""

MOST_POINTS = 40_000_000
"""Of all frames together, kept in 1 GB; those of more are unprojected whenever a frame is looked at, which takes 0.7 ms
beside the other 2.4 of a position in a frame of 256x192."""


@dataclass(frozen=True, eq=False)
class KeptSession:
    """All that the chain of a run needs to be run again; made by `open_kept_session`."""

    settings: PrevisSettings
    exposure: float
    frames: tuple[SeenFrame, ...]

    @cached_property
    def _path(self) -> KeptPath:
        chain, (estimator, *_) = self.settings.chain(self.exposure), load_estimators(self.settings)
        return KeptPath(self.frames, chain, estimator, self.settings.link, self.settings.seed)

    def find_light(self, places_m: Mapping[str, ArrayLike]) -> Job[dict[str, FoundLight]]:
        """A job, a step per frame: the light at positions ((3,) world, metres) that stay where they are, by name.

        Nothing is rendered. The same as a run's, to the last bit.
        """
        frames = [one.seen.frame for one in self.frames]
        return shown(
            self._path.find_light(places_m),
            lambda done: Progress(done, len(frames), f"estimating the light from frame {frames[done]}"),
        )

    def find_light_on_all_cores(self, places_m: Mapping[str, ArrayLike]) -> Job[dict[str, FoundLight]]:
        """A job: as `find_light`, for many positions, with the other cores of this machine."""
        n = len(places_m)
        return shown(
            find_light_on_all_cores(self._path, places_m),
            lambda done: Progress(done, n, f"estimating the light at place {min(done + 1, n)} of {n}"),
        )


def open_kept_session(folder: str | Path) -> Job[KeptSession]:
    """A job, a step per frame: read the frames that the run in `folder` keeps.

    UserError where they are gone, or where the run's estimator needs more than frames: `truth` is rendered.
    """
    results, outputs = read_results(Path(folder)), RunOutputs(Path(folder))
    captured = [entry.frame for entry in results.captured_frames]
    if not captured:
        raise UserError(f"the run in {folder} captured nothing: run again")
    _check_is_all_there(outputs)
    of_run = results.settings
    return (yield from kept_session(outputs, _settings_of(results), of_run.reference_exposure, captured))


def kept_session(
    outputs: RunOutputs, settings: PrevisSettings, exposure: float, captured: Sequence[int]
) -> Job[KeptSession]:
    """A job, a step per frame: the session of a run whose frames `captured` are in `outputs`; errors as above.

    Without reflections: filling their sphere from all frames takes seconds, and a move has to be answered at once.
    """
    if settings.has_reflections:
        settings = replace(settings, light="sh+key")
    if settings.estimator == "truth":
        raise UserError("the light of `truth` is rendered: run again, or choose another estimator")
    frames = []
    for done, frame in enumerate(captured):
        yield Progress(done, len(captured), f"reading frame {frame}")
        frames.append(_seen_frame(outputs, frame, exposure, len(captured)))
    return KeptSession(settings, exposure, tuple(frames))


def kept_facts(run: PreparedRun) -> SessionFacts:
    """The session.json of a run: the frames that it keeps, as its phone saw them."""
    outputs = run.outputs
    paths = [(outputs.seen(frame), outputs.capture(frame)) for frame in sorted(run.needs.captured)]
    seen_by = f"rendered, as the phone {run.settings.phone} saw it" if run.has_truth else "recorded by a phone"
    return SessionFacts(
        f"{outputs.scene}, {seen_by}",
        reference_exposure=run.exposure,
        trigger=run.settings.trigger_in_use,
        files=tuple(outputs.relative(seen if seen.exists() else capture) for seen, capture in paths),
    )


def _check_is_all_there(outputs: RunOutputs) -> None:
    """UserError where a file of the session is gone: a capture alone is not what a phone with flaws saw."""
    try:
        files = read_session(outputs.session).files if outputs.session.exists() else ()
    except (OSError, ValueError) as error:
        raise UserError(f"the session of the last run is damaged ({error}): run again") from error
    if gone := [name for name in files if not (outputs.folder / name).exists()]:
        raise UserError(f"the captures of the last run are gone or damaged (there is no {gone[0]}): run again")


def _seen_frame(outputs: RunOutputs, frame: int, exposure: float, n_frames: int) -> SeenFrame:
    try:
        captured = load_frame(outputs.capture(frame))
        seen = load_frame(outputs.seen(frame)) if outputs.seen(frame).exists() else captured
    except (OSError, ValueError) as error:
        raise UserError(f"the captures of the last run are gone or damaged ({error}): run again") from error
    is_kept = n_frames * seen.plane_depth_m.size <= MOST_POINTS
    points = unproject_frame(seen, reference_exposure=exposure) if is_kept else None
    return SeenFrame(seen, points, (captured.intrinsics, captured.world_from_camera))


def _settings_of(results: RunResults) -> PrevisSettings:
    """Of the chain; what only rendering needs is left as it comes."""
    of_run = replace(results.settings, network=results.network_in_use)
    following = None if of_run.following is None else LightFollowing(**of_run.following)  # type: ignore[arg-type]
    trigger = TriggerSettings(**of_run.trigger)  # type: ignore[arg-type]
    return PrevisSettings(trigger=trigger, following=following, **{name: getattr(of_run, name) for name in OF_CHAIN})


# ---------------------------------------------------------------------------------------- a path captured for it alone


@dataclass(frozen=True, eq=False)
class CapturedPath:
    """The prepared run, and the session of its phone."""

    run: PreparedRun
    session: KeptSession


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
