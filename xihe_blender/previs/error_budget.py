"""The error budget: for an object, how much of its error comes from each part of the chain, and what would help most?

Each part in turn is made perfect while all else stays as it was, from the same captures. The error is that of a satin
ball under the estimated light (`xihenet.satin_ball`), the root mean square over some moments of the path, for every
part alike. Parts overlap: what the phone has never seen may be missing since its view is narrow and since it is hidden.

    field of view   along the path the phone also looks all around from where it is
    coverage        along the path the room is also seen from the object itself, all around, clipped at white
    range sensor    the perfect captures stand in place of what the phone saw
    clipping        what lies above white is known to the estimator (`budget_chain.Unclipped`)
    hidden lamps    to the light is added what arrives at the object and no camera ray there meets: lamps that Blender
                    hides from cameras
    sampling        what the nearest point in each direction says of it, in place of the mean of all that is seen there,
                    is taken away: the difference that it makes to a complete, unclipped, current cloud
    network         what the estimator gets wrong even from such a cloud, of means, is taken away
    delay           every frame makes an estimate, which is there at once
    order 2         the light has what the true one has beyond nine coefficients

All is measured with several seeds. With another one the pictures have other grain, the phone's sensor and the network
draw other numbers, and the trigger may fire in another frame. What is said of a part is the mean, and the interval in
which the mean over all seeds lies in 95 of 100 cases: Student's t, since three seeds tell their own spread badly.

Rejected: intervals from the moments of one session, whose errors all come from the same captures and go up and down
together; and from what noise each picture has, which cannot know what a trigger makes of it. To take the network for
all that least squares would not get wrong: it fills what was not seen, and is better at it or worse; what that is worth
is told by `least_squares_error`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean, stdev

import bpy
import numpy as np

from xihe_blender.capture.all_around import light_of_views, means_of_anchors
from xihe_blender.capture.render import MAX_SEED
from xihe_blender.errors import UserError
from xihe_blender.io.budget_results import PARTS, BudgetPart, BudgetResults, ObjectBudget
from xihe_blender.io.folder_manifest import FolderManifest
from xihe_blender.io.json_records import as_json
from xihe_blender.io.outputs import RunOutputs, write_json
from xihe_blender.jobs import Job, Progress, Steps, part_of, shown
from xihe_blender.previs.budget_chain import (
    EVERY_FRAME,
    FROM_PATH,
    LightInUse,
    SessionParts,
    Sight,
    Unclipped,
    View,
    exposure_without_clipping,
    kept_ball,
    kept_views,
    lights_in_use,
    look_around,
    measure_balls,
    place_of,
    sight,
    sights_of_path,
    view_outputs,
    with_radiance,
)
from xihe_blender.previs.kept_session import path_facts
from xihe_blender.previs.plan import Probe, check_is_rendered, made_of, plan_previs
from xihe_blender.previs.prepare import PreparedRun, prepare_run, survey_run
from xihe_blender.previs.run_chain import phone_of_captures, render_captures
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.report.budget import write_budget_report
from xihe_blender.scene.state import scene_kept
from xihenet import estimators
from xihenet.buffers import merge_in_sight
from xihenet.colour import linear_to_srgb
from xihenet.estimators import EstimateContext, Estimator
from xihenet.estimators.weights_format import weights_sha256
from xihenet.paired import t_975
from xihenet.records import ArrayF64, PointCloud, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.satin_ball import SatinBall
from xihenet.sphere import AnchorLattice

BUDGET = "an error budget"
N_MOMENTS, N_SEEDS = 4, 3
MOST_LOOKS = 12
"""Before so many frames of the path somebody looks around, evenly; and before those from which measured light comes."""
CAPTURE_SHARE, LOOK_SHARE, BALL_SHARE = 0.5, 0.3, 0.15
"""Of the time of each seed, as a bar of progress shows it."""

Moments = Mapping[str, Sequence[int]]
"""The frames in which errors are measured, by position."""


def error_budget(
    scene: bpy.types.Scene,
    out: Path,
    settings: PrevisSettings,
    *,
    n_moments: int = N_MOMENTS,
    n_seeds: int = N_SEEDS,
    blend_file: Path | None = None,
    command: str = "",
) -> Job[BudgetResults]:
    """A job: the error budget of the virtual objects of `scene`, in the folder `out`: budget.json and report.html.

    Parameters
    ----------
    scene : with a camera path and virtual objects; stays as it is
    out : folder of the budget, made if needed; what is rendered is kept there and resumed
    settings : of a run. The whole path is captured, and all of the light is estimated, whatever they say
    n_moments : frames in which errors are measured: evenly over those with the object in view, the last among them
    n_seeds : with which all is rendered and measured, from that of `settings` on; with one there are no intervals
    blend_file : where the scene comes from; None takes the open file

    UserError for a scene that cannot be run, a folder that holds something else, or if no object is ever in view.
    """
    settings = replace(settings, captured="path", target="hdr", light="sh", others=())
    if n_moments < 1:
        raise UserError(f"an error cannot be measured in {n_moments} moments: give --moments 1 or more")
    if n_seeds < 1:
        raise UserError(f"an error cannot be measured with {n_seeds} seeds: give --seeds 1 or more")
    if settings.seed + n_seeds - 1 > MAX_SEED:
        raise UserError(
            f"of {n_seeds} seeds the last is out of Cycles' range: give --seed {MAX_SEED + 1 - n_seeds} or less"
        )
    if settings.estimator == "truth":
        raise UserError("the light of `truth` is rendered and has no error to divide: choose another --estimator")
    check_is_rendered(scene)
    plan, loaded = plan_previs(scene, settings), load_estimators(settings)
    file = blend_file or Path(bpy.data.filepath or "untitled.blend")
    outputs = RunOutputs(out, file.stem)
    weights = weights_sha256([settings.estimator], settings.target)
    content = made_of(BUDGET, scene, file, settings, plan) | {"weights": weights}
    manifest = FolderManifest(out, outputs.settings, BUDGET, content, (out / "report.html",))
    manifest.check()
    yield Progress(0, 1, "surveying the path")
    survey = yield from survey_run(scene, plan, outputs)
    if not any(one.in_view for one in survey.frames.values()):
        raise UserError("no virtual object is in view of the camera in any frame: move the camera, or an object")
    with manifest.held(), scene_kept():
        run = yield from prepare_run(scene, plan, survey, outputs, settings, loaded)
        moments = {probe.name: _moments(run, probe, n_moments) for probe in run.plan.probes}
        measured = []
        for number in range(n_seeds):
            job = _with_one_seed(with_seed(run, number), moments)
            measured.append((yield from part_of(n_seeds, number, 1, job)))
        results = BudgetResults(
            **path_facts(run, file, command, {"moments": n_moments, "seeds": n_seeds}),
            objects=tuple(_of_object(run, item.name, moments, measured) for item in run.plan.objects),
        )
        write_budget_report(out / "report.html", results)
        write_json(out / "budget.json", as_json(results))
        return results


# ---------------------------------------------------------------------------------------------------------- over seeds


@dataclass(frozen=True)
class SeedErrors:
    """Of one object, measured with one seed: root mean squares over its positions and moments."""

    brightness: float
    error: float
    least_squares: float | None
    with_perfect: Mapping[str, float]
    """What is left of the error by part; a part that is not simulated is not in it."""


def with_seed(run: PreparedRun, number: int) -> PreparedRun:
    """`run` with the `number`-th seed from its own on, exposure and samples as they are; the first is the run itself.

    What it renders lies in a folder of its own.
    """
    if number == 0:
        return run
    settings = replace(run.settings, seed=run.settings.seed + number)
    outputs = RunOutputs(run.outputs.folder / "work" / f"seed_{number}", run.outputs.scene)
    return replace(run, settings=settings, outputs=outputs, phone=replace(run.phone, settings=settings))


def _of_object(
    run: PreparedRun, name: str, moments: Moments, measured: Sequence[Mapping[str, SeedErrors]]
) -> ObjectBudget:
    """The budget of one object over all seeds."""
    frames = {frame for probe in run.plan.probes_of(name) for frame in moments[probe.name]}
    return over_seeds(name, tuple(sorted(frames)), [errors[name] for errors in measured if name in errors])


def over_seeds(name: str, moments: tuple[int, ...], seeds: Sequence[SeedErrors]) -> ObjectBudget:
    """The budget of object `name` from its errors with each seed; of one that was never in view there are none."""
    if not seeds:
        return ObjectBudget(name=name, moments=())
    least_squares = [one.least_squares for one in seeds if one.least_squares is not None]
    return ObjectBudget(
        name=name,
        moments=moments,
        brightness=fmean(one.brightness for one in seeds),
        error=fmean(one.error for one in seeds),
        least_squares_error=fmean(least_squares) if least_squares else None,
        parts=tuple(_part(part, seeds) for part in PARTS),
    )


def _part(name: str, seeds: Sequence[SeedErrors]) -> BudgetPart:
    error = fmean(one.error for one in seeds)
    if all(name not in one.with_perfect for one in seeds):
        return BudgetPart(name=name, state="not simulated", error=error, gain=0.0)
    # With a seed in which the phone does not have it, there is nothing to gain.
    left_with = [one.with_perfect.get(name, one.error) for one in seeds]
    left = fmean(left_with)
    interval = interval_of_mean([one.error - of_one for one, of_one in zip(seeds, left_with, strict=True)])
    return BudgetPart(name=name, state="measured", error=left, gain=error - left, interval=interval)


def interval_of_mean(values: Sequence[float]) -> tuple[float, float] | None:
    """The 95 % confidence interval of the mean of independent `values`, by Student's t; None for a single one."""
    if len(values) < 2:
        return None
    middle, half = fmean(values), t_975(len(values) - 1) * stdev(values) / math.sqrt(len(values))
    return middle - half, middle + half


