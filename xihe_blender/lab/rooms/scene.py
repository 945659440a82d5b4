"""A scene that somebody made, as a room of a data set: its camera path is the walk.

So that a report can say how estimators do in rooms that no rule of ours has drawn. The room is rendered as a capture
renders it, metered as a capture is; the positions are given objects, or where a previs run would estimate.
Chosen: one panorama per position, with the room as it is at the path's last frame, when all has been seen; so it is for
scenes whose light stands still. Positions are taken at the first frame, as a previs run takes them.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import meter_exposure, open_scanner, phone_camera, sized_for
from xihe_blender.errors import UserError
from xihe_blender.jobs import Job, Progress, shown
from xihe_blender.lab.rooms import store
from xihe_blender.lab.rooms.build import rooms_held
from xihe_blender.lab.rooms.render_room import Picture, reference_lights, stored_room, take_picture
from xihe_blender.lab.rooms.settings import RoomRenderSettings
from xihe_blender.lab.rooms.views import RoomRays
from xihe_blender.previs.plan import plan_previs, planned_frames
from xihe_blender.previs.scene_faults import faults_at_frame
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet.records import ArrayBool, ArrayF64, Intrinsics

SCENE_SETTINGS = RoomRenderSettings(view_samples=16, probe_samples=48, noise_target=0.03)
"""Estimators are judged by scenes. In training rooms noise averages out; here it would count as error."""
SCENE_REGIME = "scene"
SMALLEST_FLOAT16 = 2.0**-21  # Of which half floats still tell eighths
DARKEST_SHOWN = 3e-4  # Of white: the first code above black in a picture of 8 bits
SCENE_SEED = 2**31 - 1  # In the place of the data set's seed; the room's number is the CRC-32 of the scene's name


def add_scene(
    scene: bpy.types.Scene, name: str, folder: Path, settings: RoomRenderSettings, *,
    frames: Sequence[int] | None = None, at: Sequence[str] | None = None,
) -> Job[Path]:  # fmt: skip
    """Render `scene` and store it under `name` in `folder`, in the place of one of that name; returns the file.

    Parameters
    ----------
    scene : of the open file, with a camera path; what is in its virtual collection is left out
    name : stored as the room's kind
    folder : of scenes made with the same settings; made if missing
    frames : of the camera path; None for the scene's range and step
    at : names of the objects whose world locations are the positions; None for where a previs run would estimate

    UserError if the scene cannot be used so, or the folder holds something else or cannot be written.
    """
    if metres_per_unit(scene) != 1:
        raise UserError(f"scene {scene.name!r} has a unit scale other than 1: set it to 1, rooms are in metres")
    chosen = planned_frames(scene, frames)
    size = sized_for(scene, settings.view).size
    positions_m = scene_positions(scene, chosen, at)
    shared = {"render": settings.numbers, "noise_target": settings.noise_target, "metering": store.METERING}
    total = len(chosen) + len(positions_m) + 1
    with rooms_held(folder, {"format": store.FORMAT_VERSION, "scenes": True, **shared}), scene_kept():
        metering = meter_exposure(scene, chosen, metering=store.METERING)
        exposure = yield from shown(metering, Progress(0, total, "metering"))
        _check_can_be_stored(scene, exposure)
        pictures, is_unhidden = [], []
        for picture, unhidden in _pictures(scene, chosen, RenderSettings(size, settings.view_samples), positions_m):
            pictures.append(picture)
            is_unhidden.append(unhidden)
            yield Progress(len(pictures), total, f"{len(pictures)} of {len(chosen)} frames")
        lights = []
        for light in reference_lights(scene, positions_m, settings.probe(), chosen[-1], exposure):
            lights.append(light)
            yield Progress(len(pictures) + len(lights), total, f"{len(lights)} of {len(positions_m)} positions")
        room = stored_room(pictures, exposure, positions_m, np.stack(is_unhidden), lights,
                           seed=(SCENE_SEED, zlib.crc32(name.encode())), kind=name, regime=SCENE_REGIME)  # fmt: skip
        path = store.room_path(folder, _place_for(folder, name))
        store.save_room(path, room)
    yield Progress(total, total, f"{path.name} written")
    return path


def _check_can_be_stored(scene: bpy.types.Scene, exposure: float) -> None:
    """UserError if a file of half floats cannot hold the light that `exposure` shows, from black to white."""
    white = 1 / exposure
    if white > store.MAX_FLOAT16 or white * DARKEST_SHOWN < SMALLEST_FLOAT16:
        raise UserError(
            f"scene {scene.name!r} has its white at a radiance of {white:.3g}, which a data set cannot hold: "
            f"bring its lights between {SMALLEST_FLOAT16 / DARKEST_SHOWN:.2g} and {store.MAX_FLOAT16:g}"
        )


def scene_positions(scene: bpy.types.Scene, frames: Sequence[int], at: Sequence[str] | None) -> ArrayF64:
    """(P, 3) world positions at the first of `frames`. UserError if there are none or a camera cannot be used."""
    if at is None and not virtual_objects(scene):
        raise UserError(
            f"scene {scene.name!r} has no virtual object: name the objects that mark positions with --at A,B"
        )
    unknown = [name for name in at or () if name not in scene.objects]
    if unknown or (at is not None and not at):
        missing = f"there is no object {unknown[0]!r}" if unknown else "no object is chosen"
        raise UserError(f"{missing} in scene {scene.name!r}: give names of its objects to --at, separated by commas")
    with working_scene(scene, "Xihe Plan", RenderSettings((8, 6), samples=1)) as working:
        depsgraph = working.view_layers[0].depsgraph
        for frame in reversed(frames):
            working.frame_set(frame)
            phone_camera(working)
            faults_at_frame(depsgraph, is_first=frame == frames[-1])
        if at is None:
            planned = plan_previs(scene, PrevisSettings(frames=tuple(frames)))
            return np.array([probe.position_m for probe in planned.probes])
        places = [scene.objects[name].evaluated_get(depsgraph).matrix_world.translation for name in at]
        positions_m = np.array([tuple(place) for place in places], np.float64)
    for name, position_m in zip(at, positions_m, strict=True):
        if not np.isfinite(position_m).all():
            raise UserError(f"object {name!r} has no finite position: check its location and its constraints")
    return positions_m


def _pictures(
    scene: bpy.types.Scene, frames: Sequence[int], settings: RenderSettings, positions_m: ArrayF64
) -> Iterator[tuple[Picture, ArrayBool]]:
    """The frames of the path, and which positions (P,) nothing hides. UserError if the camera zooms."""
    first: Intrinsics | None = None
    with open_scanner(scene, settings) as scanner:
        for frame in frames:
            intrinsics, pose = scanner.move_to(frame)
            first = first or intrinsics
            if not np.isclose([intrinsics.fx, intrinsics.cx, intrinsics.cy], [first.fx, first.cx, first.cy]).all():
                raise UserError(f"the camera zooms before frame {frame}: give --frames with one focal length")
            is_unhidden = RoomRays.of(scanner.scene).reach(pose[:3, 3], positions_m)
            yield take_picture(scanner.scene, intrinsics, pose), is_unhidden


def _place_for(folder: Path, name: str) -> int:
    """The number of the scene `name` in `folder`, or the next free one. UserError for a file that is damaged."""
    there = list(store.stored_indices(folder))
    try:
        of_that_name = [index for index in there if store.load_room(store.room_path(folder, index)).kind == name]
    except ValueError as error:
        raise UserError(f"{error}: delete it and run again") from error
    return of_that_name[0] if of_that_name else max(there, default=-1) + 1
