"""The better path: which second of looking away from the camera path would add most, for each virtual object?

The looks are tried on the kept session of a phone (`xihenet.camera_path.better_path`); nothing is rendered for that. On
request the advised look, random ones and a light probe at the object are rendered, to say how far the advice is right.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.scanner import open_scanner
from xihe_blender.capture.turned_camera import turned_camera
from xihe_blender.errors import UserError
from xihe_blender.io.json_records import as_json
from xihe_blender.io.kept_files import read_kept
from xihe_blender.io.look_results import LookAway, LookResults, ObjectAdvice, TrueErrors
from xihe_blender.io.outputs import write_json, write_picture
from xihe_blender.io.run_lights import as_rgb
from xihe_blender.jobs import Job, Progress
from xihe_blender.previs.kept_session import (
    CapturedPath,
    KeptSession,
    capture_path,
    measured_lights,
    open_kept_session,
    path_facts,
)
from xihe_blender.previs.placement import PlacementSettings, find_places
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.room_from_above import RoomFromAbove
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.report.look import write_look_report
from xihe_blender.scene.state import scene_kept
from xihenet.buffers import merge
from xihenet.camera import unproject_frame
from xihenet.camera_path.better_path import Advice, KnownRoom, Unseen, choose_look, guess_unseen
from xihenet.camera_path.looks import Look, LookSettings, looks_of, random_looks
from xihenet.completeness import coverage, share_from_behind
from xihenet.estimators import Estimator
from xihenet.io.recording import load_frame, save_frame
from xihenet.metrics import shc_rmse
from xihenet.records import ArrayF64, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

THE_MAP = "all places"
"""As the name of an object: the places of the placement map."""

MAP_PLACES = 60
"""Of the map, that the look is chosen for: one more costs 0.1 s for a path of 24 frames."""

PATH, LOOK, OBJECT = (240.0, 240.0, 240.0), (255.0, 140.0, 0.0), (80.0, 200.0, 255.0)
DIMMED = 0.7
"""Of the room's own brightness, so that what is drawn stands out."""

ARROW_M = 0.9
"""Of an arrow that points along the floor; one that points up is shorter, as seen from above."""

Targets = Mapping[str, Sequence[ArrayF64]]
"""Estimation positions ((3,) world, metres) by virtual object."""


@dataclass(frozen=True)
class LookWishes:
    """What is asked of the better path.

    Parameters
    ----------
    objects : names of virtual objects; None takes all
    is_for_map : one look for all places where an object could stand, and no virtual object
    is_verified : whether looks and light probes are rendered, for the true errors
    n_random : random looks for each object to compare the advised one with, where it is verified
    looks : how the phone may look away
    """

    objects: tuple[str, ...] | None = None
    is_for_map: bool = False
    is_verified: bool = False
    n_random: int = 1
    looks: LookSettings = field(default_factory=LookSettings)

    def __post_init__(self) -> None:
        if self.n_random < 0:
            raise UserError("--random: give 0 looks or more")


def better_path(
    scene: bpy.types.Scene,
    out: Path,
    settings: PrevisSettings,
    wishes: LookWishes,
    *,
    blend_file: Path,
    command: str = "",
) -> Job[LookResults]:
    """A job: where to look in `scene`, in the folder `out`: look.json, pictures and report.

    The captures are kept there and resumed. UserError for a scene without a camera or without a virtual object, and for
    an estimator that cannot look at a whole path.
    """
    check_sees_whole_path(settings)
    with contextlib.ExitStack() as held, scene_kept():
        objects = {} if wishes.is_for_map else object_positions(scene, settings, wishes.objects)
        captured = yield from capture_path(scene, out, settings, "a better path", held, blend_file=blend_file)
        if wishes.is_for_map:
            places_m, _ = yield from find_places(captured.session, PlacementSettings(most=MAP_PLACES))
            objects = {THE_MAP: list(places_m)}
        found = yield from find_looks(captured.session, objects, wishes.looks)
        if wishes.is_verified:
            found = yield from verify_looks(captured, found, wishes)
        results = LookResults(
            **path_facts(captured.run, blend_file, command, asdict(wishes.looks)),
            objects=tuple(one.advice for one in found),
        )
        yield Progress(1, 1, "writing the report")
        above = write_above(out, [one.seen for one in captured.session.frames], results)
        write_look_report(out / "report.html", results, above)
        write_json(out / "look.json", as_json(results))
        return results