# ------------------------------------------------------------------------------------------------------------ one seed


def _with_one_seed(run: PreparedRun, moments: Moments) -> Job[dict[str, SeedErrors]]:
    """A job: render what the budget needs with the seed of `run` and is not kept yet; the errors by object.

    Of objects that were ever in view.
    """
    run.outputs.settings.parent.mkdir(parents=True, exist_ok=True)
    keeping = replace(run, needs=replace(run.needs, radiance=True))
    yield from part_of(1, 0, CAPTURE_SHARE, render_captures(keeping))
    budget = _Budget(run, moments)
    yield from part_of(1, CAPTURE_SHARE, LOOK_SHARE, look_around(run, budget.places()))
    yield from part_of(1, CAPTURE_SHARE + LOOK_SHARE, BALL_SHARE, measure_balls(run, budget.balls()))
    step = Progress(CAPTURE_SHARE + LOOK_SHARE + BALL_SHARE, 1, "running the chain with each part perfect")
    yield step
    errors = {}
    for item in run.plan.objects:
        errors[item.name] = yield from shown(budget.of_object(item.name), step)
    return {name: one for name, one in errors.items() if one is not None}


def _moments(run: PreparedRun, probe: Probe, n: int) -> tuple[int, ...]:
    """At most `n` frames, evenly over those in which `probe` is in view; the last is one of them."""
    active = [frame for frame in run.plan.frames if probe in run.probes_in_view(frame)]
    numbers = np.linspace(0, len(active) - 1, n + 1)[1:].round()
    return tuple(sorted({active[int(number)] for number in numbers})) if active else ()


