"""The time of a run on this machine, and of a capture by preset, measured on a few renders of the scene itself.

The run is prepared as it would be (exposure, effects, samples for the noise that is wanted, frames in which nothing
changes), in a folder that goes again. Then a capture, a light probe and a comparison are rendered, after a first one
that loads the scene: with one sample, with a few more, and with all if that is quick. A render's time is taken to be a
straight line in its samples; the run's is that of all its frames, plus what preparing took. Light probes are measured
at a few places, with few pictures: how many more they need depends on the place.

Not counted: what a phone's errors and the chain itself take in a run, some hundredths of a second a frame, and the
start of a second Blender, some seconds. An error budget runs the chain so often that it is counted there.

What presets cost is known in under a minute: one view of the path is rendered with few samples, and each preset's
number of samples follows from the noise that they leave and its noise target. Rejected: the pilots that a run makes for
its preset, in three views and with up to 48 samples each, which take minutes.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean

import bpy
import numpy as np

from xihe_blender.capture.all_around import N_VIEWS
from xihe_blender.capture.reference_probe import FEWEST_SAMPLES, ProbeSettings
from xihe_blender.capture.scanner import meter_exposure, open_scanner
from xihe_blender.compare.methods import GroundTruth
from xihe_blender.errors import UserError
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Job, Progress, Steps, part_of, shown, timed
from xihe_blender.light_transport import cycles_settings
from xihe_blender.light_transport.overrides import overrides_in_force
from xihe_blender.previs.budget_chain import EVERY_FRAME, SessionParts, lights_in_use, sight
from xihe_blender.previs.error_budget import MOST_LOOKS, N_MOMENTS, N_SEEDS
from xihe_blender.previs.plan import check_is_rendered, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run
from xihe_blender.previs.presets import PRESETS
from xihe_blender.previs.sample_count import measure_captures, pilot_views, samples_taken
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.previs.survey import survey_path
from xihe_blender.scene.state import scene_kept
from xihenet.camera_path.placement import evenly_chosen
from xihenet.effects import plan_effects
from xihenet.formats import format_duration, format_list, format_quantity
from xihenet.light.reflections import N_DIRECTIONS
from xihenet.records import ObjectLight, Reflections, RgbdFrame

FEW_SAMPLES = 4
LONGEST_S = 4.0
"""A render that seems to take no longer is timed with all of its samples: many take less each than a few do."""

N_SESSIONS = 8
"""Times at most that an error budget runs the chain along the path: as it was, by least squares, and with a part
perfect; clipping takes in each frame twice."""

PILOT_SAMPLES = 2
N_RENDERS = 3
"""Of each kind, in frames of their own: one that loads the scene, one with a single sample, and one with a few."""


@dataclass(frozen=True)
class RenderTime:
    """Seconds of one render: `fixed_s` whatever the samples, and `per_sample_s` for each of `samples`."""

    fixed_s: float
    per_sample_s: float
    samples: int

    @property
    def render_s(self) -> float:
        return self.fixed_s + self.per_sample_s * self.samples


@dataclass(frozen=True)
class RunTime:
    """What a run or an error budget consists of, and how long each part takes.

    `prepare_s` is until the first frame, and to load the scene for the first render of each kind; an error budget loads
    it anew with each seed. `renders` are by kind how many there are, without those that an earlier frame has already,
    and the time of one; of an error budget the chain counts too.
    """

    prepare_s: float
    renders: Mapping[str, tuple[int, RenderTime]]

    @property
    def total_s(self) -> float:
        return sum((n * one.render_s for n, one in self.renders.values()), start=self.prepare_s)


def format_run_time(seconds: float) -> str:
    """ "about 3 min": as exact as it is."""
    step_s = 5 if seconds < 55 else 60 if seconds < 3300 else 600
    return f"about {format_duration(step_s * max(1, round(seconds / step_s)))}"


def run_time_job(scene: bpy.types.Scene, settings: PrevisSettings) -> Job[tuple[RunTime, RunTime]]:
    """A job: the time of a run on `scene`, and of its error budget with all seeds, from a few renders.

    The scene stays as it is. UserError as a run raises it.
    """
    check_is_rendered(scene)
    # Nothing is estimated: an edge server is neither asked nor left with a session.
    plan, loaded = plan_previs(scene, settings), load_estimators(replace(settings, backend=None))
    with tempfile.TemporaryDirectory(prefix="xihe_") as folder, scene_kept():
        outputs = RunOutputs(Path(folder), "scene")
        survey, surveyed_s = yield from timed(survey_path(scene, plan))
        run, prepared_s = yield from timed(prepare_run(scene, plan, survey, outputs, settings, loaded))
        return (yield from _measured(run, surveyed_s + prepared_s))


def _measured(run: PreparedRun, prepared_s: float) -> Job[tuple[RunTime, RunTime]]:
    """From a few renders of each kind, spread over the frames that are captured."""
    if not run.reuse.captures:
        return RunTime(prepared_s, {}), RunTime(prepared_s, {})
    frames = [list(run.reuse.captures)[k * len(run.reuse.captures) // N_RENDERS] for k in range(N_RENDERS)]
    with open_scanner(run.scene, run.capture) as scanner:
        scanner.exposure = run.exposure
        captured: dict[int, RgbdFrame] = {}

        def capture_at(frame: int) -> None:
            scanner.move_to(frame)
            captured[frame] = scanner.acquire_environment_scan()

        timing = time_renders(capture_at, frames, run.capture.samples, scanner.scene)
        capture_loaded_s, capture = yield from shown(timing, Progress(1, 4, "measuring a capture"))
    probe_loaded_s, probe, ball = yield from shown(_timed_probe(run), Progress(2, 4, "measuring a light probe"))
    comparing = _timed_comparison(run, frames, captured)
    comparison_loaded_s, comparison = yield from shown(comparing, Progress(3, 4, "measuring a comparison"))
    times = {"capture": capture, "probe": probe, "comparison": comparison}
    renders = {kind: (n, times[kind]) for kind, n in run.n_renders.items()}
    budget_renders = _budget_renders(run, capture, ball)
    if "truth_sh" not in run.estimator.needs:  # Of the true light there is no error budget.
        budget_renders["chain"] = _budget_chain(run, captured)
    budget_loaded_s = N_SEEDS * (2 * capture_loaded_s + probe_loaded_s)
    prepare_s = prepared_s + capture_loaded_s + probe_loaded_s + comparison_loaded_s
    return RunTime(prepare_s, renders), RunTime(prepared_s + budget_loaded_s, budget_renders)


def _budget_renders(run: PreparedRun, capture: RenderTime, ball: RenderTime) -> dict[str, tuple[int, RenderTime]]:
    """Those of an error budget, at most; it captures the whole path, and a look is six squares."""
    n_probes, n_states = len(run.plan.probes), len({state.room for state in run.reuse.states.values()})
    n_looks = min(MOST_LOOKS, len(run.plan.frames)) + n_probes * min(MOST_LOOKS, n_states)
    n_captures = run.n_renders["capture"] + len(run.plan.frames) - len(run.reuse.captures)
    look = replace(capture, per_sample_s=capture.per_sample_s * min(run.plan.size) / max(run.plan.size))
    return {
        "capture": (N_SEEDS * n_captures, capture),
        "look": (N_SEEDS * N_VIEWS * n_looks, look),
        "ball": (N_SEEDS * n_probes * min(N_MOMENTS, n_states), ball),
    }


def _budget_chain(run: PreparedRun, captured: Mapping[int, RgbdFrame]) -> tuple[int, RenderTime]:
    """How often an error budget takes in a frame at a position, at most, and how long that takes with an estimate."""
    n_frames = len(run.plan.frames)
    n_looks = 2 * N_VIEWS * min(MOST_LOOKS, n_frames)  # Around the phone and around the object.
    sights = [sight(captured[frame], run.exposure) for frame in sorted(captured)]
    session = SessionParts(sights, EVERY_FRAME, None, run.estimator, {})
    # Of one out of view nothing would be estimated.
    probe = max(run.plan.probes, key=lambda one: sum(one in run.probes_in_view(frame) for frame in captured))
    lights_in_use(run, probe, replace(session, sights=sights[:1]), ())  # The first frame makes tables.
    start = time.perf_counter()
    lights_in_use(run, probe, session, ())
    step_s = (time.perf_counter() - start) / len(sights)
    return N_SEEDS * len(run.plan.probes) * (N_SESSIONS * n_frames + n_looks), RenderTime(step_s, 0.0, 0)


def _timed_probe(run: PreparedRun) -> Steps[tuple[float, RenderTime, RenderTime]]:
    """Of one reference light as a run measures it: the mean over a few, which may differ by four times and more.

    Each is measured with few pictures, whose noise says how many a run will take. And of a satin ball, which is always
    rendered with as many rays as there may be.
    """
    probes = {probe.name: (index, probe) for index, probe in enumerate(run.plan.probes)}
    rendered = [(frame, name) for (frame, name), source in run.reuse.probes.items() if source == frame]
    if not rendered:  # No position is ever in view.
        return 0.0, RenderTime(0.0, 0.0, 0), RenderTime(0.0, 0.0, 0)
    times_s, picture_s, counts = [], [], []
    yield
    with run.open_probes(run.plan.probes) as reference_probe:
        few = min(FEWEST_SAMPLES, run.reference.max_samples)
        reference_probe.settings = replace(run.reference, max_samples=few)
        start = time.perf_counter()
        reference_probe.view(0, 0)
        loaded_s = time.perf_counter() - start
        for frame, name in evenly_chosen(rendered, N_RENDERS):
            yield
            index, probe = probes[name]
            reference_probe.move(index, probe.at(frame))
            light = (yield from reference_probe.light_by_steps(index, frame, run.exposure)).measured
            taken = light.ldr_samples, light.hdr_samples
            of_ldr = replace(run.reference, max_samples=run.reference.max_ldr_samples)
            needed = (
                pictures_needed(taken[0], light.ldr_noise, of_ldr),
                pictures_needed(taken[1], light.hdr_noise, run.reference),
            )
            ball_s = reference_probe.mirror_ball(index, frame)[1] if run.settings.has_reflections else 0.0
            picture_s.append(light.render_s / sum(taken))
            times_s.append(picture_s[-1] * sum(needed) + ball_s)
            counts.append(sum(needed) / 2)
    ball = RenderTime(0.0, fmean(picture_s), run.reference.max_samples)
    return loaded_s, RenderTime(fmean(times_s), 0.0, round(fmean(counts))), ball


def pictures_needed(n_taken: int, noise: float | None, settings: ProbeSettings) -> float:
    """How many pictures bring the `noise` of `n_taken` down to the target: its square falls as their number grows."""
    if settings.noise_target is None or noise is None:
        return settings.max_samples
    return min(settings.max_samples, max(n_taken, n_taken * (noise / settings.noise_target) ** 2))


def _timed_comparison(
    run: PreparedRun, frames: Sequence[int], captured: Mapping[int, RgbdFrame]
) -> Steps[tuple[float, RenderTime]]:
    """Under no light at all, which takes Cycles as long as any; reflected, if that is what a run's lights are."""
    picture = Reflections(np.zeros((N_DIRECTIONS, 3), np.float32), 0.0) if run.settings.has_reflections else None
    nothing = ObjectLight(np.zeros((9, 3)), reflections=picture)
    dark = {method: {item.name: nothing for item in run.plan.objects} for method in run.methods}
    with run.open_comparer(run.methods) as comparer:
        truth: dict[int, GroundTruth] = {}

        def trace(frame: int) -> None:
            truth[frame] = comparer.render_ground_truth(frame)

        samples = run.comparison.samples
        # One after the other, as in a run: by turns Cycles would build the scenes anew for each render.
        traced_loaded_s, traced = yield from time_renders(trace, frames, samples, comparer.ground_truth)
        lit_loaded_s, lit = yield from time_renders(
            lambda frame: comparer.render_methods(captured[frame], dark, truth[frame]), frames, samples, comparer.lit
        )
    both = RenderTime(traced.fixed_s + lit.fixed_s, traced.per_sample_s + lit.per_sample_s, samples)
    return traced_loaded_s + lit_loaded_s, both


