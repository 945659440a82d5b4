"""The staging of every scene: its settings, the phone and its walk, the virtual objects, the saved file.

The phone moves by one key per frame instead of a path constraint: what a recorded walk looks like, and nothing for a
reader to evaluate. Time: 24 captured frames are every 15th of a 30 Hz phone, that is 12 s of walking.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Vector

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # a clone builds its scenes without being installed

from xihe_blender.lab.props.shapes import Solid, add_solid
from xihe_blender.scene.virtual_objects import virtual_collection

N_FRAMES = 24
PHONE_WIDTH_FOV_DEG = 66.0


def open_stage(name: str) -> tuple[bpy.types.Scene, bpy.types.Collection]:
    """An empty file with the common settings; returns its scene and the collection `Room`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.name = name
    scene.unit_settings.system, scene.unit_settings.length_unit = "METRIC", "METERS"
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 16, False
    scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 256, 192, 100
    scene.render.filepath = "//"
    scene.render.fps, scene.render.fps_base = 30, 15.0
    scene.frame_start, scene.frame_end = 1, N_FRAMES
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.display_settings.display_device = "sRGB"
    room = bpy.data.collections.new("Room")
    scene.collection.children.link(room)
    return scene, room


def add_virtual(
    scene: bpy.types.Scene, name: str, solid: Solid, material: bpy.types.Material, location: Sequence[float]
) -> bpy.types.Object:
    """A smooth virtual object that stands on `location`."""
    return add_solid(virtual_collection(scene, create=True), name, solid, material, location=location, smooth=True)


def add_phone(scene: bpy.types.Scene) -> bpy.types.Object:
    """The camera `Phone`, active in the scene."""
    data = bpy.data.cameras.new("Phone")
    data.sensor_fit = "HORIZONTAL"
    data.angle = math.radians(PHONE_WIDTH_FOV_DEG)
    data.clip_start, data.clip_end = 0.02, 200.0
    phone = bpy.data.objects.new("Phone", data)
    scene.collection.objects.link(phone)
    scene.camera = phone
    return phone


def arc(
    centre: Sequence[float], radius: float, degrees: tuple[float, float], heights: tuple[float, float]
) -> np.ndarray:
    """Positions (N_FRAMES, 3) along an arc around a point; the height goes from one value to the other."""
    angles = np.radians(np.linspace(*degrees, N_FRAMES))
    rise = np.linspace(*heights, N_FRAMES)
    return np.stack([centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles), rise], axis=-1)


def hand_shake(rng: np.random.Generator, amplitude: float, n_channels: int) -> np.ndarray:
    """Smooth unrest (N_FRAMES, n_channels): a few sines per channel with random phases."""
    time = np.arange(N_FRAMES)[:, None] / N_FRAMES
    unrest = np.zeros((N_FRAMES, n_channels))
    for cycles in (1.3, 2.9, 5.3):
        unrest += np.sin(2 * np.pi * (cycles * time + rng.uniform(size=n_channels))) / cycles**0.5
    return amplitude * unrest / 1.5


def walk_phone(
    scene: bpy.types.Scene,
    positions: np.ndarray,
    targets: np.ndarray,
    *,
    seed: int,
    shake_m: float = 0.025,
    shake_deg: float = 1.6,
) -> bpy.types.Object:
    """Key the phone at each frame: at `positions`, looking at `targets` (each (N_FRAMES, 3)), in an unsteady hand."""
    rng = np.random.default_rng(seed)
    places = positions + hand_shake(rng, shake_m, 3) * (1.0, 1.0, 0.8)
    tilts = np.radians(hand_shake(rng, shake_deg, 3))
    phone, previous = add_phone(scene), Euler()
    for i, frame in enumerate(range(scene.frame_start, scene.frame_end + 1)):
        look = Vector((targets[i] - places[i]).tolist()).to_track_quat("-Z", "Y")
        unsteady = look @ Euler(tilts[i].tolist()).to_quaternion()
        previous = unsteady.to_euler("XYZ", previous)
        phone.location, phone.rotation_euler = places[i].tolist(), previous
        phone.keyframe_insert("location", frame=frame)
        phone.keyframe_insert("rotation_euler", frame=frame)
    return phone


def hold_phone(
    scene: bpy.types.Scene, position: Sequence[float], target: Sequence[float], *, seed: int
) -> bpy.types.Object:
    """A phone held in place: it only shakes."""
    held = [np.tile(np.asarray(point, float), (N_FRAMES, 1)) for point in (position, target)]
    return walk_phone(scene, *held, seed=seed, shake_m=0.004, shake_deg=0.3)


def finish(scene: bpy.types.Scene) -> None:
    """Go to the first frame, drop what nobody uses, and let a window open on the phone's view."""
    scene.frame_set(scene.frame_start)
    bpy.data.orphans_purge(do_local_ids=True, do_linked_ids=True, do_recursive=True)
    for space in (s for screen in bpy.data.screens for area in screen.areas for s in area.spaces):
        if space.type == "VIEW_3D":
            space.region_3d.view_perspective = "CAMERA"
            space.shading.type = "MATERIAL"
        elif space.type == "FILE_BROWSER" and space.params is not None:
            space.params.directory = b"//"  # else the file tells the home folder of who built it


def save(path: Path) -> None:
    """Write the open file compressed, beside its place first and then into it."""
    bpy.context.preferences.filepaths.save_version = 0
    beside = path.with_name(path.stem + ".part.blend")
    bpy.ops.wm.save_as_mainfile(filepath=str(beside), compress=True, relative_remap=False, copy=True)
    beside.replace(path)


def build_file(build: Callable[[], bpy.types.Scene], out: Path) -> None:
    """Build one scene into a .blend and say how big it is."""
    finish(build())
    save(out.resolve())
    print(f"{out.name}: {out.stat().st_size / 1e6:.2f} MB")


def main(build: Callable[[], bpy.types.Scene], script: str) -> None:
    """The command line of one build script: `--out FILE`, the scene beside the script by default."""
    default = Path(script).with_name(Path(script).stem.removeprefix("build_") + ".blend")
    parser = argparse.ArgumentParser(description="Build one scene.")
    parser.add_argument("--out", type=Path, default=default, help="the .blend to write")
    build_file(build, parser.parse_args().out)
