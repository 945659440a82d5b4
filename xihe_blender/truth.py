"""What light does really arrive at a position? A light probe, rendered: the panorama that a mirror sphere would see.

An equirectangular camera stands at the estimation position, upright and facing +Y, with the virtual objects left out.
Its light transport is the capture's. Cycles' clip start of 0.1 m would cut away the surface under a probe and turn the
lower half black, so the probe's begins at a millimetre.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import ArrayLike

from xihe_blender.capture import first_layer, leave_out_virtual_objects
from xihe_blender.render import RenderSettings, render_passes, working_scene
from xihe_blender.units import metres_per_unit
from xihenet.estimators.base import Target
from xihenet.records import ArrayF32, ArrayF64
from xihenet.sh import project_panorama

SCENE_NAME = "Xihe Truth"
CLIP_START_M, CLIP_END_M = 0.001, 1e5


@dataclass
class LightProbe:
    """Renders panoramas; made by `open_light_probe`. `render_s` is of the last one."""

    scene: bpy.types.Scene
    render_s: float = 0.0

    def stand_at(self, position_m: ArrayLike) -> None:
        """Put the probe at `position_m` (world, metres)."""
        self.scene.camera.location = tuple(np.asarray(position_m, np.float64) / metres_per_unit(self.scene))

    def panorama(self, position_m: ArrayLike, frame: int) -> ArrayF32:
        """(H, W, 3) scene radiance at `position_m` (world, metres); row 0 is up, the middle column looks along +Y."""
        self.stand_at(position_m)
        self.scene.frame_set(frame)
        rendered = render_passes(self.scene)
        self.render_s = rendered.render_s
        return first_layer(rendered)[0]


@contextlib.contextmanager
def open_light_probe(scene: bpy.types.Scene, settings: RenderSettings) -> Iterator[LightProbe]:
    """A light probe in the room of `scene`; `settings.size` should be twice as wide as high."""
    with working_scene(scene, SCENE_NAME, settings) as working:
        leave_out_virtual_objects(working, scene)
        # Markers that switch the camera would take the probe's place.
        working.timeline_markers.clear()
        with _panoramic_camera(working) as camera:
            working.camera = camera
            yield LightProbe(working)


def probe_radiance_sh(panorama: ArrayF32, exposure: float, target: Target) -> ArrayF64:
    """(9, 3) radiance coefficients of a panorama of scene radiance, carrying `exposure`.

    "ldr" clips every texel to [0, 1] after exposure, as a phone's picture does; "hdr" keeps all, negative light too.
    ValueError if the panorama holds NaN or infinite texels.
    """
    exposed = np.asarray(panorama, np.float64) * exposure
    return project_panorama(np.clip(exposed, 0.0, 1.0) if target == "ldr" else exposed)


@contextlib.contextmanager
def _panoramic_camera(scene: bpy.types.Scene) -> Iterator[bpy.types.Object]:
    data = bpy.data.cameras.new(SCENE_NAME)
    camera = bpy.data.objects.new(SCENE_NAME, data)
    try:
        data.type = "PANO"
        panorama = data if hasattr(data, "panorama_type") else data.cycles
        panorama.panorama_type = "EQUIRECTANGULAR"
        data.clip_start, data.clip_end = (metres / metres_per_unit(scene) for metres in (CLIP_START_M, CLIP_END_M))
        camera.rotation_euler = (math.pi / 2, 0.0, 0.0)
        # Not linked to a collection: those are the user's. Cycles needs only the scene to point at it.
        scene.camera = camera
        yield camera
    finally:
        bpy.data.objects.remove(camera)
        bpy.data.cameras.remove(data)
