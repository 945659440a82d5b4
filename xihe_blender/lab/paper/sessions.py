"""Sessions of the studies: walks through rooms, recorded once, as a phone would, and the true light in them.

A room is recorded as by `xihe record`; then, if its light stays the same, again from the kept captures with the true
light at places that the walk shows: its virtual objects first, then above upward surfaces all over the room. A path of
fewer frames than are wanted is recorded between them too, as a phone takes more pictures on the same walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from xihe_blender.errors import UserError, of_file
from xihe_blender.io.exr import read_radiance
from xihe_blender.io.json_records import Json
from xihe_blender.io.kept_files import kept_json, kept_or_done
from xihe_blender.io.outputs import check_names_differ
from xihe_blender.jobs import Job, part_of, run_blocking
from xihe_blender.lab.paper.records import Place, Session
from xihenet.camera_path.placement import evenly_chosen
from xihenet.captures import open_capture
from xihenet.io.json_files import read_json
from xihenet.left_out import score_places
from xihenet.records import ArrayF64, RgbdFrame

if TYPE_CHECKING:
    import bpy

    from xihe_blender.previs.plan import PrevisPlan
    from xihe_blender.previs.settings import PrevisSettings

SCENES = Path(__file__).parents[3] / "blend_scenes"
ROOMS = (
    "living_room", "bedroom_night", "cornell_box", "courtyard", "walk_around", "light_temperature", "light_intensity",
)  # fmt: skip


@dataclass(frozen=True)
class WalkSettings:
    """How much of each room is recorded: how many frames, their size, the preset of renders, places of the truth."""

    n_frames: int = 120
    size: tuple[int, int] = (256, 192)
    preset: str = "balanced"
    n_places: int = 12


@dataclass(frozen=True)
class WalkFacts:
    """What is known of a recorded walk besides its frames: places of the truth, and fields of `Session`."""

    positions_m: tuple[tuple[float, float, float], ...]
    names: tuple[str, ...]
    n_between: int
    is_steady: bool
    exposure: float
    capture_change: float | None


QUICK_WALK = WalkSettings(16, (192, 144), "draft", 4)
MOST_BETWEEN = 8
"""Frames that one of the path becomes, at most."""


def scene_files(given: Sequence[Path]) -> tuple[Path, ...]:
    """The user's scenes, or else ours. UserError for two of one name, and where ours are not there."""
    files = tuple(given) or tuple(SCENES / f"{name}.blend" for name in ROOMS)
    if missing := [file for file in files if not file.exists()]:
        fix = "no such file" if given else "run it from a checkout of the project, or give --scenes"
        raise UserError(f"{missing[0]}: {fix}")
    check_names_differ(files)
    return files


def check_session(file: Path, folder: Path, walk: WalkSettings, seed: int) -> None:
    """UserError for a scene that cannot be recorded, or whose session in `folder` is of files that have changed."""
    from xihe_blender.previs.record import check_recording

    scene, _, settings, _, _ = planned_walk(file, walk, seed)
    check_recording(scene, folder, settings, blend_file=file)


def recorded_session(file: Path, folder: Path, walk: WalkSettings, seed: int) -> Job[Session]:
    """A job: the session of the scene in `file`, recorded in `folder` unless it is there.

    UserError for a scene that cannot be recorded.
    """
    facts = yield from kept_or_done(WalkFacts, folder / "facts.json", _record(file, folder, walk, seed))
    return _session(file, folder, facts)


def open_walk(file: Path, n_between: int) -> bpy.types.Scene:
    """The scene in `file`, each frame of its path now `n_between` of them, of as many seconds together."""
    from xihe_blender.scene.blend_file import open_blend

    scene = open_blend(file)
    _slow_down(scene, n_between)
    return scene


def _slow_down(scene: bpy.types.Scene, n_between: int) -> None:
    if n_between > 1:
        scene.render.frame_map_old, scene.render.frame_map_new = 100, 100 * n_between
        scene.render.fps *= n_between
        scene.frame_end, scene.frame_start = scene.frame_end * n_between, scene.frame_start * n_between


