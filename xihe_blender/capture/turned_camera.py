"""A turned camera: what would the phone see if it stood in its path and looked elsewhere?

The path's own camera, its lens and sensor, at any pose: a second camera object that shares its data, in the scanner's
working scene. Focus on an object and what hangs on the camera object, such as its constraints, stay behind.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

import bpy
from mathutils import Matrix

from xihe_blender.capture.scanner import CyclesScanner
from xihe_blender.scene.units import metres_per_unit
from xihenet.records import ArrayF64, RgbdFrame

NAME = "Xihe Turned Camera"


@contextlib.contextmanager
def turned_camera(scanner: CyclesScanner) -> Iterator[Callable[[int, ArrayF64], RgbdFrame]]:
    """A function that captures a frame of the path from a pose, (4, 4) world_from_camera in metres.

    The scanner looks along its path again afterwards, except that markers no longer switch its cameras.
    """
    scene, metres = scanner.scene, metres_per_unit(scanner.scene)
    bound = [marker for marker in scene.timeline_markers if marker.camera is not None]
    # As Blender does it: of two at one frame the first one counts.
    switches = {marker.frame: marker.camera for marker in reversed(bound) if not marker.camera.hide_render}
    own = scene.camera
    # In no collection: those are the user's, and Cycles needs none.
    turned = bpy.data.objects.new(NAME, own.data)

    def capture(frame: int, world_from_camera: ArrayF64) -> RgbdFrame:
        # The first one is also that of the frames before it.
        reached = max((at for at in switches if at <= frame), default=min(switches, default=None))
        turned.data = own.data if reached is None else switches[reached].data
        pose = world_from_camera.copy()
        pose[:3, 3] /= metres
        turned.matrix_world = Matrix(pose)
        scene.frame_set(frame)
        return scanner.acquire_environment_scan()

    try:
        # They would take its place.
        scene.timeline_markers.clear()
        scene.camera = turned
        yield capture
    finally:
        scene.camera = own
        bpy.data.objects.remove(turned)
