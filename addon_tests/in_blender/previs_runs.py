"""Small runs of the main job: a walk through the tiny room with all that a run has to cope with."""

import contextlib
from dataclasses import dataclass, replace

import bpy
from tiny_scenes import box, key, look_at, material, room_with_a_virtual_sphere

from xihe_blender.capture.render import can_denoise
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.virtual_objects import virtual_collection


@dataclass(frozen=True)
class QuickPrevis(PrevisSettings):
    """Light probes of a fortieth of the rays, and metering of a sixteenth, for tests that are about neither."""

    metering_samples = 2

    @property
    def reference(self):
        return replace(super().reference, size=48, max_samples=2)


DRAFT = {"preset": "draft", "size": (32, 24)}
if not can_denoise(bpy.context.scene):
    # Noise would trigger an estimate in every frame.
    DRAFT["noise_target"] = 0.01
SMALL = QuickPrevis(**DRAFT)
SMALL_AS_SHIPPED = PrevisSettings(**DRAFT)
N_FRAMES = 5
LOOKS_AWAY = 3
"""The frame of `walk` in which no virtual object is in view."""


def walk(n_frames=N_FRAMES):
    """A ball, a board that needs two positions, a phone that looks away once, a lamp that is dimmed after that."""
    scene = room_with_a_virtual_sphere(n_frames)
    board = material("Board", (0.8, 0.3, 0.2))
    box(scene, "Board", (0, 1.2, 0.9), (1.6, 0.1, 0.1), board, virtual_collection(scene))
    look_away(scene.camera, LOOKS_AWAY)
    strength = bpy.data.materials["Light"].node_tree.nodes["Emission"].inputs["Strength"]
    key(strength, "default_value", {LOOKS_AWAY: 6.0, LOOKS_AWAY + 1: 1.0})
    return scene


def look_away(camera, frame):
    """Turn the phone away from the middle of the room at `frame`."""
    look_at(camera, (-0.6, -1.5, 1.5), (-0.6, -3.0, 1.5))
    camera.keyframe_insert("location", frame=frame)
    camera.keyframe_insert("rotation_euler", frame=frame)


def run(scene, out, settings=SMALL):
    """A whole run; its results."""
    return run_blocking(previs(scene, out, settings))


def run_some_steps(scene, out, n_steps, settings=SMALL):
    """Start a run and stop it at its `n_steps`-th yield; True if it had ended by itself before."""
    with contextlib.closing(previs(scene, out, settings)) as job:
        return sum(1 for _, _ in zip(range(n_steps), job, strict=False)) < n_steps


@contextlib.contextmanager
def counted_renders():
    """A list that gets an entry for every render of the block."""
    renders = []

    def count(scene, *_):
        renders.append(scene.name)

    bpy.app.handlers.render_init.append(count)
    try:
        yield renders
    finally:
        bpy.app.handlers.render_init.remove(count)


def files_below(folder):
    """{path: time of the last change} of all files."""
    return {
        path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()
    }


def unfinished_files(folder):
    """Temporary names that a run left behind."""
    return [path for path in files_below(folder) if path.rsplit("/", 1)[-1].startswith(".") or path.endswith("@")]