def time_renders(
    render: Callable[[int], object], frames: Sequence[int], samples: int, scene: bpy.types.Scene
) -> Steps[tuple[float, RenderTime]]:
    """Seconds that the first render takes longer than the second, and the time of a render of `scene` with `samples`.

    Each is a step, and of another frame, as in a run: what moves has to be loaded again.
    """

    def seconds(frame: int, n_samples: int) -> Steps[float]:
        yield
        scene.cycles.samples = n_samples
        start = time.perf_counter()
        render(frame)
        return time.perf_counter() - start

    few = min(FEW_SAMPLES, samples)
    times_s = []
    for frame, n_samples in zip(frames, (1, 1, few), strict=True):
        times_s.append((yield from seconds(frame, n_samples)))
    first_s, one_s, few_s = times_s
    per_sample_s = _slope(one_s, few_s, few)
    if few < samples and one_s + per_sample_s * (samples - 1) <= LONGEST_S:
        per_sample_s = _slope(one_s, (yield from seconds(frames[0], samples)), samples)
    return max(0.0, first_s - one_s), RenderTime(max(0.0, one_s - per_sample_s), per_sample_s, samples)


def _slope(one_s: float, many_s: float, samples: int) -> float:
    """Seconds per sample, from a render with one and another with `samples`."""
    return max(0.0, many_s - one_s) / (samples - 1) if samples > 1 else 0.0


