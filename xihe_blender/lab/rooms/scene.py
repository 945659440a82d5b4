"""How does a scene that somebody made become a room of a data set? Its camera path is the walk.

So that a report can say how estimators do in rooms that no rule of ours has drawn. The room is rendered as a capture
renders it, metered as a capture is; the positions are given objects, or where a previs run would estimate.
Chosen: one panorama per position, with the room as it is at the path's last frame, when all has been seen; so it is for
scenes whose light stands still. Positions are taken at the first frame, as a previs run takes them.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.capture.reference_probe import ReferenceLight, open_reference_probe
from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer, meter_exposure, open_scanner, phone_camera, sized_for
from xihe_blender.errors import UserError
from xihe_blender.jobs import Job, Progress
from xihe_blender.lab.rooms.build import write_manifest
from xihe_blender.lab.rooms.render_room import RoomRenderSettings, stored_lights
from xihe_blender.lab.rooms.store import (
    FORMAT_VERSION,
    MAX_FLOAT16,
    METERING,
    ArrayF16,
    StoredRoom,
    as_float16,
    load_room,
    room_path,
    save_room,
    stored_indices,
)
from xihe_blender.lab.rooms.views import PhoneView, RoomRays, lines_of_sight
from xihe_blender.previs.plan import plan_previs, planned_frames
from xihe_blender.previs.scene_faults import faults_at_frame
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.units import metres_per_unit
from xihe_blender.scene.virtual_objects import virtual_objects
from xihenet import __version__
from xihenet.camera import encode_exposed, in_view, valid_plane_depth
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, Intrinsics

SCENE_REGIME = "scene"
SMALLEST_FLOAT16 = 2.0**-21
"""Of which half floats still tell eighths."""

DARKEST_SHOWN = 3e-4
"""Of white: the first code above black in a picture of 8 bits."""

SCENE_SEED = 2**31 - 1
"""In the place of the data set's seed."""


def scene_seed(name: str) -> tuple[int, int]:
    """What a scene has for a seed: the same for the same name, whenever and wherever."""
    return SCENE_SEED, zlib.crc32(name.encode())


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

    Raises
    ------
    UserError if the scene cannot be used so, or the folder holds something else or cannot be written
    """
    if metres_per_unit(scene) != 1:
        raise UserError(f"scene {scene.name!r} has a unit scale other than 1: set it to 1, rooms are in metres")
    chosen = planned_frames(scene, frames)
    size = sized_for(scene, settings.view).size
    positions_m = scene_positions(scene, chosen, at)
    write_manifest(
        folder, {"format": FORMAT_VERSION, "scenes": True, "render": list(settings.numbers), "metering": METERING}
    )
    path = room_path(folder, _place_for(folder, name))
    total = len(chosen) + len(positions_m) + 1
    with scene_kept():
        yield Progress(0, total, "metering")
        exposure = meter_exposure(scene, chosen, metering=METERING)
        _check_can_be_stored(scene, exposure)
        pictures = []
        for picture in _pictures(scene, chosen, RenderSettings(size, settings.view_samples), positions_m):
            pictures.append(picture)
            yield Progress(len(pictures), total, f"{len(pictures)} of {len(chosen)} frames")
        lights = []
        with open_reference_probe(scene, positions_m, settings.probe()) as probe:
            for place in range(len(positions_m)):
                lights.append(probe.light_at(place, chosen[-1], exposure))
                yield Progress(len(pictures) + len(lights), total, f"{len(lights)} of {len(positions_m)} positions")
        save_room(path, _as_stored(name, pictures, exposure, positions_m, lights))
    yield Progress(total, total, f"{path.name} written")
    return path


def _check_can_be_stored(scene: bpy.types.Scene, exposure: float) -> None:
    """UserError if a file of half floats cannot hold the light that `exposure` shows, from black to white."""
    white = 1 / exposure
    if white > MAX_FLOAT16 or white * DARKEST_SHOWN < SMALLEST_FLOAT16:
        raise UserError(
            f"scene {scene.name!r} has its white at a radiance of {white:.3g}, which a data set cannot hold: "
            f"bring its lights between {SMALLEST_FLOAT16 / DARKEST_SHOWN:.2g} and {MAX_FLOAT16:g}"
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


@dataclass(frozen=True, eq=False)
class _Picture:
    """One frame: radiance (H, W, 3), plane depth (H, W), the camera, and which positions (P,) nothing hides."""

    radiance: ArrayF32
    plane_depth_m: ArrayF16
    intrinsics: Intrinsics
    world_from_camera: ArrayF64
    is_unhidden: ArrayBool


def _pictures(
    scene: bpy.types.Scene, frames: Sequence[int], settings: RenderSettings, positions_m: ArrayF64
) -> Iterator[_Picture]:
    """The frames of the path. UserError if the camera zooms."""
    first: Intrinsics | None = None
    with open_scanner(scene, settings) as scanner:
        for frame in frames:
            intrinsics, pose = scanner.move_to(frame)
            first = first or intrinsics
            if not np.isclose([intrinsics.fx, intrinsics.cx, intrinsics.cy], [first.fx, first.cx, first.cy]).all():
                raise UserError(f"the camera zooms before frame {frame}: give --frames with one focal length")
            view = PhoneView(pose, 0.0)
            is_unhidden = lines_of_sight(RoomRays.of(scanner.scene), [view], positions_m)[0]
            radiance, plane_depth_m = first_layer(render_passes(scanner.scene))
            seen = np.where(valid_plane_depth(plane_depth_m), plane_depth_m, np.float32(0))
            yield _Picture(radiance, as_float16(seen), intrinsics, pose, is_unhidden)


def _as_stored(
    name: str, pictures: Sequence[_Picture], exposure: float, positions_m: ArrayF64, lights: Sequence[ReferenceLight]
) -> StoredRoom:
    radiance = np.stack([picture.radiance for picture in pictures])
    camera = pictures[0].intrinsics
    return StoredRoom(
        srgb_u8=encode_exposed(radiance, exposure),
        radiance=as_float16(radiance),
        plane_depth_m=np.stack([picture.plane_depth_m for picture in pictures]),
        world_from_camera=np.stack([picture.world_from_camera for picture in pictures]),
        intrinsics=np.array([camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
        exposure=exposure,
        positions_m=positions_m,
        **stored_lights(lights),
        is_in_view=np.stack([in_view(positions_m, p.intrinsics, p.world_from_camera) for p in pictures]),
        is_unhidden=np.stack([picture.is_unhidden for picture in pictures]),
        seed=np.array(scene_seed(name), np.int64),
        kind=name,
        regime=SCENE_REGIME,
        versions=f"format {FORMAT_VERSION}, xihe {__version__}, Blender {bpy.app.version_string}",
    )


def _place_for(folder: Path, name: str) -> int:
    """The number of the scene `name` in `folder`, or the next free one. UserError for a file that is damaged."""
    there = list(stored_indices(folder))
    try:
        of_that_name = [index for index in there if load_room(room_path(folder, index)).kind == name]
    except ValueError as error:
        raise UserError(f"{error}: delete it to go on") from error
    return of_that_name[0] if of_that_name else max(there, default=-1) + 1