def check_sees_whole_path(settings: PrevisSettings) -> None:
    """UserError for an estimator that asks for more than what the path has shown of each direction."""
    (estimator, *_) = load_estimators(settings)
    if estimator.needs:
        raise UserError(
            f"estimator {settings.estimator!r} needs more than the directions that the path has shown: choose lattice, "
            "xihenet or projection"
        )


def object_positions(scene: bpy.types.Scene, settings: PrevisSettings, wanted: tuple[str, ...] | None) -> Targets:
    """Where the light of each virtual object is estimated, in the first frame; UserError as of `plan_previs`."""
    plan = plan_previs(scene, replace(settings, objects=wanted))
    return {item.name: [probe.position_m for probe in plan.probes_of(item.name)] for item in plan.objects}


# ------------------------------------------------------------------------------------------------------------ the looks


@dataclass(frozen=True, eq=False)
class Target:
    """One virtual object: its positions, and what every frame of the path shows from each."""

    positions_m: Sequence[ArrayF64]
    sampled: Sequence[Sequence[UnitSphereCloud]]

    def clouds(self, frames: Sequence[int], look: Look | None = None, seen: Sequence[RgbdFrame] = (),
               exposure: float = 1.0) -> list[UnitSphereCloud]:  # fmt: skip
        """What is known from each position after the path, with the frames `seen` on a look in their place in it."""
        after = 0 if look is None else frames.index(look.frame) + 1
        points = [unproject_frame(frame, reference_exposure=exposure) for frame in seen]
        merged = []
        for position_m, of_one in zip(self.positions_m, self.sampled, strict=True):
            lattice = AnchorLattice(len(of_one[0]))
            of_look = [sample_unit_sphere(cloud, position_m, lattice) for cloud in points]
            parts = [*of_one[:after], *of_look, *of_one[after:]]
            merged.append(functools.reduce(merge, parts, UnitSphereCloud.empty(lattice.n)))
        return merged


@dataclass(frozen=True, eq=False)
class FoundLook:
    """An object's advice, and what it was found from."""

    advice: ObjectAdvice
    target: Target
    best: Advice


def find_looks(session: KeptSession, objects: Targets, settings: LookSettings) -> Job[list[FoundLook]]:
    """A job, a step per object: the best look for each, tried on the kept frames; nothing is rendered."""
    yield Progress(0, 1 + len(objects), "looking at what the path shows")
    lattice, (estimator, *_) = AnchorLattice(session.settings.n_anchors), load_estimators(session.settings)
    n_points = sum(one.seen.plane_depth_m.size for one in session.frames)
    room = KnownRoom.of_frames((one.unprojected(session.exposure) for one in session.frames), n_points)
    hull_m = room.hull_m(lattice)
    path = [(one.seen.frame, one.seen.world_from_camera) for one in session.frames]
    looks, found = looks_of(path, settings), []
    if not looks:
        raise UserError(f"no look is within {settings.largest_turn_deg:g} degrees of the path: give a larger --turn")
    for number, (name, positions_m) in enumerate(objects.items()):
        yield Progress(1 + number, 1 + len(objects), f"trying {len(looks)} looks for {name}")
        points = (one.unprojected(session.exposure) for one in session.frames)
        by_frame = [[sample_unit_sphere(cloud, place, lattice) for place in positions_m] for cloud in points]
        target = Target(positions_m, list(zip(*by_frame, strict=True)))
        clouds = target.clouds([frame for frame, _ in path])
        unseen = [guess_unseen(cloud, place, hull_m, lattice) for cloud, place in zip(clouds, positions_m, strict=True)]
        best = choose_look(looks, unseen, room, session.frames[0].seen.intrinsics, lattice, settings)
        found.append(FoundLook(_advice(name, target, unseen, best, estimator, settings), target, best))
    return found


