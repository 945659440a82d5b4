"""Small runs of the main job: a walk through the tiny room with all that a run has to cope with."""

import contextlib
import itertools
import shutil
from dataclasses import dataclass, replace

import bpy
from tiny_scenes import box, key, light_strength, look_at, material, room_with_a_virtual_sphere

from xihe_blender.apply.datablocks import lights_by_sh
from xihe_blender.apply.keys import f_curves
from xihe_blender.capture.render import can_denoise
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.virtual_objects import virtual_collection


@dataclass(frozen=True)
class QuickProbes(PrevisSettings):
    """Light probes of a fortieth of the rays, not denoised: for tests that are not about them."""

    @property
    def reference(self):
        return replace(super().reference, size=48, max_samples=2, denoise=False)


@dataclass(frozen=True)
class PlainPrevis(QuickProbes):
    """Light probes of a quarter of these, and comparisons that are not denoised: for tests that look at pictures."""

    @property
    def reference(self):
        return replace(super().reference, size=24)

    def comparison(self, size):
        return replace(super().comparison(size), denoise=False)


@dataclass(frozen=True)
class QuickPrevis(PlainPrevis):
    """And comparisons of few samples, and captures of one sample not denoised: for tests that look at none closely."""

    def capture(self, size, samples):
        return replace(super().capture(size, samples), denoise=self.samples != 1)

    def comparison(self, size):
        return replace(super().comparison(size), samples=2)


DRAFT = {"preset": "draft", "size": (32, 24)}
if not can_denoise(bpy.context.scene):
    # Noise would trigger an estimate in every frame.
    DRAFT["noise_target"] = 0.01
SMALL = QuickPrevis(**DRAFT)
CAPTURED = QuickPrevis(size=(32, 24), preset="draft", samples=2, exposure=1.0)
"""Of a path that is captured and asked about, without ground truth."""
IPAD = replace(SMALL, phone="ipad_pro_lidar")
N_FRAMES = 5
LOOKS_AWAY = 3
"""The frame of `walk` in which no virtual object is in view."""


def walk(n_frames=N_FRAMES):
    """A ball, a board that needs two positions, a phone that looks away once, a lamp that is dimmed after that."""
    scene = room_with_a_virtual_sphere(n_frames)
    board = material("Board", (0.8, 0.3, 0.2))
    box(scene, "Board", (0, 1.2, 0.9), (1.6, 0.1, 0.1), board, virtual_collection(scene))
    look_away(scene.camera, LOOKS_AWAY)
    key(light_strength(), "default_value", {LOOKS_AWAY: 6.0, LOOKS_AWAY + 1: 1.0})
    return scene


def look_away(camera, frame):
    """Turn the phone away from the middle of the room at `frame`."""
    look_at(camera, (-0.6, -1.5, 1.5), (-0.6, -3.0, 1.5), frame)


def run(scene, out, settings=SMALL):
    """A whole run; its results, which are checked."""
    # Where jsonschema is imported for nothing, some processes of the bpy wheel never end.
    from results_schema import check_results

    results = run_blocking(previs(scene, str(out), settings))
    check_results(results)
    return results


@dataclass
class Finished:
    """An undisturbed run: its files, results, the scenes that were rendered, frames at which each world is keyed."""

    outputs: RunOutputs
    results: dict
    renders: list
    keys: dict


def finished_run(out, settings=SMALL, make_scene=walk):
    scene = make_scene()
    with counted_renders() as renders:
        results = run(scene, out, settings)
    curves = {world.name: f_curves(world.node_tree)[0] for world in bpy.data.worlds if lights_by_sh(world)}
    keys = {name: [int(point.co[0]) for point in curve.keyframe_points] for name, curve in curves.items()}
    return Finished(RunOutputs(out, "untitled"), results, renders, keys)


OF_THE_ROOM = ("exposure.json", "sample_count.json", "survey.json", "capture_*", "times_*", "surfaces_*", "reference_*",
               "captured_*", "probe_*")  # fmt: skip
"""Files of a run that no estimator, phone or network changes."""


def with_renders_of(other, folder):
    """`folder`, in which a run of another estimator, phone or network finds the renders of one in `other`."""
    for file in (file for pattern in OF_THE_ROOM for file in other.glob(f"*/{pattern}")):
        (folder / file.parent.name).mkdir(parents=True, exist_ok=True)
        shutil.copy(file, folder / file.parent.name)
    return folder


def run_some_steps(scene, out, n_steps, settings=SMALL):
    """Start a run and stop it when it tells of its `n_steps`-th step; True if it had ended by itself before."""
    with contextlib.closing(previs(scene, out, settings)) as job:
        told = (progress for progress, _ in itertools.groupby(job))
        return sum(1 for _, _ in zip(range(n_steps), told, strict=False)) < n_steps


def survey(job):
    """Drive `job` to the step after the survey of the path."""
    next(progress for progress in job if progress.doing != "surveying the path")


@contextlib.contextmanager
def counted_renders():
    """A list that gets an entry for every render of the block."""
    renders = []
    with handler_in(bpy.app.handlers.render_init, lambda scene, *_: renders.append(scene.name)):
        yield renders


@contextlib.contextmanager
def handler_in(handlers, handler):
    """One more handler for the time of the block."""
    handlers.append(handler)
    try:
        yield
    finally:
        handlers.remove(handler)


def files_below(folder):
    """{path: time of the last change} of all files."""
    return {
        path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()
    }


def unfinished_files(folder):
    """Temporary names that a run left behind."""
    return [path for path in files_below(folder) if path.rsplit("/", 1)[-1].startswith(".") or path.endswith("@")]
