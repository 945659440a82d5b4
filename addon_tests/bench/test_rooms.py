"""How good is each estimator, as shipped, on rooms that nothing was trained on? And what do patches and facing do?

    python addon_tests/bench/test_rooms.py FOLDER_OF_TEST_ROOMS --training FOLDER_OF_TRAINING_ROOMS

Rooms are those of `xihe dataset build`. One view: each view
with each position that is in view and not hidden. All views: those of one position merged, where there are two or more
(`pointar` samples points itself, of the last view). Errors are SHC RMSE against the light clipped at white, the mean
over clouds, divided by that of the mean predictor: the mean light of the training rooms, whatever is seen. Points and
patches are two ways to sample, see `xihenet.patches`; facing weighs patches by how they face the position.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from xihenet import estimators
from xihenet.buffers import merge
from xihenet.camera import unproject_frame
from xihenet.estimators import EstimateContext
from xihenet.metrics import shc_rmse
from xihenet.npz_files import read_npz
from xihenet.records import Intrinsics, PointCloud, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import room_files

LATTICE = AnchorLattice(1280)
NAMES = ("ambient", "pointar", "xihenet", "lattice", "projection")
SAMPLINGS = ("points", "patches", "patches and facing")


def frames(room: dict[str, np.ndarray]) -> Iterator[RgbdFrame]:
    width, height, *focal = room["intrinsics"].tolist()
    camera = Intrinsics(int(width), int(height), *focal)
    for srgb_u8, plane_depth_m, pose in zip(
        room["srgb_u8"], room["plane_depth_m"], room["world_from_camera"], strict=True
    ):
        yield RgbdFrame(srgb_u8, plane_depth_m.astype(np.float32), camera, pose, float(room["exposure"]))


def clouds_at(points: PointCloud, position_m: np.ndarray) -> list[UnitSphereCloud]:
    """In the order of SAMPLINGS."""
    faced = sample_unit_sphere(points, position_m, LATTICE)
    plain = sample_unit_sphere(replace(points, grid=None), position_m, LATTICE)
    return [plain, replace(faced, surfaces=None), faced]


Errors = dict[tuple[str, str, str], list[float]]
"""By views, sampling and estimator."""


def note(errors: Errors, views: str, lights: dict[tuple[str, str], np.ndarray], truth: np.ndarray) -> None:
    for (sampling, name), light in lights.items():
        errors.setdefault((views, sampling, name), []).append(shc_rmse(light, truth))


def measure(path: Path, mean_sh: np.ndarray, loaded: list, errors: Errors) -> None:
    """Add the errors of one room."""
    room = read_npz(path)
    seen = [(frame, unproject_frame(frame)) for frame in frames(room)]
    for place, (position_m, truth) in enumerate(zip(room["positions_m"], room["sh_ldr"], strict=True)):

        def lights(clouds: list[UnitSphereCloud], view: int, position_m=position_m) -> dict:
            context = EstimateContext(*seen[view], position_m)
            found = {
                (sampling, one.name): one.estimate(cloud, context if one.name == "pointar" else None)
                for sampling, cloud in zip(SAMPLINGS, clouds, strict=True)
                for one in loaded
            }
            return {(SAMPLINGS[0], "mean predictor"): mean_sh, **found}

        merged = [UnitSphereCloud.empty(LATTICE.n)] * len(SAMPLINGS)
        shown = np.flatnonzero(room["is_in_view"][:, place] & room["is_unhidden"][:, place])
        for view in shown:
            clouds = clouds_at(seen[view][1], position_m)
            merged = [merge(old, new) for old, new in zip(merged, clouds, strict=True)]
            note(errors, "one view", lights(clouds, view), truth)
        if len(shown) > 1:
            note(errors, "all views", lights(merged, shown[-1]), truth)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rooms", type=Path)
    parser.add_argument("--training", type=Path, required=True)
    options = parser.parse_args()
    mean_sh = np.concatenate([read_npz(path)["sh_ldr"] for path in room_files(options.training)]).mean(axis=0)
    loaded = [estimators.load(name) for name in NAMES]
    errors: Errors = {}
    files = room_files(options.rooms)
    for path in files:
        measure(path, mean_sh, loaded, errors)
    for views in ("one view", "all views"):
        base = np.mean(errors[views, SAMPLINGS[0], "mean predictor"])
        n = len(errors[views, SAMPLINGS[0], "mean predictor"])
        print(f"\n{views}: {n} clouds of {len(files)} rooms, mean predictor {base:.4f}\n")
        print("| estimator |", " | ".join(SAMPLINGS), "|\n| --- | --- | --- | --- |")
        for name in NAMES:
            means = [np.mean(errors[views, sampling, name]) / base for sampling in SAMPLINGS]
            print(f"| {name} |", " | ".join(f"{mean:.3f}" for mean in means), "|")


if __name__ == "__main__":
    main()