def looks_of_run(folder: Path, objects: Targets) -> Job[list[ObjectAdvice]]:
    """A job: the advice for each object from the frames that the run in `folder` keeps; errors as there."""
    session = yield from open_kept_session(folder)
    check_sees_whole_path(session.settings)
    found = yield from find_looks(session, objects, LookSettings())
    return [one.advice for one in found]


def _advice(
    name: str, target: Target, unseen: Sequence[Unseen], best: Advice, estimator: Estimator, settings: LookSettings
) -> ObjectAdvice:
    before = [one.cloud for one in unseen]
    parts = zip(unseen, best.shown, target.positions_m, strict=True)
    after = [one.with_shown(shown, place) for one, shown, place in parts] if best.is_worth_it else before
    return ObjectAdvice(
        name=name,
        positions_m=tuple(as_rgb(place) for place in target.positions_m),
        coverage=float(np.mean([coverage(cloud) for cloud in before])),
        from_behind=float(np.mean([share_from_behind(cloud) for cloud in before])),
        expected_error=_expected_error(estimator, before),
        look=look_away(best.look, settings) if best.is_worth_it else None,
        gain=best.gain,
        predicted_coverage=float(np.mean([coverage(cloud) for cloud in after])),
        predicted_error=_expected_error(estimator, after),
    )


def _expected_error(estimator: Estimator, clouds: Sequence[UnitSphereCloud]) -> float | None:
    """Mean over the positions; None from an estimator that expects none, or where nothing was seen."""
    if not all(cloud.is_set.any() for cloud in clouds):
        return None
    errors = [estimator.estimate_with_error(cloud)[1] for cloud in clouds]
    known = [error for error in errors if error is not None]
    return float(np.mean(known)) if len(known) == len(errors) else None


def look_away(look: Look, settings: LookSettings) -> LookAway:
    """`look` as results say it."""
    return LookAway(
        frame=look.frame,
        words=look.words,
        yaw_deg=look.yaw_deg,
        pitch_deg=look.pitch_deg,
        turn_deg=look.turn_deg,
        hold_s=settings.hold_s,
        whole_s=settings.hold_s + 2 * look.turn_s(settings),
        place_m=as_rgb(look.end[:3, 3]),
        direction=as_rgb(-look.end[:3, 2]),
    )


# --------------------------------------------------------------------------------------------------------- verification


def verify_looks(captured: CapturedPath, found: Sequence[FoundLook], wishes: LookWishes) -> Job[list[FoundLook]]:
    """A job: the same with true errors, of objects that there is a look for; what is rendered is kept."""
    session, settings = captured.session, captured.run.settings
    path = [(one.seen.frame, one.seen.world_from_camera) for one in session.frames]
    rng = np.random.default_rng(settings.seed)
    chosen = [one for one in found if one.advice.look is not None]
    looks = [[one.best.look, *random_looks(path, wishes.n_random, rng, wishes.looks)] for one in chosen]
    seen = yield from render_looks(captured, [look for of_one in looks for look in of_one], wishes.looks)
    places_m = [place_m for one in chosen for place_m in one.target.positions_m]
    truths = iter((yield from measured_lights(captured.run, places_m)))
    estimator, frames, updated = captured.run.estimator, [frame for frame, _ in path], {}
    for one, of_one in zip(chosen, looks, strict=True):
        truth = [next(truths) for _ in one.target.positions_m]
        clouds = [one.target.clouds(frames)]
        clouds += [one.target.clouds(frames, look, seen[_name(look)], session.exposure) for look in of_one]
        before, after, *random_after = (_true_error(estimator, of_look, truth) for of_look in clouds)
        updated[one.advice.name] = TrueErrors(
            before=before,
            after=after,
            coverage_after=float(np.mean([coverage(cloud) for cloud in clouds[1]])),
            random_after=tuple(random_after),
            random_looks=tuple(look_away(look, wishes.looks) for look in of_one[1:]),
        )
    return [replace(one, advice=replace(one.advice, true_errors=updated.get(one.advice.name))) for one in found]


