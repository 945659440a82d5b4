"""What does a room give? Views of a phone, five free ones or a walk's, and light probes, rendered from one scene.

The phone's exposure is metered on the views themselves, as a capture meters it on its path: no further renders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from xihe_blender.capture.reference_probe import ProbeSettings, ReferenceLight, open_reference_probe
from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, open_scanner, phone_camera
from xihe_blender.errors import UserError
from xihe_blender.lab.rooms.build_room import build_room
from xihe_blender.lab.rooms.room_data import Room
from xihe_blender.lab.rooms.rooms import room_generator, sample_room, walk_generator
from xihe_blender.lab.rooms.store import FORMAT_VERSION, METERING, StoredRoom, as_float16
from xihe_blender.lab.rooms.views import (
    PhoneView,
    RoomRays,
    RoomTooFull,
    lines_of_sight,
    sample_positions,
    sample_views,
)
from xihe_blender.lab.rooms.walk import sample_walk
from xihenet import __version__
from xihenet.camera import encode_exposed, in_view, valid_plane_depth
from xihenet.metering import metered_exposure
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, Intrinsics
from xihenet.training.rooms import Split, split_of

MAX_REDRAWS = 20


@dataclass(frozen=True)
class RoomRenderSettings:
    """Sizes in pixels and samples per pixel. The seed of Cycles is fixed: noise differs by room anyway.

    The reference probe takes `probe_samples` pictures, of `probe_size` pixels along a side of the mirror ball, an even
    number; they are stored at half that size. In training rooms it is `train_probe_size`: their noise averages out over
    the rooms, which cost half as much, and more rooms teach more than cleaner ones.
    """

    view_size: tuple[int, int] = (128, 96)
    view_samples: int = 4
    probe_size: int = 160
    probe_samples: int = 2
    train_probe_size: int = 80

    @property
    def view(self) -> RenderSettings:
        return RenderSettings(self.view_size, self.view_samples)

    def probe(self, split: Split = "test") -> ProbeSettings:
        """Of a room of that split."""
        size = self.train_probe_size if split == "train" else self.probe_size
        return ProbeSettings(size, self.probe_samples, noise_target=None)

    @property
    def numbers(self) -> tuple[int, ...]:
        """All of them, as a worker is told."""
        return *self.view_size, self.view_samples, self.probe_size, self.probe_samples, self.train_probe_size

    @classmethod
    def of(cls, numbers: Sequence[int]) -> RoomRenderSettings:
        """What `numbers` told. ValueError for another count."""
        width, height, *others = numbers
        return cls((width, height), *others)


def make_room(seed: int, index: int, settings: RoomRenderSettings, *, walk: int | None = None) -> StoredRoom:
    """Sample, build and render room `index` of the data set with `seed`; the open file is replaced.

    With `walk` the views are so many frames of a walk, and room, positions and their light are the same as without: the
    free views are drawn all the same. A room that offers too few places is drawn again from the same generator.
    UserError if Cycles cannot render.
    """
    rng = room_generator(seed, index)
    for _ in range(MAX_REDRAWS):
        room = sample_room(rng)
        scene = build_room(room)
        rays = RoomRays.of(scene)
        try:
            positions_m = sample_positions(rng, room, rays)
            views = sample_views(rng, room, rays, positions_m)
        except RoomTooFull:
            continue
        if walk is not None:
            views = sample_walk(walk_generator(seed, index), room, rays, positions_m, views, walk)
        is_unhidden = lines_of_sight(rays, views, positions_m)
        pictures = render_views(scene, views, settings.view)
        exposure = metered_exposure(pictures.radiance, METERING) * room.exposure_gain
        lights = render_probes(scene, positions_m, settings.probe(split_of((seed, index))), exposure)
        return _as_stored(room, (seed, index), views, pictures, exposure, positions_m, lights, is_unhidden)
    raise UserError(f"room {index} of seed {seed}: no place for phone and objects in {MAX_REDRAWS} draws")


@dataclass(frozen=True, eq=False)
class Pictures:
    """What the views give: radiance (V, H, W, 3), plane depth (V, H, W) in metres, the camera."""

    radiance: ArrayF32
    plane_depth_m: ArrayF32
    intrinsics: Intrinsics


def render_views(scene: bpy.types.Scene, views: list[PhoneView], settings: RenderSettings) -> Pictures:
    """Render each view; all have the same field of view."""
    data = bpy.data.cameras.new("Phone")
    data.sensor_fit, data.angle = "HORIZONTAL", math.radians(views[0].fov_deg)
    data.clip_start, data.clip_end = 0.02, 200.0
    scene.camera = bpy.data.objects.new("Phone", data)
    scene.collection.objects.link(scene.camera)
    radiance, plane_depth_m = [], []
    with open_scanner(scene, settings) as scanner:
        for view in views:
            scene.camera.matrix_world = Matrix(view.world_from_camera.tolist())
            intrinsics, _ = phone_camera(scanner.scene)
            colour, distance = first_layer(render_passes(scanner.scene))
            radiance.append(colour)
            plane_depth_m.append(np.where(valid_plane_depth(distance), distance, np.float32(0)))
    return Pictures(np.stack(radiance), np.stack(plane_depth_m), intrinsics)


def render_probes(
    scene: bpy.types.Scene, positions_m: ArrayF64, settings: ProbeSettings, exposure: float
) -> list[ReferenceLight]:
    """The reference light at each position."""
    with open_reference_probe(scene, positions_m, settings) as probe:
        return [probe.light_at(place, scene.frame_current, exposure) for place in range(len(positions_m))]


def stored_lights(lights: Sequence[ReferenceLight]) -> dict[str, Any]:
    """What a `StoredRoom` keeps of them."""
    return {
        "balls": as_float16(np.stack([_at_half_size(light.ball) for light in lights])),
        "sh_ldr": np.stack([light.measured.ldr for light in lights]),
        "sh_hdr": np.stack([light.measured.hdr for light in lights]),
        "sh_noise": np.array([[light.measured.ldr_noise or 0.0, light.measured.hdr_noise or 0.0] for light in lights]),
    }


def _at_half_size(picture: ArrayF32) -> ArrayF32:
    n = len(picture) // 2
    half: ArrayF32 = picture.reshape(n, 2, n, 2, 3).mean(axis=(1, 3))
    return half


def _as_stored(
    room: Room, seed: tuple[int, int], views: list[PhoneView], pictures: Pictures, exposure: float,
    positions_m: ArrayF64, lights: Sequence[ReferenceLight], is_unhidden: ArrayBool,
) -> StoredRoom:  # fmt: skip
    poses = np.stack([view.world_from_camera for view in views])
    camera = pictures.intrinsics
    return StoredRoom(
        srgb_u8=encode_exposed(pictures.radiance, exposure),
        radiance=as_float16(pictures.radiance),
        plane_depth_m=as_float16(pictures.plane_depth_m),
        world_from_camera=poses,
        intrinsics=np.array([camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
        exposure=exposure,
        positions_m=positions_m,
        **stored_lights(lights),
        is_in_view=np.stack([in_view(positions_m, camera, pose) for pose in poses]),
        is_unhidden=is_unhidden,
        seed=np.array(seed, np.int64),
        kind=room.kind,
        regime=room.regime,
        versions=f"format {FORMAT_VERSION}, xihe {__version__}, Blender {bpy.app.version_string}",
    )
