"""The field's three spheres at a place in the room, path-traced: what an app's light should make of them.

Seen as `xihenet.light.light_picture` draws light: orthographic, horizontally along +Y, each filling its picture, and
each reflecting all light, so that constant light of radiance L shows L everywhere. The sphere is a part of the room.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from xihe_blender.capture.render import RenderSettings, render_passes
from xihe_blender.capture.scanner import first_layer, own_camera, working_room
from xihe_blender.scene.sphere_rig import RIG_LOOKS, rig_material, sphere_mesh
from xihe_blender.scene.units import metres_per_unit
from xihenet.light.light_picture import sphere_mask
from xihenet.records import ArrayF32, ArrayF64

NAME = "Xihe Three Spheres Seen"
RADIUS_M = 0.06


@dataclass
class ThreeSpheres:
    """Spheres in a working scene; made by `open_three_spheres`."""

    scene: bpy.types.Scene
    ball: bpy.types.Object
    materials: list[bpy.types.Material]

    def seen_at(self, frame: int, centre_m: ArrayF64, exposure: float) -> ArrayF32:
        """(S, 3 S, 3) radiance times `exposure` of mirror, matte silver and diffuse sphere, 0 around them.

        `centre_m` (3,) is in the world, metres.
        """
        scene, camera = self.scene, self.scene.camera
        metres = metres_per_unit(scene)
        self.ball.location = tuple(centre_m / metres)
        camera.location = tuple((centre_m - [0, 2 * RADIUS_M, 0]) / metres)
        scene.frame_set(frame)
        pictures = []
        for material in self.materials:
            self.ball.data.materials.clear()
            self.ball.data.materials.append(material)
            radiance, _ = first_layer(render_passes(scene))
            pictures.append(np.where(sphere_mask(len(radiance))[..., None], radiance, 0) * np.float32(exposure))
        return np.concatenate(pictures, axis=1)


@contextlib.contextmanager
def open_three_spheres(
    scene: bpy.types.Scene,
    settings: RenderSettings,
    size: int = 128,
    looks: Mapping[str, Mapping[str, Any]] = RIG_LOOKS,
) -> Iterator[ThreeSpheres]:
    """Three spheres, one at a time, in the room of `scene`, virtual objects left out, `size` pixels wide each.

    Other `looks`, inputs of the shader by name, take the place of the three, in their order; all are white.
    """
    with working_room(scene, NAME, replace(settings, size=(size, size))) as working, contextlib.ExitStack() as stack:
        radius = RADIUS_M / metres_per_unit(scene)
        mesh = sphere_mesh(NAME, radius, 128, 64)
        stack.callback(bpy.data.meshes.remove, mesh)
        materials = []
        for name, look in looks.items():
            materials.append(rig_material(f"{name} Seen", {**look, "Base Color": (1.0, 1.0, 1.0, 1.0)}))
            stack.callback(bpy.data.materials.remove, materials[-1])
        ball = bpy.data.objects.new(NAME, mesh)
        working.collection.objects.link(ball)
        camera = own_camera(stack, working, NAME)
        camera.data.type, camera.data.ortho_scale = "ORTHO", 2 * radius
        camera.data.clip_start, camera.data.clip_end = 0.5 * radius, 4 * radius
        camera.rotation_euler = (np.pi / 2, 0, 0)
        yield ThreeSpheres(working, ball, materials)