def _true_error(estimator: Estimator, clouds: Sequence[UnitSphereCloud], truth: Sequence[ArrayF64]) -> float:
    return float(np.mean([shc_rmse(estimator.estimate(c), light) for c, light in zip(clouds, truth, strict=True)]))


def _name(look: Look) -> str:
    """By which its captures are kept: its frame, and all that decides its pose."""
    pose = np.concatenate([look.start.ravel(), look.end.ravel()]).round(6)
    return f"{look.frame:04d}_{hashlib.sha256((pose + 0.0).tobytes()).hexdigest()[:12]}"


def render_looks(
    captured: CapturedPath, looks: Sequence[Look], settings: LookSettings
) -> Job[dict[str, list[RgbdFrame]]]:
    """A job: what the phone would see on each look, in order of time, by name; what is kept is not rendered."""
    run, folder = captured.run, captured.run.outputs.folder / "work"
    looks = list({_name(look): look for look in looks}.values())  # Objects may have the same.
    wanted = [(look, k, pose) for look in looks for k, pose in enumerate(look.poses(settings))]
    paths = [folder / f"look_{_name(look)}_{settings.frame_step_deg:g}_{k}.exr" for look, k, _ in wanted]
    missing = [k for k, path in enumerate(paths) if read_kept(path, load_frame) is None]
    if missing:
        with open_scanner(run.scene, run.capture) as scanner:
            scanner.exposure = run.exposure
            with turned_camera(scanner) as capture:
                for done, number in enumerate(missing):
                    look, _, pose = wanted[number]
                    yield Progress(done, len(missing), f"rendering a look {look.words} at frame {look.frame}")
                    save_frame(paths[number], capture(look.frame, pose))
    seen: dict[str, list[RgbdFrame]] = {_name(look): [] for look in looks}
    for (look, _, _), path in zip(wanted, paths, strict=True):
        seen[_name(look)].append(load_frame(path))
    return seen


# ---------------------------------------------------------------------------------------------------------- the picture


def write_above(folder: Path, frames: Sequence[RgbdFrame], results: LookResults) -> Path:
    """The room from above with the camera path, and an arrow for each look: `above.png`; its path."""
    path = folder / "pictures" / "above.png"
    cameras = np.array([frame.world_from_camera[:3, 3] for frame in frames])
    objects = np.array([place for one in results.objects for place in one.positions_m]).reshape(-1, 3)
    room = RoomFromAbove(frames, np.concatenate([cameras, objects]), ARROW_M, lambda _, srgb: 255 * DIMMED * srgb)
    for first, last in itertools.pairwise(cameras):
        room.line(first, last, PATH, 2)
    for camera in cameras:
        room.disc(camera, PATH, 3)
    for place in objects:
        room.disc(place, OBJECT, 6)
    for one in results.objects:
        if one.look is not None:
            _arrow(room, one.look)
    room.metre()
    write_picture(path, room.picture.round().astype(np.uint8))
    return path


def _arrow(room: RoomFromAbove, look: LookAway) -> None:
    start, along = np.array(look.place_m), np.array(look.direction)
    tip = start + ARROW_M * along
    room.line(start, tip, LOOK, 4)
    room.disc(start, LOOK, 6)
    for side in (-1, 1):
        room.line(tip, tip - 0.25 * ARROW_M * _turned(along, side), LOOK, 4)


def _turned(along: ArrayF64, side: int) -> ArrayF64:
    """`along` turned by 30 degrees about the vertical, as one side of an arrow's head."""
    c, s = np.cos(np.pi / 6), side * np.sin(np.pi / 6)
    turned: ArrayF64 = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ along
    return turned