def _n_between(scene: bpy.types.Scene, walk: WalkSettings) -> int:
    if (scene.render.frame_map_old, scene.render.frame_map_new) != (100, 100) or scene.frame_step != 1:
        return 1  # The user has a pace of their own.
    n_steps: int = max(1, scene.frame_end - scene.frame_start)
    return min(MOST_BETWEEN, max(1, (walk.n_frames - 1) // n_steps))


def planned_walk(
    file: Path, walk: WalkSettings, seed: int
) -> tuple[bpy.types.Scene, PrevisPlan, PrevisSettings, tuple[int, ...], int]:
    """The scene as `open_walk` has it, the plan of all of its path, the frames that are recorded, and its `n_between`.

    UserError as of a run.
    """
    from xihe_blender.previs.kept_session import path_plan
    from xihe_blender.previs.plan import plan_previs
    from xihe_blender.previs.settings import PrevisSettings
    from xihe_blender.scene.virtual_objects import virtual_objects

    scene = open_walk(file, 1)
    n_between = _n_between(scene, walk)
    _slow_down(scene, n_between)
    settings = PrevisSettings(preset=walk.preset, size=walk.size, seed=seed)
    with of_file(file):
        plan = plan_previs(scene, settings) if virtual_objects(scene) else path_plan(scene, settings)[1]
    frames = tuple(evenly_chosen(list(plan.frames), walk.n_frames))
    return scene, plan, replace(settings, frames=frames), frames, n_between


def _record(file: Path, folder: Path, walk: WalkSettings, seed: int) -> Job[WalkFacts]:
    from xihe_blender.previs.record import RecordWishes, record_session

    scene, plan, settings, frames, n_between = planned_walk(file, walk, seed)
    is_steady = _is_steady(scene, plan, frames)
    yield from part_of(2, 0, 1, record_session(scene, folder, settings, RecordWishes(), blend_file=file))
    capture = open_capture(folder)
    places = {probe.name: probe.at(frames[0]) for probe in plan.probes}
    found = score_places([one.read() for one in capture.frames], max(0, walk.n_places - len(places)))
    places |= {f"place_{k}": place_m for k, place_m in enumerate(found)}
    if not places:
        raise UserError(f"{file}: the walk shows no surface and no virtual object where light could be estimated")
    positions_m = tuple((float(x), float(y), float(z)) for x, y, z in places.values())
    if is_steady:
        wishes = RecordWishes(has_truth=True, at_m=positions_m)
        yield from part_of(
            2, 1, 1, record_session(open_walk(file, n_between), folder, settings, wishes, blend_file=file)
        )
    noise = kept_json(folder / "work" / "sample_count.json", dict) or {}
    exposure, change = capture.reference_exposure, noise.get("capture_change")
    assert exposure is not None
    return WalkFacts(positions_m, tuple(places), n_between, is_steady, exposure, change)


def _is_steady(scene: bpy.types.Scene, plan: PrevisPlan, frames: Sequence[int]) -> bool:
    """Whether light and room stay the same, and the virtual objects stay where they are."""
    from xihe_blender.light_transport.render_reuse import plan_render_reuse
    from xihe_blender.previs.survey import survey_path

    survey = run_blocking(survey_path(scene, plan))
    names = {frame: tuple(probe.name for probe in plan.probes) or ("room",) for frame in frames}
    reuse = plan_render_reuse(survey.states, names, survey.moved)
    return all(made_in == frames[0] for made_in in reuse.probes.values())


def _session(file: Path, folder: Path, facts: WalkFacts) -> Session:
    """What was recorded in `folder`, with the true light of a steady room."""
    frames: list[RgbdFrame] = [one.read() for one in open_capture(folder).frames]
    positions = [np.array(position_m) for position_m in facts.positions_m]
    lights: list[Json] = read_json(folder / "truth.json")["places"] if facts.is_steady else [{}] * len(positions)
    places = [_place(*one, folder) for one in zip(facts.names, positions, lights, strict=True)]
    return Session(file.stem, frames, facts.exposure, places, file, facts.capture_change, facts.n_between)


def _place(name: str, position_m: ArrayF64, light: dict[str, Json], folder: Path) -> Place:
    if not light:
        return Place(name, position_m)
    spheres = read_radiance(folder / light["files"]["spheres"])
    return Place(name, position_m, np.array(light["ldr"]), np.array(light["hdr"]), spheres)
