"""The better camera: an animated camera that goes the path of the phone and does an advised look on the way.

Every frame of the path is keyed. The look is put in after its frame, so that the path goes on later by as many frames
as it takes; what else moves in the scene is not delayed. In a copy of the scene on request, or in the open file, where
`datablocks.better_path_camera` finds it and Remove Light takes it away.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np

from xihe_blender.apply.datablocks import BETTER_PATH, better_path_camera
from xihe_blender.apply.keyed_camera import quaternions
from xihe_blender.apply.keys import key_values, remove_animation
from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import phone_camera
from xihe_blender.errors import UserError
from xihe_blender.io.look_results import LookAway
from xihe_blender.scene.blend_file import save_copy
from xihe_blender.scene.state import scene_kept
from xihe_blender.scene.units import metres_per_unit
from xihenet.camera_path.looks import Look, turned_view
from xihenet.records import ArrayF64

FOLLOWED = "xihe_followed"
"""Custom property of the better camera: the camera whose path it goes, which comes back where it was in its place."""

LENS = ("lens", "shift_x", "shift_y", "sensor_width", "sensor_height")
"""What a zoom or a switch to another camera changes."""


def poses_with_look(path: Sequence[ArrayF64], index: int, away: LookAway, frames_per_s: float) -> list[ArrayF64]:
    """World_from_camera, (4, 4), of every frame: those of `path`, and after the `index`-th the look there and back.

    At least one frame is spent on the turn, on holding still and on the turn back, each.
    """
    start = path[index]
    look = Look(away.frame, away.yaw_deg, away.pitch_deg, start, turned_view(start, away.yaw_deg, away.pitch_deg))
    n_turn = max(1, math.ceil((away.whole_s - away.hold_s) / 2 * frames_per_s))
    n_hold = max(1, round(away.hold_s * frames_per_s))
    there = [look.pose(_softly(k / n_turn)) for k in range(1, n_turn + 1)]
    return [*path[: index + 1], *there, *[look.end] * n_hold, *there[-2::-1], start, *path[index + 1 :]]


def _softly(share: float) -> float:
    """The share of the turn that is done after a share of its time: it starts and ends at rest."""
    return share * share * (3 - 2 * share)


def add_better_camera(scene: bpy.types.Scene, away: LookAway) -> tuple[bpy.types.Object, int]:
    """The camera `Xihe Better Path` in the open file, in place of an earlier one, and its last frame.

    The scene's own camera stays in use. UserError where the look's frame is not in the scene's range any more.
    """
    frames = range(scene.frame_start, scene.frame_end + 1)
    if away.frame not in frames:
        raise UserError(f"frame {away.frame} is outside the scene's range now: ask where to look again")
    with scene_kept(), working_scene(scene, "Xihe Path", RenderSettings((64, 48), samples=1)) as working:
        path, lenses = zip(*(_pose_and_lens(working, frame) for frame in frames), strict=True)
    index = frames.index(away.frame)
    poses = poses_with_look(path, index, away, scene.render.fps / scene.render.fps_base)
    remove_better_camera()
    data = scene.camera.data.copy()
    data.name = BETTER_PATH
    data.animation_data_clear()  # Its action is that of the scene's own camera, where all keys would go.
    camera = bpy.data.objects.new(BETTER_PATH, data)
    camera[BETTER_PATH], camera[FOLLOWED] = away.frame, scene.camera
    scene.collection.objects.link(camera)
    camera.rotation_mode = "QUATERNION"
    keyed, poses_m = range(scene.frame_start, scene.frame_start + len(poses)), np.stack(poses)
    key_values(camera, "location", keyed, poses_m[:, :3, 3] / metres_per_unit(scene))
    key_values(camera, "rotation_quaternion", keyed, quaternions(poses_m[:, :3, :3]))
    values = np.insert(np.stack(lenses), [index + 1] * (len(poses) - len(path)), lenses[index], axis=0)
    if (values != [getattr(data, name) for name in LENS]).any():
        for name, column in zip(LENS, values.T, strict=True):
            key_values(data, name, keyed, column[:, None])
    return camera, keyed[-1]


def _pose_and_lens(scene: bpy.types.Scene, frame: int) -> tuple[ArrayF64, ArrayF64]:
    scene.frame_set(frame)
    pose = phone_camera(scene)[1]
    data = scene.camera.evaluated_get(scene.view_layers[0].depsgraph).data
    return pose, np.array([getattr(data, name) for name in LENS])


def remove_better_camera() -> None:
    """Take the camera away, with its data and its keys; a scene that looked through it has its own camera again."""
    camera = better_path_camera()
    if camera is not None:
        for scene in [scene for scene in bpy.data.scenes if scene.camera == camera]:
            scene.camera = camera.get(FOLLOWED)
        remove_animation(camera)
        remove_animation(camera.data)
        bpy.data.cameras.remove(camera.data)  # With its data the object goes too.


def check_camera_file(path: Path, blend_file: Path) -> None:
    """UserError unless `path` can be the copy of `blend_file` with the better camera."""
    if path.suffix.lower() != ".blend":
        raise UserError(f"{path} is no .blend: give --camera a file such as {path.with_suffix('.blend').name}")
    if path.exists() and path.samefile(blend_file):  # By its path alone ROOM.blend would be another, on macOS.
        raise UserError(f"{path} is the scene itself, which is not changed: give --camera another file")
    if path.exists() and not _has_better_camera(path):
        raise UserError(f"{path} is there already, and not of an earlier look: give --camera another file")


def _has_better_camera(path: Path) -> bool:
    with contextlib.suppress(OSError), bpy.data.libraries.load(str(path)) as (saved, _):
        return BETTER_PATH in saved.objects
    return False


def save_better_path(scene: bpy.types.Scene, away: LookAway, path: Path) -> None:
    """Save a copy of the open file whose scene goes the better path; the file itself stays as it is.

    Where that path has a look already, its camera is the scene's own, and is not replaced.
    """
    switches = {marker: marker.camera for marker in scene.timeline_markers if marker.camera is not None}
    own, last = scene.camera, scene.frame_end
    mark = own.pop(BETTER_PATH) if own == better_path_camera() else None
    try:
        camera, scene.frame_end = add_better_camera(scene, away)
        for marker in switches:  # They would take its place.
            marker.camera = None
        scene.camera = camera
        save_copy(scene, path, compress=True)
    finally:
        scene.camera, scene.frame_end = own, last
        for marker, before in switches.items():
            marker.camera = before
        remove_better_camera()
        if mark is not None:
            own[BETTER_PATH] = mark