# --------------------------------------------------------------------------------------------------------------- parts


@dataclass(frozen=True, eq=False)
class _Moment:
    """One position in one frame: the true light there, and the estimates with one part perfect, (9, 3), by part."""

    ball: SatinBall
    lights: Mapping[str, ArrayF64]
    least_squares: ArrayF64

    def squared_error(self, part: str) -> float:
        return self.ball.squared_error(self.lights.get(part, self.lights[""]), has_all_orders=part == "order_2")


class _Budget:
    """The chain of `run`, again and again; `moments` by position. Nothing is rendered here."""

    def __init__(self, run: PreparedRun, moments: Moments) -> None:
        self.run, self.moments, self.phone = run, moments, phone_of_captures(run)
        self.sights, link = sights_of_path(run, self.phone), self.phone.link_in_use
        self.as_it_was = SessionParts(self.sights, run.settings.trigger_in_use, link, run.estimator, {})
        self.lights = {probe.name: self._lights(probe, self.as_it_was) for probe in run.plan.probes}

    def _lights(self, probe: Probe, parts: SessionParts) -> dict[int, LightInUse]:
        return lights_in_use(self.run, probe, parts, self.moments[probe.name])

    def look_frames(self, probe: Probe) -> list[int]:
        """The frames before which somebody looks around: along the path, and where the light in use comes from.

        From several places: what one look cannot see, since a table is in the way, another one may.
        """
        found = {light.light_frame for light in self.lights[probe.name].values()}
        path = [one.seen.frame for one in self.sights if one.seen.frame <= max(self.moments[probe.name], default=-1)]
        evenly = np.unique(np.linspace(0, len(path) - 1, min(len(path), MOST_LOOKS)).round().astype(int))
        return sorted({path[i] for i in evenly} | {frame for frame in found if frame is not None})

    def places(self) -> dict[str, dict[int, ArrayF64]]:
        """From where somebody has to look around, by place and frame."""
        probes, at = self.run.plan.probes, {one.seen.frame: one.seen.world_from_camera[:3, 3] for one in self.sights}
        looks = {frame for probe in probes for frame in self.look_frames(probe)}
        places: dict[str, dict[int, ArrayF64]] = {FROM_PATH: {frame: at[frame] for frame in looks}}
        for probe in probes:
            sources = {self._source(frame, probe) for frame in (*self.look_frames(probe), *self.moments[probe.name])}
            places[place_of(self.run, probe)] = {frame: probe.at(frame) for frame in sources}
        return places

    def balls(self) -> list[tuple[int, Probe]]:
        """At which frames satin balls are needed, in order, and where."""
        of_probes = {probe: self.moments[probe.name] for probe in self.run.plan.probes}
        needed = {(self._source(frame, probe), probe) for probe, frames in of_probes.items() for frame in frames}
        return sorted(needed, key=lambda one: (one[0], one[1].name))

    def _source(self, frame: int, probe: Probe) -> int:
        """The first frame of the path in which the light at `probe` is the same, whether it is in view or not."""
        states, place_m = self.run.reuse.states, probe.at(frame)
        same = (
            one.seen.frame
            for one in self.sights
            if states[one.seen.frame].room == states[frame].room and np.array_equal(probe.at(one.seen.frame), place_m)
        )
        return next(same, frame)

    def of_object(self, name: str) -> Steps[SeedErrors | None]:
        """The errors of one object: root mean squares over its positions and moments. None if it is never in view."""
        moments: list[_Moment] = []
        for probe in self.run.plan.probes_of(name):
            moments += yield from self._of_position(probe)
        if not moments:
            return None
        simulated = [part for part in PARTS if part == "order_2" or part in moments[0].lights]
        return SeedErrors(
            brightness=_root_mean(one.ball.brightness**2 for one in moments),
            error=_root_mean(one.squared_error("") for one in moments),
            least_squares=_root_mean(one.ball.squared_error(one.least_squares) for one in moments),
            with_perfect={part: _root_mean(one.squared_error(part) for one in moments) for part in simulated},
        )

    def _of_position(self, probe: Probe) -> Steps[list[_Moment]]:
        moments: list[_Moment] = []
        if not self.moments[probe.name]:
            return moments
        sessions = {}
        for part, parts in self._sessions(probe).items():
            yield
            sessions[part] = self._lights(probe, parts)
        projection = estimators.load("projection", self.run.settings.n_anchors, "hdr")
        least_squares = self._lights(probe, replace(self.as_it_was, estimator=projection))
        for frame in self.moments[probe.name]:
            yield
            source = self._source(frame, probe)
            ball = kept_ball(self.run, source, probe)
            lights = {"": self.lights[probe.name][frame].sh} | {part: one[frame].sh for part, one in sessions.items()}
            lights |= self._corrected(lights[""], ball, kept_views(self.run, place_of(self.run, probe), source))
            moments.append(_Moment(ball, lights, least_squares[frame].sh))
        return moments

    def _sessions(self, probe: Probe) -> dict[str, SessionParts]:
        """The session with each part perfect that a session can have."""
        run, was, place = self.run, self.as_it_was, place_of(self.run, probe)
        from_path = {frame: self._seen_views(frame) for frame in self.look_frames(probe)}
        from_object = {
            frame: [sight(seen, run.exposure) for seen, _ in kept_views(run, place, self._source(frame, probe))]
            for frame in self.look_frames(probe)
        }
        sessions = {
            "field_of_view": replace(was, looks=from_path),
            "coverage": replace(was, looks=from_object),
            "clipping": replace(was, estimator=Unclipped(run.estimator, run, self.sights)),
        }
        if self.phone.of_camera:
            perfect = replace(self.phone, of_camera=frozenset())
            sessions["sensor"] = replace(was, sights=sights_of_path(run, perfect))
        if was.link is not None:
            sessions["delay"] = replace(was, link=None, trigger=EVERY_FRAME)
        return sessions

    def _seen_views(self, frame: int) -> list[Sight]:
        """The pictures around the phone, as it sees them."""
        views = enumerate(kept_views(self.run, FROM_PATH, frame))
        seen = (self.phone.see(one, view_outputs(self.run, FROM_PATH, view))[0] for view, (one, _) in views)
        return [sight(one, self.run.exposure) for one in seen]

    def _corrected(self, light: ArrayF64, ball: SatinBall, views: Sequence[View]) -> dict[str, ArrayF64]:
        """`light` without what sampling and network get wrong on perfect input, and with the light no camera sees."""
        seen = light_of_views(views) * self.run.exposure
        nearest, means = lights_from_all_around(self.run.estimator, views, self.run.exposure)
        return {
            "sampling": light + means - nearest,
            "network": light + seen - means,
            "hidden_lamps": light + ball.light - seen,
        }


