"""The scanner: what would the phone see? One Cycles render gives its colour and its plane depth.

The room without the virtual objects is rendered from the scene's camera at the frame in question. Colour is exposed,
clipped and encoded to 8 bits as a phone delivers it; plane depth is Cycles' Z pass, taken through the pixel centres.

Chosen: one exposure for the whole session, metered over a few frames of the path before it starts (a locked exposure,
as AR toolkits recommend for estimation). What a real sensor adds (noise, range, holes, exposure that lags) is added to
it in `simulated_phone`.
Paper: section 5, `EnvironmentScanner`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace

import bpy
import numpy as np

from xihe_blender.capture.render import (
    Rendered,
    RenderSettings,
    exclude_collection,
    render_passes,
    stacked_rgb,
    working_scene,
)
from xihe_blender.errors import UserError
from xihe_blender.scene.state import users_name
from xihe_blender.scene.units import metres_per_unit, seconds_of
from xihe_blender.scene.virtual_objects import virtual_collection
from xihenet.camera import encode_exposed, sensed_ambient, sound_plane_depth
from xihenet.phone.metering import Metering, metered_exposure
from xihenet.records import ArrayF32, ArrayF64, Intrinsics, RgbdFrame

SCENE_NAME = "Xihe Capture"

METERING_SAMPLES = 32
"""Noise looks like highlights, and like darkness: `living_room` has a key exposure of 1.44 at 8 samples, 0.96 at 32 and
0.87 denoised."""


@dataclass
class CyclesScanner:
    """An `EnvironmentScanner` that renders; made by `open_scanner`.

    `scene` is the working scene, `exposure` the factor of the session; `rendered` are all passes of the last scan.
    """

    scene: bpy.types.Scene
    exposure: float = 1.0
    rendered: Rendered = field(default_factory=lambda: Rendered({}, 0.0))

    def move_to(self, frame: int) -> tuple[Intrinsics, ArrayF64]:
        """Go to `frame` of the path; what the camera there is, without rendering."""
        self.scene.frame_set(frame)
        return phone_camera(self.scene)

    def acquire_environment_scan(self) -> RgbdFrame:
        return self.scan(*phone_camera(self.scene))

    def scan(self, intrinsics: Intrinsics, world_from_camera: ArrayF64) -> RgbdFrame:
        """What this camera sees, which may be a part of the scene's."""
        self.rendered = render_passes(self.scene)
        radiance, plane_depth_m = first_layer(self.rendered)
        colour = encode_exposed(radiance, self.exposure)
        sound_m, invalid = sound_plane_depth(plane_depth_m, radiance)
        return RgbdFrame(
            colour,
            sound_m,
            intrinsics,
            world_from_camera,
            self.exposure,
            sensed_ambient(colour, self.exposure),
            time_s=seconds_of(self.scene, self.scene.frame_current),
            frame=self.scene.frame_current,
            invalid=invalid,
        )


@contextlib.contextmanager
def open_scanner(scene: bpy.types.Scene, settings: RenderSettings) -> Iterator[CyclesScanner]:
    """A scanner of the room in `scene` as the phone sees it: virtual objects are left out."""
    with working_room(scene, SCENE_NAME, settings) as working:
        yield CyclesScanner(working)


@contextlib.contextmanager
def working_room(scene: bpy.types.Scene, name: str, settings: RenderSettings) -> Iterator[bpy.types.Scene]:
    """As `working_scene`, without the virtual objects."""
    with working_scene(scene, name, settings) as working:
        collection = virtual_collection(scene)
        if collection is not None:
            exclude_collection(working.view_layers[0].layer_collection, collection)
        yield working


def own_camera(stack: contextlib.ExitStack, working: bpy.types.Scene, name: str) -> bpy.types.Object:
    """A camera that the scene `working` alone has, and that no marker switches; gone with `stack`."""
    data = bpy.data.cameras.new(name)
    # With its data the object goes too. It is in no collection: those are the user's, and Cycles needs none.
    stack.callback(bpy.data.cameras.remove, data)
    working.timeline_markers.clear()
    working.camera = bpy.data.objects.new(name, data)
    return working.camera


def first_layer(rendered: Rendered) -> tuple[ArrayF32, ArrayF32]:
    """Radiance (H, W, 3) and plane depth (H, W) of a render with one view layer."""
    return stacked_rgb(rendered.passes), rendered.passes["Depth.Z"]


def phone_camera(scene: bpy.types.Scene) -> tuple[Intrinsics, ArrayF64]:
    """Intrinsics and (4, 4) world_from_camera, in metres, of the scene's camera at its current frame.

    Constraints, parents, drivers and markers that switch the camera are followed; the object's scale is left out, as
    Cycles leaves it out. UserError without a camera, for one that is not perspective, or one whose scale is 0.
    """
    camera = scene.camera
    if camera is None:
        raise UserError(f"scene {users_name(scene)!r} has no camera: add one and animate it as the phone's path")
    if camera.type != "CAMERA" or camera.data.type != "PERSP":
        kind = camera.data.type.lower() if camera.type == "CAMERA" else camera.type.lower()
        raise UserError(f"camera {camera.name!r} is {kind}: a phone's camera must be perspective (camera data > Type)")
    depsgraph = scene.view_layers[0].depsgraph
    depsgraph.update()
    evaluated = camera.evaluated_get(depsgraph)
    pose = np.array(evaluated.matrix_world, np.float64)
    if not np.isfinite(pose).all():
        raise UserError(
            f"camera {camera.name!r} has no finite position at frame {scene.frame_current}: "
            "check its location, its rotation and its constraints"
        )
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    if lengths.min() <= 1e-12:
        raise UserError(f"camera {camera.name!r} has a scale of 0 at frame {scene.frame_current}: set its scale to 1")
    pose[:3, :3] /= lengths
    pose[:3, 3] *= metres_per_unit(scene)
    return _intrinsics(evaluated, depsgraph, scene.render), pose


def _intrinsics(
    camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph, render: bpy.types.RenderSettings
) -> Intrinsics:
    """From Blender's own projection matrix, so that sensor fit, lens shift and pixel aspect are Blender's."""
    width, height = render.resolution_x, render.resolution_y
    projection = camera.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    return Intrinsics(
        width,
        height,
        fx=projection[0][0] * width / 2,
        fy=projection[1][1] * height / 2,
        cx=(1 - projection[0][2]) * width / 2,
        cy=(1 + projection[1][2]) * height / 2,
    )


def meter_exposure(
    scene: bpy.types.Scene,
    frames: Sequence[int],
    seed: int = 0,
    *,
    metering: Metering = "highlights",
    samples: int = METERING_SAMPLES,
) -> Generator[None, None, float]:
    """The session's exposure, metered over `metered_frames` of the path, a step each; see `metered_exposure`."""
    settings = RenderSettings((64, 48), samples, seed, denoise=False)
    pictures = []
    with open_scanner(scene, settings) as scanner:
        for frame in metered_frames(frames):
            yield
            scanner.move_to(frame)
            pictures.append(first_layer(render_passes(scanner.scene))[0])
    return metered_exposure(pictures, metering)


def metered_frames(frames: Sequence[int]) -> list[int]:
    """The first, the middle and the last frame of the path."""
    return sorted({frames[0], frames[len(frames) // 2], frames[-1]})


def sized_for(scene: bpy.types.Scene, settings: RenderSettings) -> RenderSettings:
    """`settings` turned upright if the scene's own picture is a portrait."""
    if scene.render.resolution_y > scene.render.resolution_x:
        return replace(settings, size=(min(settings.size), max(settings.size)))
    return settings
