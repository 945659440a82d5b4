"""The time left of a run: what it said at a tenth of its time, beside what was really left.

    python addon_tests/bench/time_left.py SCENE.blend ... [--frames 1:24] [--preset draft]

`left` is what `xihe previs` showed last before a tenth of the run's seconds were over, `took` what it took from there.
Below, by stage, the seconds of a step after the first, those of the first, and seconds per unit of work: the units say
how long stages that are still to come will take (`PreparedRun.work`).
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from given import given

from xihe_blender.cli.arguments import frame_range
from xihe_blender.jobs import TimeLeft
from xihe_blender.previs.previs import previs
from xihe_blender.previs.settings import PrevisSettings
from xihe_blender.scene.blend_file import open_blend


def measure(path: Path, settings: PrevisSettings) -> None:
    time_left, said, start = TimeLeft(), [], time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for progress in previs(open_blend(path), Path(folder), settings, blend_file=path):
            elapsed_s = time.perf_counter() - start
            said.append((elapsed_s, time_left.after(progress, elapsed_s)))
    total_s = time.perf_counter() - start
    known = [(at_s, left_s) for at_s, left_s in said if left_s is not None]
    at_s, left_s = ([one for one in known if one[0] <= total_s / 10] or known[:1])[-1]
    took_s = total_s - at_s
    print(f"{path.stem}: {total_s:.0f} s in all; at {at_s:.0f} s: left {left_s:.0f} s, took {took_s:.0f} s", end="")
    print(f", {left_s / took_s:.2f} times", flush=True)
    for stage, steps in time_left.steps.items():
        later = steps[1:] or steps
        seconds, units = (sum(values) / len(later) for values in ([s for _, s in later], [u for u, _ in later]))
        print(f"    {stage}: {len(steps)} steps of {seconds:.2f} s, the first {steps[0][1]:.2f} s", end="")
        print(f"; {seconds / units:.2f} s per unit of work", flush=True)


def main() -> None:
    options = given(__doc__, "scenes+", frames=(frame_range, None), preset="draft")
    for path in options.scenes:
        measure(path, PrevisSettings(frames=options.frames, preset=options.preset))


if __name__ == "__main__":
    main()
