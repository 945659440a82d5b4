"""Pictures all around a place: six of 90 degrees, as a phone would take them that looks everywhere.

Their colour and plane depth are those of captures, so that the chain takes them as further frames.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from mathutils import Matrix

from xihe_blender.capture.phone_surfaces import ask_for_surfaces
from xihe_blender.capture.render import RenderSettings
from xihe_blender.capture.scanner import CyclesScanner, first_layer, open_scanner, own_camera
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera import pixel_rays
from xihenet.records import ArrayF32, ArrayF64, Intrinsics, RgbdFrame
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

NAME = "Xihe All Around"
SMALLEST_SIDE_PX = 32
"""Of each picture; else it is the shorter side of the phone's own, whose pixels lie as close together, or closer."""

CLIP_START_M, CLIP_END_M = 0.001, 1e5
"""A place for an object may lie close above a table."""

N_VIEWS = 6
_ALONG = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64)


def view_rotation(view: int) -> ArrayF64:
    """(3, 3) world_from_camera of the `view`-th of six cameras, which look along +X, -X, +Y, -Y, +Z and -Z."""
    back = -_ALONG[view]
    up = np.array([0.0, 0.0, 1.0]) if view < 4 else np.array([0.0, 1.0, 0.0])
    return np.stack([np.cross(up, back), up, back], axis=1)


@dataclass
class AllAroundScanner:
    """Takes six pictures around a place; made by `open_all_around`."""

    scanner: CyclesScanner
    camera: bpy.types.Object

    def look(self, view: int, place_m: ArrayF64) -> tuple[RgbdFrame, ArrayF32]:
        """The `view`-th picture from `place_m` (3,), world, at the current frame, and its radiance (H, W, 3)."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = view_rotation(view), place_m / metres_per_unit(self.scanner.scene)
        self.camera.matrix_world = Matrix(pose.tolist())
        seen = self.scanner.acquire_environment_scan()
        return seen, first_layer(self.scanner.rendered)[0]


@contextlib.contextmanager
def open_all_around(
    scene: bpy.types.Scene, settings: RenderSettings, *, exposure: float, with_surfaces: bool
) -> Iterator[AllAroundScanner]:
    """In the room of `scene`, virtual objects left out; `with_surfaces` asks for what a range sensor meets.

    `settings` are those of the phone's captures; see SMALLEST_SIDE_PX.
    """
    side = max(SMALLEST_SIDE_PX, min(settings.size))
    with open_scanner(scene, replace(settings, size=(side, side))) as scanner, contextlib.ExitStack() as stack:
        camera, metres = own_camera(stack, scanner.scene, NAME), metres_per_unit(scene)
        camera.data.angle = np.pi / 2
        camera.data.clip_start, camera.data.clip_end = CLIP_START_M / metres, CLIP_END_M / metres
        scanner.exposure = exposure
        if with_surfaces:
            ask_for_surfaces(scanner.scene.view_layers[0])
        yield AllAroundScanner(scanner, camera)


def solid_angles(intrinsics: Intrinsics) -> ArrayF64:
    """(H, W) of the pixels of one of the six pictures, steradians; together a sixth of the sphere."""
    per_pixel = np.linalg.norm(pixel_rays(intrinsics), axis=-1) ** -3
    result: ArrayF64 = per_pixel * (4 * np.pi / N_VIEWS / per_pixel.sum())
    return result


def light_of_views(views: Sequence[tuple[RgbdFrame, ArrayF32]]) -> ArrayF64:
    """(9, 3) the light that six pictures around a place show: their radiance, not clipped, in scene radiance."""
    directions, radiance, solid_angle = _all_pixels(views)
    light: ArrayF64 = basis(directions, 2).T @ (radiance * solid_angle[:, None])
    return light


def means_of_anchors(views: Sequence[tuple[RgbdFrame, ArrayF32]], lattice: AnchorLattice) -> ArrayF64:
    """(N, 3) the mean scene radiance of all that six pictures around a place show in each anchor's directions."""
    directions, radiance, solid_angle = _all_pixels(views)
    return lattice.means(directions, radiance, solid_angle)[0]


def _all_pixels(views: Sequence[tuple[RgbdFrame, ArrayF32]]) -> tuple[ArrayF64, ArrayF64, ArrayF64]:
    """Of all pixels: unit directions (P, 3), radiance (P, 3), and solid angles (P,)."""
    rays = np.concatenate([(pixel_rays(s.intrinsics) @ s.world_from_camera[:3, :3].T).reshape(-1, 3) for s, _ in views])
    weights = np.concatenate([solid_angles(seen.intrinsics).ravel() for seen, _ in views])
    radiance = np.concatenate([np.nan_to_num(picture.reshape(-1, 3), posinf=0.0, neginf=0.0) for _, picture in views])
    return rays / np.linalg.norm(rays, axis=1, keepdims=True), radiance, weights
