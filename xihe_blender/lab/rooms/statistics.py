"""Statistics of the light of these rooms, beside those of real ones that are published.

`python -m xihe_blender.lab.rooms.statistics DIR` prints them as a table. The real data are the ground truths that the
authors of the paper published with their artefact: order-2 coefficients of LDR environment maps from scans of homes, +Y
up. Ours are the probes of the pairs that count, clipped at 1 after the phone's exposure, in which +Z is up: index 2 is
the "up" coefficient of l = 1.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from xihe_blender.lab.rooms.store import StoredRoom, load_room, room_path, stored_indices
from xihenet.camera import unproject_frame
from xihenet.completeness import coverage
from xihenet.records import ArrayF32, ArrayF64
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import frames_of

BANDS = {"L00": [0], "l=1 up": [2], "l=1 sides": [1, 3], "l=2": [4, 5, 6, 7, 8]}
REAL_MEAN_L00 = (0.93, 0.86, 0.76)  # RGB; from the paper's artefact, 2,037 test items
REAL_SPREAD = {"L00": "0.23 / 0.21 / 0.26", "l=1 up": "0.20 / 0.21 / 0.22", "l=1 sides": "0.09 to 0.10",
               "l=2": "0.05 to 0.09"}  # fmt: skip
"""Standard deviations over the same items, RGB or the range over coefficients and channels."""

REAL_RANGE = (-1.09, 1.98)
REAL_COVERAGE = {"mean": 607 / 1280, "5 %": 107 / 1280, "50 %": 642 / 1280, "95 %": 887 / 1280}
"""Share of 1280 anchors set by one view; from the paper's artefact."""


@dataclass(frozen=True, eq=False)
class LightStatistics:
    """Of many lights: mean L00 (3,), standard deviation by band (n, 3), extremes, coverage by name."""

    n_rooms: int
    n_pairs: int
    mean_l00: ArrayF64
    spread: dict[str, ArrayF64]
    extremes: tuple[float, float]
    coverage: dict[str, float]


def light_statistics(rooms: Iterable[StoredRoom], n_anchors: int = 1280) -> LightStatistics:
    """Statistics over the pairs that count. ValueError if there is none."""
    lattice, lights, shares, n_rooms = AnchorLattice(n_anchors), [], [], 0
    for room in rooms:
        n_rooms += 1
        for frame, is_in_view in zip(frames_of(vars(room)), room.is_in_view, strict=True):
            points = unproject_frame(frame)
            for index in np.flatnonzero(is_in_view):
                lights.append(room.sh_ldr[index])
                shares.append(coverage(sample_unit_sphere(points, room.positions_m[index], lattice)))
    if not lights:
        raise ValueError("light_statistics: expected rooms with positions in view, got none")
    sh = np.array(lights)
    return LightStatistics(
        n_rooms,
        len(sh),
        sh[:, 0].mean(axis=0),
        {name: sh[:, index].std(axis=0) for name, index in BANDS.items()},
        (float(sh.min()), float(sh.max())),
        {"mean": float(np.mean(shares)), **{f"{p} %": float(np.percentile(shares, p)) for p in (5, 50, 95)}},
    )


def statistics_table(statistics: LightStatistics) -> str:
    """A Markdown table, ours beside the real data."""
    rows = [("mean L00, RGB", _numbers(statistics.mean_l00), _numbers(REAL_MEAN_L00))]
    for name, spread in statistics.spread.items():
        ours = _numbers(spread[0]) if len(spread) == 1 else f"{spread.min():.2f} to {spread.max():.2f}"
        rows.append((f"spread of {name}", ours, REAL_SPREAD[name]))
    rows.append(("extremes", "{:.2f} to {:.2f}".format(*statistics.extremes), "{:.2f} to {:.2f}".format(*REAL_RANGE)))
    rows += [(f"coverage, {name}", f"{v:.2f}", f"{REAL_COVERAGE[name]:.2f}") for name, v in statistics.coverage.items()]
    head = f"| {statistics.n_rooms} rooms, {statistics.n_pairs} pairs | these rooms | real data |"
    return "\n".join([head, "| --- | --- | --- |", *(f"| {a} | {b} | {c} |" for a, b, c in rows)])


def panorama_faults(room: StoredRoom) -> list[str]:
    """What is wrong with a room's panoramas, in words; empty for a sound room.

    A light that is not finite, that is black, or whose lower half is black in a room that is not.
    """
    faults = []
    for i in range(len(room.balls)):
        panorama = room.panorama(i)
        level, below = float(panorama.mean()), float(panorama[len(panorama) // 2 :].mean())
        if not np.isfinite(panorama).all():
            faults.append(f"position {i}: not finite")
        elif level * room.exposure < 1e-3:
            faults.append(f"position {i}: black")
        elif below < 0.01 * level:
            faults.append(f"position {i}: black below")
    return faults


def _numbers(values: ArrayF64 | ArrayF32 | Sequence[float]) -> str:
    return " / ".join(f"{float(v):.2f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m xihe_blender.lab.rooms.statistics", description="Light of rooms.")
    parser.add_argument("folder", type=Path, metavar="DIR")
    folder = parser.parse_args().folder
    paths = [room_path(folder, i) for i in stored_indices(folder)]
    print(statistics_table(light_statistics(load_room(path) for path in paths)))
    for path in paths:
        for fault in panorama_faults(load_room(path)):
            print(f"{path.name}: {fault}")


if __name__ == "__main__":
    main()
