"""Live light: how long does it take from moving an object to its new light, after a run?

    xihe previs blend_scenes/living_room.blend --out out --preset draft
    python addon_tests/bench/live.py blend_scenes/living_room.blend out

As in the add-on: the file is opened, the run's light is put on its timeline, and one object is moved again and again.
The first move reads the frames that the run kept. Drawing the window is not in the times.
"""

from __future__ import annotations

import os
import statistics
import sys
import time
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parents[1] / "in_blender"))
from addon_runs import registered_addon
from given import given

from xihe_blender.addon.results_in_blender import apply_results

N_MOVES, STEP = 20, 0.01


def main() -> None:
    options = given(__doc__, "scene", "run")
    blend, run = options.scene.resolve(), options.run.resolve()
    with registered_addon():
        bpy.ops.wm.open_mainfile(filepath=str(blend))
        scene = bpy.context.scene
        scene.xihe.run_folder = str(run)
        apply_results(scene, run)
        item = next(item for item in bpy.data.collections["Xihe Virtual"].objects if item.type == "MESH")
        times = []
        for _ in range(1 + N_MOVES):
            item.location.x += STEP
            bpy.context.view_layer.update()
            start = time.perf_counter()
            bpy.ops.xihe.update_light()
            times.append(time.perf_counter() - start)
    print(
        f"{item.name}: {times[0]:.2f} s the first time, then {statistics.median(times[1:]):.3f} s (median of {N_MOVES})"
    )


if __name__ == "__main__":
    main()
    sys.stdout.flush()
    os._exit(0)  # The wheel waits for ever for the thread that has found the light.
