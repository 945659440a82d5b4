"""Which estimator is the best where no light probe has been? A table over the captures that previs runs kept.

    xihe previs ROOM.blend --phone iphone_lidar --frames 1:48:4 --out out/room_iphone ...
    python addon_tests/bench/left_out.py out/room_iphone ...

The sessions are simulated, and their truth stays hidden: estimates are held against what left-out frames show
(`xihenet.left_out`). For each run, the mean error of each estimator from one frame, judged by all others, and from all
others, judged by the frame that was left out; at the end in how many sessions each is the best. Nothing is rendered.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
from trigger import read_run

from xihenet import estimators
from xihenet.camera import unproject_frame
from xihenet.estimators import EstimateContext
from xihenet.left_out import left_out_errors
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

NAMES = ("lattice", "projection", "ambient")
LATTICE = AnchorLattice(1280)


def errors_of(folder: Path, name: str, *, is_merged: bool) -> list[float]:
    """Of all positions of a run."""
    recorded, estimator = read_run(folder), estimators.load(name)
    points = [unproject_frame(frame, reference_exposure=recorded.exposure) for frame in recorded.frames]
    context = EstimateContext(frame=recorded.frames[0], reference_exposure=recorded.exposure)
    found: list[float] = []
    for position in recorded.positions.values():
        clouds = [sample_unit_sphere(one, np.array(position), LATTICE) for one in points]
        found += left_out_errors(clouds, lambda cloud: estimator.estimate(cloud, context), is_merged=is_merged)
    return found


def main() -> None:
    folders = [Path(folder) for folder in sys.argv[1:]]
    if not folders:
        sys.exit("give the folders of finished previs runs")
    print("| session | from | asked | " + " | ".join(NAMES) + " |\n| --- | --- | --- |" + " --- |" * len(NAMES))
    for is_merged, given in ((False, "one frame"), (True, "all but one")):
        best: Counter[str] = Counter()
        for folder in folders:
            errors = {name: errors_of(folder, name, is_merged=is_merged) for name in NAMES}
            n_asked = len(errors[NAMES[0]])
            if n_asked:
                means = {name: float(np.mean(one)) for name, one in errors.items()}
                best[min(means, key=lambda name: means[name])] += 1
                cells = " | ".join(f"{mean:.4f}" for mean in means.values())
                print(f"| {folder.name} | {given} | {n_asked} | {cells} |", flush=True)
        print(f"best from {given}: " + ", ".join(f"{name} {best[name]}" for name in NAMES) + f" of {best.total()}")


if __name__ == "__main__":
    main()
