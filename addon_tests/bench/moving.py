"""A moving virtual object, in sun and shade: what is it worth to light it where it is?

A ball goes its way through an example scene, in a run of `draft` at 96x72 and 4 samples. Beside each error stands that
of the same chain on the same captures with the ball's position left at its first place, as it was before objects were
followed: both against the reference light at the place where the ball is.

    python addon_tests/bench/moving.py out/moving [SCENE...]
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from given import given

from xihe_blender.io.blender_output import only_our_output
from xihe_blender.io.outputs import RunOutputs
from xihe_blender.jobs import run_blocking
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings, load_estimators
from xihe_blender.scene.blend_file import open_blend
from xihe_blender.scene.sphere_rig import sphere_mesh
from xihe_blender.scene.virtual_objects import virtual_collection, virtual_objects
from xihenet.io.recording import load_frame
from xihenet.metrics import shc_rmse
from xihenet.phone.session import PhoneSession

WAYS = {
    "living_room": [(1.3, 1.45, 0.13), (-1.6, 1.45, 0.13)],
    "courtyard": [(2.0, 0.9, 0.15), (-1.6, 1.3, 0.15), (-1.2, -1.6, 0.15)],
    "cornell_box": [(-0.6, -0.3, 0.8), (0.6, -0.3, 0.8)],
    "walk_around": [(0.33 * np.cos(turn), 0.33 * np.sin(turn), 0.83) for turn in np.linspace(0, 2 * np.pi, 25)],
}
"""World metres: on the floor through a patch of sun, through a court, from wall to wall, around a lamp."""

SETTINGS = PrevisSettings(preset="draft", size=(96, 72), samples=4, target="ldr")


def scene_with_a_ball(name: str) -> bpy.types.Scene:
    """The scene with a ball for its virtual objects, which goes evenly from one end of its way to the other."""
    scene = open_blend(Path(__file__).parents[2] / "blend_scenes" / f"{name}.blend")
    for item in virtual_objects(scene):
        bpy.data.objects.remove(item)
    ball = bpy.data.objects.new("Ball", sphere_mesh("Ball", 0.08 if name == "walk_around" else 0.13, 48, 24))
    virtual_collection(scene, create=True).objects.link(ball)
    frames = range(scene.frame_start, scene.frame_end + 1)
    for frame, leg in zip(frames, np.linspace(0, len(WAYS[name]) - 1, len(frames)), strict=True):
        ball.location = [np.interp(leg, range(len(WAYS[name])), axis) for axis in np.transpose(WAYS[name])]
        ball.keyframe_insert("location", frame=frame)
    return scene


def main() -> None:
    options = given(__doc__, "out", "scenes*")
    for name in map(str, options.scenes or WAYS):
        scene, out = scene_with_a_ball(name), options.out / name
        results, errors = run_blocking(previs(scene, out, SETTINGS)), []
        exposure, plan = results["settings"]["reference_exposure"], plan_previs(scene, SETTINGS)
        left_behind = PhoneSession(plan.probes, SETTINGS.chain(exposure), load_estimators(SETTINGS)[0], None, seed=0)
        for entry in (entry for entry in results["frames"] if entry["active"]):
            seen, (probe,) = load_frame(RunOutputs(out).capture(entry["frame"])), entry["probes"]
            left_behind.step(seen, {}, left_behind.controller.active(seen.intrinsics, seen.world_from_camera))
            before = shc_rmse(left_behind.light("Ball", seen.time_s), np.array(probe["sh_truth"]))
            errors.append((before, probe["shc_rmse"], probe["ambient_shc_rmse"]))
            print(f"{name} {entry['frame']:3}: {before:.3f} -> {probe['shc_rmse']:.3f} ({probe['reason']})", flush=True)
        print(f"{name}: first place, followed, ambient", np.mean(errors, axis=0).round(3), flush=True)


if __name__ == "__main__":
    with only_our_output():
        main()