def lights_from_all_around(estimator: Estimator, views: Sequence[View], exposure: float) -> tuple[ArrayF64, ArrayF64]:
    """(9, 3) what `estimator` makes of six pictures around a position, of which nothing is clipped, at `exposure`.

    First from the nearest point in each anchor's direction, as the chain samples, then from the mean of all.
    """
    lower = exposure_without_clipping([radiance for _, radiance in views], exposure)
    position_m, lattice = views[0][0].world_from_camera[:3, 3], AnchorLattice(estimator.n_anchors)
    clouds = [with_radiance(sight(seen, exposure).points, radiance, lower) for seen, radiance in views]
    nearest = UnitSphereCloud.empty(estimator.n_anchors)
    for cloud in clouds:
        nearest = merge_in_sight(nearest, sample_unit_sphere(cloud, position_m, lattice))
    colours = linear_to_srgb(np.clip(means_of_anchors(views, lattice) * lower, 0, 1)).astype(np.float32)
    means = replace(nearest, srgb=colours * nearest.is_set[:, None])
    sensed = np.maximum(light_of_views(views)[0], 0) / np.sqrt(4 * np.pi)
    points = PointCloud(*(np.concatenate([getattr(one, part) for one in clouds]) for part in ("points_m", "srgb")))
    context = EstimateContext(replace(views[0][0], ambient=sensed), points, position_m, None, lower)
    of_nearest, of_means = (estimator.estimate(cloud, context) * (exposure / lower) for cloud in (nearest, means))
    return of_nearest, of_means


def _root_mean(squares: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(list(squares))))
