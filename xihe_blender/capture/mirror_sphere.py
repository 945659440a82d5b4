"""How does the phone see a real mirror sphere at an estimation position? Rendered with Cycles in the room.

The part of the phone's colour picture that shows the sphere, as fine as phones take it: a depth picture of 256x192 has
1920x1440 pixels of colour beside it. The sphere is a part of the room: it shades it and is reflected in it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, render_passes, working_scene
from xihe_blender.capture.scanner import first_layer, leave_out_virtual_objects, phone_camera, session_time_s
from xihe_blender.scene.sphere_rig import MIRROR, RIG_LOOKS, rig_material, sphere_mesh
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import encode_exposed, project_points, sound_plane_depth
from xihenet.records import ArrayF64, Intrinsics, RgbdFrame

NAME = "Xihe Mirror Sphere Seen"
RADIUS_M = 0.06
FINER = 7.5
"""A phone's colour picture, by the pixels of its depth picture along a side."""


@dataclass
class MirrorSphere:
    """A mirror sphere in a working scene; made by `open_mirror_sphere`."""

    scene: bpy.types.Scene
    ball: bpy.types.Object
    radius_m: float

    def seen_at(self, frame: int, centre_m: ArrayF64, exposure: float) -> tuple[RgbdFrame, float] | None:
        """What the phone's picture shows of the sphere around `centre_m` at `frame`, and the seconds of rendering.

        None where the sphere is not in view.
        """
        scene, render = self.scene, self.scene.render
        self.ball.location = tuple(centre_m / metres_per_unit(scene))
        scene.frame_set(frame)
        render.use_border = False
        whole, pose = phone_camera(scene)
        crop = _crop_around(whole, pose, centre_m, self.radius_m)
        if crop is None:
            return None
        (left, top, right, bottom), size = crop, (whole.width, whole.height)
        render.use_border = render.use_crop_to_border = True
        render.border_min_x, render.border_max_x = left / size[0], right / size[0]
        render.border_min_y, render.border_max_y = 1 - bottom / size[1], 1 - top / size[1]
        rendered = render_passes(scene)
        radiance, plane_depth_m = first_layer(rendered)
        sound_m, _ = sound_plane_depth(plane_depth_m, radiance)
        height, width = plane_depth_m.shape
        camera = replace(whole, width=width, height=height, cx=whole.cx - left, cy=whole.cy - top)
        picture = encode_exposed(radiance, exposure)
        time_s = session_time_s(scene)
        return RgbdFrame(picture, sound_m, camera, pose, exposure, time_s=time_s, frame=frame), rendered.render_s


def _crop_around(
    camera: Intrinsics, pose: ArrayF64, centre_m: ArrayF64, radius_m: float
) -> tuple[int, int, int, int] | None:
    """Left, top, right and bottom, in pixels, of what shows a sphere; None where it is beside the picture or behind."""
    corners = centre_m + radius_m * np.array(np.meshgrid(*[(-1.2, 1.2)] * 3)).reshape(3, -1).T
    pixels, depth_m = project_points(corners, camera, pose)
    if (depth_m <= 0).any():
        return None
    low, high = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    left, top = (int(max(value, 0)) for value in low)
    right, bottom = int(min(high[0], camera.width)), int(min(high[1], camera.height))
    return (left, top, right, bottom) if right - left >= 4 and bottom - top >= 4 else None


@contextlib.contextmanager
def open_mirror_sphere(
    scene: bpy.types.Scene, settings: RenderSettings, radius_m: float = RADIUS_M
) -> Iterator[MirrorSphere]:
    """A mirror sphere in the room of `scene`, virtual objects left out, seen in a picture `FINER` than `settings`."""
    width, height = (round(FINER * side) for side in settings.size)
    with (
        working_scene(scene, NAME, replace(settings, size=(width, height))) as working,
        contextlib.ExitStack() as stack,
    ):
        leave_out_virtual_objects(working, scene)
        mesh = sphere_mesh(NAME, radius_m / metres_per_unit(scene), 128, 64)
        stack.callback(bpy.data.meshes.remove, mesh)
        material = rig_material(NAME, RIG_LOOKS[MIRROR])
        stack.callback(bpy.data.materials.remove, material)
        mesh.materials.append(material)
        ball = bpy.data.objects.new(NAME, mesh)
        working.collection.objects.link(ball)
        yield MirrorSphere(working, ball, radius_m)
