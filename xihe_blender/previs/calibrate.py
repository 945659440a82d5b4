"""Cost of each preset on this machine, with the scene at hand: known in under a minute, not measured in full.

One view of the path is rendered with few samples: twice to load the scene and to time a sample, three times for the
noise that a sample leaves (see `xihe_blender.previs.sample_count`). A render's time is a straight line in its samples,
and each preset's number of samples follows from its noise target. Wall time on all cores, since that is what a run
takes.

Rejected: the pilots that a run makes for its preset, in three views and with up to 48 samples each, which take minutes.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import bpy

from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import write_json
from xihe_blender.jobs import Job, Progress, part_of, shown
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.plan import check_is_rendered, plan_previs
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.run_time import FEW_SAMPLES, N_RENDERS, time_renders
from xihe_blender.previs.sample_count import measure_captures, pilot_views, samples_taken
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.state import scene_kept
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import XiheController
from xihenet.effects import plan_effects
from xihenet.formats import format_list, format_quantity
from xihenet.records import ArrayF64, RgbdFrame

PILOT_SAMPLES = 2
N_STEPS = 9


@dataclass(frozen=True)
class Calibration:
    """What presets cost here, measured on the file with the stem `scene`.

    By preset the seconds that the capture of one frame takes, and its samples per pixel; and the milliseconds that the
    chain takes for one position.
    """

    scene: str
    frame_s: Mapping[str, float]
    samples: Mapping[str, int]
    step_ms: float


def calibrate(scene: bpy.types.Scene, settings: PrevisSettings) -> Job[Calibration]:
    """Measure; the scene stays as it is. The settings' own preset and samples do not matter.

    UserError as a run raises it, and where no virtual object is ever in view.
    """
    check_is_rendered(scene)
    plan = plan_previs(scene, settings)
    with scene_kept():
        survey = yield from part_of(3, 0, 0, survey_path(scene, plan))
        metering = meter_exposure(scene, plan.frames, settings.seed, metering=settings.metering_in_force)
        exposure = settings.exposure or (yield from shown(metering, Progress(0, 3, "metering the exposure")))
        views = pilot_views(plan, survey)
        if not views:
            raise UserError(f"scene {scene.name!r} never has a virtual object in view: move the camera's path, or it")
        view = views[len(views) // 2]
        effects = plan_effects(survey.required, overrides_in_force(scene, settings.effect_choices))
        capture = replace(settings.capture(plan.size, PILOT_SAMPLES), light_transport=cycles_settings(effects))
        trigger = settings.trigger_in_use
        measuring = measure_captures(scene, [view], capture, exposure, settings.n_anchors, trigger)
        noise, _ = yield from part_of(3, 1, 1, measuring)
        seen: list[RgbdFrame] = []
        with open_scanner(scene, capture) as scanner:
            scanner.exposure = exposure
            scanner.move_to(view[0])

            def render(_frame: int) -> None:
                seen.append(scanner.acquire_environment_scan())

            timing = time_renders(render, (view[0],) * N_RENDERS, FEW_SAMPLES, scanner.scene)
            _, capturing = yield from shown(timing, Progress(2, 3, "timing a few samples"))
        step_ms = _timed_step(seen[-1], view[1][0])
    samples = {name: samples_taken(preset, noise) for name, preset in PRESETS.items()}
    frame_s = {name: replace(capturing, samples=n).render_s for name, n in samples.items()}
    return Calibration(Path(bpy.data.filepath or "untitled").stem, frame_s, samples, step_ms)


def _timed_step(seen: RgbdFrame, position_m: ArrayF64) -> float:
    """Milliseconds from a capture to the light at one position; the median of a few, after one to warm up."""
    backend, times = LocalBackend(estimators.load(estimators.DEFAULT)), []
    for _ in range(1 + N_STEPS):
        session = XiheController(backend)
        session.add_position("pilot", position_m)
        start = time.perf_counter()
        session.step(seen, active=["pilot"])
        times.append(1e3 * (time.perf_counter() - start))
    return statistics.median(times[1:])


def format_calibration(calibration: Calibration) -> str:
    """As "Capturing a frame of living_room took 0.4 s at draft, 0.9 s at balanced and 3.1 s at accurate quality"."""
    costs = [f"{format_quantity(seconds, 's', 2)} at {name}" for name, seconds in calibration.frame_s.items()]
    return f"Capturing a frame of {calibration.scene} took {format_list(costs)} quality"


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Remember it; OSError if the file cannot be written."""
    write_json(path, asdict(calibration) | {"said": format_calibration(calibration)})
