"""Rendering: what does the work around Cycles cost, and does memory stay flat? Two tables.

    python addon_tests/bench/rendering.py [--frames 8] [--captures 300]

1. living_room at 256x192 and 16 samples: capture, truth probe and one step of the chain for two probes with everything
   stored, beside a bare loop that sets the frame and renders the same captures, interleaved frame by frame.
2. The process's resident memory over many small captures of the same room.
"""

from __future__ import annotations

import os
import resource
import statistics
import tempfile
import time
from pathlib import Path

import bpy
from given import given

from xihe_blender.capture.render import RenderSettings, working_scene
from xihe_blender.capture.scanner import open_scanner
from xihe_blender.io.blender_output import blender_output_aside
from xihe_blender.previs.plan import plan_previs
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend
from xihenet import estimators
from xihenet.backend import LocalBackend
from xihenet.controller import XiheController
from xihenet.io.recording import save_frame

SCENE = Path(__file__).resolve().parents[2] / "blend_scenes" / "living_room.blend"


def overhead_table(n_frames: int) -> str:
    """Seconds per frame of the whole walk and of bare rendering, and the share of work around the renderer."""
    scene = open_blend(SCENE)
    plan = plan_previs(scene, PrevisSettings())
    settings = RenderSettings((256, 192), samples=16)
    controller = XiheController(LocalBackend(estimators.load("projection")))
    for probe in plan.probes:
        controller.add_position(probe.name, probe.position_m)
    walk_s, render_s, bare_s = [], [], []
    with (
        open_scanner(scene, settings) as scanner,
        working_scene(scene, "Bare", settings) as bare,
        tempfile.TemporaryDirectory() as folder,
    ):
        bare.render.filepath = str(Path(folder) / "bare.exr")
        for frame in plan.frames[: n_frames + 1]:
            start = time.perf_counter()
            scanner.move_to(frame)
            captured = scanner.acquire_environment_scan()
            controller.step(captured)
            save_frame(Path(folder) / f"{frame}.exr", captured)
            walk_s.append(time.perf_counter() - start)
            render_s.append(scanner.rendered.render_s)
            start = time.perf_counter()
            bare.frame_set(frame)
            with bpy.context.temp_override(scene=bare):
                bpy.ops.render.render(write_still=True)
            bare_s.append(time.perf_counter() - start)
    # The first frame builds the renderer's scene and is left out.
    around = [walk - render for walk, render in zip(walk_s[1:], render_s[1:], strict=True)]
    walk, rendering, bare_loop = (statistics.median(times[1:]) for times in (walk_s, render_s, bare_s))
    work = statistics.median(around)
    return (
        f"{'living_room, 256x192, 16 samples':<44}{'s/frame':>9}\n"
        f"{'the walk: capture, chain for 2 probes, store':<44}{walk:9.3f}\n"
        f"{'  of which Blender renders':<44}{rendering:9.3f}\n"
        f"{'  of which work around it':<44}{work:9.3f}   {work / rendering:.1%} of rendering (budget 5 %)\n"
        f"{'bare loop: set the frame, render':<44}{bare_loop:9.3f}   the walk takes {walk / bare_loop:.3f} x as long\n"
    )


def memory_table(n_captures: int) -> str:
    """Resident memory after every sixth of the captures."""
    scene = open_blend(SCENE)
    lines = [f"{'captures of living_room, 64x48, 1 sample':<44}{'MB':>9}"]
    frames = range(scene.frame_start, scene.frame_end + 1)
    with open_scanner(scene, RenderSettings((64, 48), samples=1, denoise=False)) as scanner:
        for k in range(n_captures + 1):
            scanner.move_to(frames[k % len(frames)])
            scanner.acquire_environment_scan()
            if k % max(1, n_captures // 6) == 0:
                lines.append(f"{k:<44}{resident_mb():9.1f}")
    return "\n".join(lines)


def resident_mb() -> float:
    """Resident memory of this process now (Linux), else its peak."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text(encoding="utf-8").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    options = given(__doc__, frames=8, captures=300)
    with blender_output_aside() as (stdout, _):
        print(overhead_table(options.frames), file=stdout, flush=True)
        print(memory_table(options.captures), file=stdout, flush=True)


if __name__ == "__main__":
    main()
