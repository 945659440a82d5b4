"""A real mirror sphere at an estimation position, as the phone sees it: rendered with Cycles in the room.

The part of the phone's colour picture that shows the sphere, as fine as phones take it: a depth picture of 256x192 has
1920x1440 pixels of colour beside it. The sphere is a part of the room: it shades it and is reflected in it.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, render_only_part
from xihe_blender.capture.scanner import CyclesScanner, phone_camera, working_room
from xihe_blender.scene.sphere_rig import MIRROR, RIG_LOOKS, rig_material, sphere_mesh
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import part_around
from xihenet.records import ArrayF64, RgbdFrame

NAME = "Xihe Mirror Sphere Seen"
RADIUS_M = 0.06
FINER = 7.5
"""A phone's colour picture, by the pixels of its depth picture along a side."""

SMALLEST_PX = 4


@dataclass
class MirrorSphere:
    """A mirror sphere in a working scene; made by `open_mirror_sphere`."""

    scene: bpy.types.Scene
    ball: bpy.types.Object

    def seen_at(self, frame: int, centre_m: ArrayF64, exposure: float) -> tuple[RgbdFrame, float] | None:
        """What the phone's picture shows of the sphere around `centre_m` at `frame`, and the seconds of rendering.

        None where the sphere is not in view.
        """
        scene = self.scene
        self.ball.location = tuple(centre_m / metres_per_unit(scene))
        scene.frame_set(frame)
        render_only_part(scene, None)
        whole, pose = phone_camera(scene)
        corners_m = centre_m + RADIUS_M * np.array(np.meshgrid(*[(-1.2, 1.2)] * 3)).reshape(3, -1).T
        part = part_around(corners_m, whole, pose)
        if part is None or min(part.right - part.left, part.bottom - part.top) < SMALLEST_PX:
            return None
        render_only_part(scene, part)
        width, height = part.right - part.left, part.bottom - part.top
        camera = replace(whole, width=width, height=height, cx=whole.cx - part.left, cy=whole.cy - part.top)
        scanner = CyclesScanner(scene, exposure)
        return scanner.scan(camera, pose), scanner.rendered.render_s


@contextlib.contextmanager
def open_mirror_sphere(scene: bpy.types.Scene, settings: RenderSettings) -> Iterator[MirrorSphere]:
    """A mirror sphere in the room of `scene`, virtual objects left out, seen in a picture `FINER` than `settings`."""
    width, height = (round(FINER * side) for side in settings.size)
    with working_room(scene, NAME, replace(settings, size=(width, height))) as working, contextlib.ExitStack() as stack:
        mesh = sphere_mesh(NAME, RADIUS_M / metres_per_unit(scene), 128, 64)
        stack.callback(bpy.data.meshes.remove, mesh)
        material = rig_material(NAME, RIG_LOOKS[MIRROR])
        stack.callback(bpy.data.materials.remove, material)
        mesh.materials.append(material)
        ball = bpy.data.objects.new(NAME, mesh)
        working.collection.objects.link(ball)
        yield MirrorSphere(working, ball)
