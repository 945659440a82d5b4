"""What does it cost in error to take the ringing off an estimate before it is shown?

    python addon_tests/bench/deringing.py FOLDER_OF_TEST_ROOMS

Clouds as in `test_rooms.py`, patches and facing. SHC RMSE against the light of the rooms, clipped at white ("ldr") and
not ("hdr"), as estimated and after `dering_for_display`, and the share of the estimates that it changes.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from test_rooms import LATTICE, frames

from xihenet import estimators
from xihenet.buffers import merge
from xihenet.camera import unproject_frame
from xihenet.metrics import shc_rmse
from xihenet.npz_files import read_npz
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import dering_for_display
from xihenet.training.rooms import room_files

TARGETS = ("ldr", "hdr")
CHOICES = [(name, target) for name in ("lattice", "projection") for target in TARGETS]

Lights = dict[tuple[str, str, str], list[tuple[np.ndarray, np.ndarray]]]
"""Estimates and references by views, estimator and target."""


def note(lights: Lights, views: str, cloud: UnitSphereCloud, loaded: list, truths: dict[str, np.ndarray]) -> None:
    for (name, target), one in zip(CHOICES, loaded, strict=True):
        lights.setdefault((views, name, target), []).append((one.estimate(cloud), truths[target]))


def collect(path: Path, loaded: list, lights: Lights) -> None:
    """Add the estimates in one room."""
    room = read_npz(path)
    seen = [unproject_frame(frame) for frame in frames(room)]
    for place, position_m in enumerate(room["positions_m"]):
        truths = {target: room[f"sh_{target}"][place] for target in TARGETS}
        shown = np.flatnonzero(room["is_in_view"][:, place] & room["is_unhidden"][:, place])
        merged = UnitSphereCloud.empty(LATTICE.n)
        for view in shown:
            cloud = sample_unit_sphere(seen[view], position_m, LATTICE)
            merged = merge(merged, cloud)
            note(lights, "one view", cloud, loaded, truths)
        if len(shown) > 1:
            note(lights, "all views", merged, loaded, truths)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", type=Path)
    options = parser.parse_args()
    loaded = [estimators.load(name, target=target) for name, target in CHOICES]
    lights: Lights = {}
    files = room_files(options.rooms)
    for path in files:
        collect(path, loaded, lights)
    print(f"{len(files)} rooms\n")
    print("| views | estimator | target | estimates | changed | SHC RMSE | without ringing | more error |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for (views, name, target), pairs in lights.items():
        shown = [dering_for_display(light) for light, _ in pairs]
        changed = sum(not np.array_equal(one, light) for one, (light, _) in zip(shown, pairs, strict=True))
        before = np.mean([shc_rmse(light, truth) for light, truth in pairs])
        after = np.mean([shc_rmse(one, truth) for one, (_, truth) in zip(shown, pairs, strict=True)])
        figures = f"{len(pairs)} | {changed} ({changed / len(pairs):.0%}) | {before:.5f} | {after:.5f}"
        print(f"| {views} | `{name}` | {target} | {figures} | {after / before - 1:+.2%} |")


if __name__ == "__main__":
    main()
