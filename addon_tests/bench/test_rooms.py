"""Estimators as shipped, on the test rooms: how good is each? And what do patches and facing do?

    python addon_tests/bench/test_rooms.py FOLDER_OF_TEST_ROOMS --training FOLDER_OF_TRAINING_ROOMS

Rooms are those of `xihe dataset build`. One view: each view with each position that is in view and not hidden. All
views: those of one position merged, where there are two or more. Errors are SHC RMSE against the light clipped at
white, the mean over clouds, divided by that of the mean predictor: the mean light of the training rooms, whatever is
seen. Points and patches are two ways to sample, see `xihenet.patches`; facing weighs patches by how they face the
position.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from given import given

from xihenet import estimators
from xihenet.buffers import merge_in_sight
from xihenet.camera import unproject_frame
from xihenet.io.npz_files import read_npz
from xihenet.metrics import shc_rmse
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import frames_of, room_files

LATTICE = AnchorLattice(1280)
NAMES = ("ambient", "lattice", "projection")
SAMPLINGS = ("points", "patches", "patches and facing")


class Seen(NamedTuple):
    """What is known of a position from one view or from all.

    `clouds` are in the order of SAMPLINGS; `truths` (9, 3) are the light by target.
    """

    views: str
    clouds: list[UnitSphereCloud]
    truths: dict[str, np.ndarray]


def seen_in(path: Path) -> Iterator[Seen]:
    """All clouds of a room."""
    room = read_npz(path)
    seen = [unproject_frame(frame) for frame in frames_of(room)]
    for index, position_m in enumerate(room["positions_m"]):
        truths = {target: room[f"sh_{target}"][index] for target in ("ldr", "hdr")}
        merged = [UnitSphereCloud.empty(LATTICE.n)] * len(SAMPLINGS)
        shown = np.flatnonzero(room["is_in_view"][:, index] & room["is_unhidden"][:, index])
        for view in shown:
            faced = sample_unit_sphere(seen[view], position_m, LATTICE)
            plain = sample_unit_sphere(replace(seen[view], grid=None), position_m, LATTICE)
            clouds = [plain, replace(faced, surfaces=None), faced]
            merged = [merge_in_sight(old, new) for old, new in zip(merged, clouds, strict=True)]
            yield Seen("one view", clouds, truths)
        if len(shown) > 1:
            yield Seen("all views", merged, truths)


def main() -> None:
    options = given(__doc__, "rooms", training=Path)
    mean_sh = np.concatenate([read_npz(path)["sh_ldr"] for path in room_files(options.training)]).mean(axis=0)
    loaded, files = [estimators.load(name) for name in NAMES], room_files(options.rooms)
    errors: dict[tuple[str, str, str], list[float]] = {}
    for seen in (one for path in files for one in seen_in(path)):
        errors.setdefault((seen.views, "", "mean predictor"), []).append(shc_rmse(mean_sh, seen.truths["ldr"]))
        for sampling, cloud in zip(SAMPLINGS, seen.clouds, strict=True):
            for one in loaded:
                error = shc_rmse(one.estimate(cloud), seen.truths["ldr"])
                errors.setdefault((seen.views, sampling, one.name), []).append(error)
    for views in ("one view", "all views"):
        of_mean = errors[views, "", "mean predictor"]
        base = np.mean(of_mean)
        print(f"\n{views}: {len(of_mean)} clouds of {len(files)} rooms, mean predictor {base:.4f}\n")
        print("| estimator |", " | ".join(SAMPLINGS), "|\n| --- | --- | --- | --- |")
        for name in NAMES:
            means = [np.mean(errors[views, sampling, name]) / base for sampling in SAMPLINGS]
            print(f"| {name} |", " | ".join(f"{mean:.3f}" for mean in means), "|")


if __name__ == "__main__":
    main()