# ------------------------------------------------------------------------------------------------------------- presets


@dataclass(frozen=True)
class Calibration:
    """What presets cost here, measured on the file with the stem `scene`.

    By preset the seconds that the capture of one frame takes, and its samples per pixel.
    """

    scene: str
    frame_s: Mapping[str, float]
    samples: Mapping[str, int]


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
        measuring = measure_captures(scene, [view], capture, exposure, settings.n_anchors, settings.trigger_in_use)
        noise, _ = yield from part_of(3, 1, 1, measuring)
        with open_scanner(scene, capture) as scanner:
            scanner.exposure = exposure
            scanner.move_to(view[0])
            frames = (view[0],) * N_RENDERS
            timing = time_renders(lambda _: scanner.acquire_environment_scan(), frames, FEW_SAMPLES, scanner.scene)
            _, capturing = yield from shown(timing, Progress(2, 3, "timing a few samples"))
    samples = {name: samples_taken(preset, noise) for name, preset in PRESETS.items()}
    frame_s = {name: replace(capturing, samples=n).render_s for name, n in samples.items()}
    return Calibration(Path(bpy.data.filepath or "untitled").stem, frame_s, samples)


def format_calibration(calibration: Calibration) -> str:
    """As "Capturing a frame of living_room took 0.4 s at draft, 0.9 s at balanced and 3.1 s at accurate quality"."""
    costs = [f"{format_quantity(seconds, 's', 2)} at {name}" for name, seconds in calibration.frame_s.items()]
    return f"Capturing a frame of {calibration.scene} took {format_list(costs)} quality"


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Remember it; OSError if the file cannot be written."""
    write_json(path, asdict(calibration) | {"said": format_calibration(calibration)})
