"""Renders of a room: views of a phone, free ones or a walk's, and light probes, from one scene.

The phone's exposure is metered on the views themselves, as a capture meters it on its path: no further renders.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass

import bpy
import numpy as np
from mathutils import Matrix

from xihe_blender.capture.reference_probe import ProbeSettings, ReferenceLight, open_reference_probe
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner, phone_camera
from xihe_blender.errors import UserError
from xihe_blender.lab.rooms.build_room import build_room
from xihe_blender.lab.rooms.rooms import BY_DAY, VARIED, is_chosen, room_generator, sample_room, walk_generator
from xihe_blender.lab.rooms.settings import BuildSettings
from xihe_blender.lab.rooms.store import FORMAT_VERSION, METERING, ArrayF16, StoredRoom, as_float16
from xihe_blender.lab.rooms.varied_rooms import sample_varied_room
from xihe_blender.lab.rooms.views import N_VIEWS, PhoneView, RoomRays, RoomTooFull, sample_positions, sample_views
from xihe_blender.lab.rooms.walk import sample_walk
from xihenet import __version__
from xihenet.camera import encode_exposed, in_view, valid_plane_depth
from xihenet.phone.metering import metered_exposure
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, Intrinsics
from xihenet.training.rooms import split_of

MAX_REDRAWS = 20
MAX_EXPOSURE = 20.0
"""Above it, a room is nearly black: a probe of few samples does not find what little light there is."""


def make_room(settings: BuildSettings, index: int) -> StoredRoom:
    """Sample, build and render room `index` of the data set; the open file is replaced.

    With a walk, room, positions and their light are the same as without: the free views are drawn all the same. A room
    that offers too few places, or is nearly black, is drawn again from the same generator.
    UserError if Cycles cannot render.
    """
    seed = settings.seed
    rng = room_generator(seed, index)
    usual = functools.partial(sample_room, by_day=is_chosen(seed, index, settings.by_day, BY_DAY))
    sample = sample_varied_room if is_chosen(seed, index, settings.varied, VARIED) else usual
    for _ in range(MAX_REDRAWS):
        room = sample(rng)
        scene = build_room(room)
        rays = RoomRays.of(scene)
        try:
            positions_m = sample_positions(rng, room, rays)
            phone_views = sample_views(rng, room, rays, positions_m, settings.views or N_VIEWS)
        except RoomTooFull:
            continue
        if settings.walk is not None:
            phone_views = sample_walk(walk_generator(seed, index), room, rays, positions_m, phone_views, settings.walk)
        is_unhidden = np.stack([rays.reach(view.place_m, positions_m) for view in phone_views])
        pictures = render_views(scene, phone_views, settings.render.view)
        exposure = metered_exposure([p.radiance for p in pictures], METERING) * room.exposure_gain
        if exposure > MAX_EXPOSURE:
            continue
        probe = settings.render.probe(split_of((seed, index)))
        lights = list(reference_lights(scene, positions_m, probe, scene.frame_current, exposure))
        return stored_room(pictures, exposure, positions_m, is_unhidden, lights, seed=(seed, index), kind=room.kind,
                           regime=room.regime)  # fmt: skip
    raise UserError(f"room {index} of seed {seed}: no place for phone and objects, or no light, in {MAX_REDRAWS} draws")


@dataclass(frozen=True, eq=False)
class Picture:
    """One frame: radiance (H, W, 3), plane depth (H, W) or 0 where no surface was seen, the camera and its pose."""

    radiance: ArrayF32
    plane_depth_m: ArrayF16
    intrinsics: Intrinsics
    world_from_camera: ArrayF64


def take_picture(scene: bpy.types.Scene, intrinsics: Intrinsics, world_from_camera: ArrayF64) -> Picture:
    """Render the scene of a scanner, whose camera is this one."""
    radiance, plane_depth_m = first_layer(render_passes(scene))
    seen = np.where(valid_plane_depth(plane_depth_m), plane_depth_m, np.float32(0))
    return Picture(radiance, as_float16(seen), intrinsics, world_from_camera)


def render_views(scene: bpy.types.Scene, views: list[PhoneView], settings: RenderSettings) -> list[Picture]:
    """Render each view; all have the same field of view."""
    data = bpy.data.cameras.new("Phone")
    data.sensor_fit, data.angle = "HORIZONTAL", math.radians(views[0].fov_deg)
    data.clip_start, data.clip_end = 0.02, 200.0
    scene.camera = bpy.data.objects.new("Phone", data)
    scene.collection.objects.link(scene.camera)
    pictures = []
    with open_scanner(scene, settings) as scanner:
        for view in views:
            scene.camera.matrix_world = Matrix(view.world_from_camera.tolist())
            intrinsics, _ = phone_camera(scanner.scene)
            pictures.append(take_picture(scanner.scene, intrinsics, view.world_from_camera))
    return pictures


def reference_lights(
    scene: bpy.types.Scene, positions_m: ArrayF64, settings: ProbeSettings, frame: int, exposure: float
) -> Iterator[ReferenceLight]:
    """The reference light at each position, one after the other."""
    with open_reference_probe(scene, positions_m, settings) as probe:
        for index in range(len(positions_m)):
            yield probe.light_at(index, frame, exposure)


def stored_room(
    pictures: Sequence[Picture], exposure: float, positions_m: ArrayF64, is_unhidden: ArrayBool,
    lights: Sequence[ReferenceLight], *, seed: tuple[int, int], kind: str, regime: str,
) -> StoredRoom:  # fmt: skip
    """What is kept of V pictures, and of the light at P positions of which nothing hides some (V, P)."""
    radiance = np.stack([picture.radiance for picture in pictures])
    measured = [light.measured for light in lights]
    return StoredRoom(
        srgb_u8=encode_exposed(radiance, exposure),
        radiance=as_float16(radiance),
        plane_depth_m=np.stack([picture.plane_depth_m for picture in pictures]),
        world_from_camera=np.stack([picture.world_from_camera for picture in pictures]),
        intrinsics=np.array(astuple(pictures[0].intrinsics), np.float64),
        exposure=exposure,
        positions_m=positions_m,
        balls=as_float16(np.stack([_at_half_size(light.ball) for light in lights])),
        sh_ldr=np.stack([light.ldr for light in measured]),
        sh_hdr=np.stack([light.hdr for light in measured]),
        sh_noise=np.array([[light.ldr_noise or 0.0, light.hdr_noise or 0.0] for light in measured]),
        is_in_view=np.stack([in_view(positions_m, p.intrinsics, p.world_from_camera) for p in pictures]),
        is_unhidden=is_unhidden,
        seed=np.array(seed, np.int64),
        kind=kind,
        regime=regime,
        versions=f"format {FORMAT_VERSION}, xihe {__version__}, Blender {bpy.app.version_string}",
    )


def _at_half_size(picture: ArrayF32) -> ArrayF32:
    n = len(picture) // 2
    return np.asarray(picture.reshape(n, 2, n, 2, 3).mean(axis=(1, 3)))
