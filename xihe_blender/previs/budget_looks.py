"""Renders of an error budget beside the captures of the path: looks around, and satin balls under the true light.

Everything is kept file by file in the folder of the budget, and rendered once; where the light does not change, one
look from an object and one ball serve for all moments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from xihe_blender.capture.all_around import N_VIEWS, open_all_around
from xihe_blender.capture.phone_surfaces import save_surfaces, surfaces_in
from xihe_blender.capture.satin_probe import satin_ball_at
from xihe_blender.io.exr import read_radiance, write_radiance
from xihe_blender.io.json_records import as_json, read_record
from xihe_blender.io.kept_files import kept_record
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.plan import Probe
from xihe_blender.previs.prepare import PreparedRun
from xihe_blender.previs.run_chain import is_captured
from xihenet.io.recording import load_frame, save_frame
from xihenet.records import ArrayF32, ArrayF64, RgbdFrame
from xihenet.satin_ball import SatinBall

FROM_PATH = "path"
"""The place from which the phone itself looks around."""

View = tuple[RgbdFrame, ArrayF32]
"""A picture, and its scene radiance (H, W, 3)."""


def view_outputs(run: PreparedRun, place: str, view: int) -> RunOutputs:
    """Where the `view`-th of the pictures around a place is kept, by frame as captures are."""
    return RunOutputs(run.outputs.folder / "work" / "around" / place / str(view))


def place_of(run: PreparedRun, probe: Probe) -> str:
    """The place of an estimation position, as part of a path."""
    return f"position_{run.plan.probes.index(probe)}"


def look_around(run: PreparedRun, places: Mapping[str, Mapping[int, ArrayF64]]) -> Job[None]:
    """A job: render what is not kept yet of all pictures around `places`, world positions (3,) by place and frame."""
    wanted = sorted((frame, place) for place, at in places.items() for frame in at)
    keeping = replace(run.needs, radiance=True)
    missing = [
        (frame, place)
        for frame, place in wanted
        if not all(is_captured(view_outputs(run, place, view), keeping, frame) for view in range(N_VIEWS))
    ]
    if not missing:
        return
    with open_all_around(run.scene, run.capture, exposure=run.exposure, with_surfaces=run.needs.surfaces) as around:
        for done, (frame, place) in enumerate(missing):
            yield Progress(done, len(missing), f"looking around in frame {frame}")
            around.scanner.scene.frame_set(frame)
            for view in range(N_VIEWS):
                outputs = view_outputs(run, place, view)
                seen, radiance = around.look(view, places[place][frame])
                if run.needs.surfaces:
                    roughness = run.survey.frames[frame].roughness
                    save_surfaces(outputs.surfaces(frame), surfaces_in(around.scanner.rendered.passes, roughness))
                write_radiance(outputs.radiance("captured", frame), radiance)
                outputs.capture(frame).parent.mkdir(parents=True, exist_ok=True)
                save_frame(outputs.capture(frame), seen)


def kept_views(run: PreparedRun, place: str, frame: int) -> list[View]:
    """The six pictures around a place, which `look_around` rendered."""
    kept = (view_outputs(run, place, view) for view in range(N_VIEWS))
    return [(load_frame(one.capture(frame)), read_radiance(one.radiance("captured", frame))) for one in kept]


# --------------------------------------------------------------------------------------------------------- satin balls


def measure_balls(run: PreparedRun, wanted: Iterable[tuple[int, Probe]]) -> Job[None]:
    """A job: render the satin ball at each position in each frame that is not kept yet."""
    missing = [(f, probe) for f, probe in wanted if kept_record(SatinBall, _ball_file(run, f, probe)) is None]
    if not missing:
        return
    with run.open_probes(run.plan.probes) as reference_probe:
        for done, (frame, probe) in enumerate(missing):
            yield Progress(done, len(missing), f"measuring the light at {probe.name} in frame {frame}")
            index, samples = run.plan.probes.index(probe), run.reference.max_samples
            reference_probe.move(index, probe.at(frame))
            ball = satin_ball_at(reference_probe, index, frame, exposure=run.exposure, samples=samples)
            write_json(_ball_file(run, frame, probe), as_json(ball))


def kept_ball(run: PreparedRun, frame: int, probe: Probe) -> SatinBall:
    """What `measure_balls` rendered."""
    return read_record(SatinBall, _ball_file(run, frame, probe))


def _ball_file(run: PreparedRun, frame: int, probe: Probe) -> Path:
    return run.outputs.folder / "work" / f"satin_ball_{run.plan.probes.index(probe)}_{frame:04d}.json"
