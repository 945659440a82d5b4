"""Drift of the exposure: what does it cost the light, followed and ignored, beside an exposure that is locked?

    xihe record ROOM.blend --out ROOM --truth --phone ipad_pro_lidar --effect auto_exposure=on     (for each room)
    python addon_tests/bench/drift.py ROOM ...

Such a recording keeps the radiance of its captures. It is exposed anew, clipped at white and stored in 8 bits: once
with one exposure, and in `N_WALKS` ways with one that walks over 1.5 stops and a white balance that walks over a
quarter, which no frame says. The error is SHC RMSE against the rendered light probe, mean over places and walks.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
from given import given

from xihe_blender.io.exr import read_radiance
from xihenet import estimators
from xihenet.buffers import merge
from xihenet.camera import encode_exposed, unproject_frame
from xihenet.captures import open_capture
from xihenet.captures.drift import follow_drift
from xihenet.metrics import shc_rmse
from xihenet.records import ArrayF64, RgbdFrame
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

N_WALKS = 4
STOPS, WHITE_BALANCE = 1.5, 0.25


def gains_of_walk(n: int, rng: np.random.Generator) -> ArrayF64:
    """(n, 3) factors, the first 1: smooth, over STOPS in all and WHITE_BALANCE either way in each channel."""
    walks = np.cumsum(np.cumsum(rng.normal(size=(n, 4)), axis=0), axis=0)
    walks -= walks[0]
    exposure = STOPS * walks[:, :1] / np.ptp(walks[:, 0])
    balance = walks[:, 1:] / np.abs(walks[:, 1:]).max(axis=0) * np.log2(1 + WHITE_BALANCE)
    return np.asarray(2 ** (exposure + balance))


def error(frames: list[RgbdFrame], truth: Mapping[str, list[ArrayF64]], exposure: float) -> float:
    """Of `lattice`, from all frames; 1 is their exposure, and stands for `exposure`."""
    lattice, network = AnchorLattice(1280), estimators.load("lattice", target="hdr")
    points = [unproject_frame(frame, reference_exposure=1.0) for frame in frames]
    errors = []
    for place_m, light in zip(truth["at_m"], truth["hdr"], strict=True):
        cloud = reduce(merge, [sample_unit_sphere(one, place_m, lattice) for one in points])
        errors.append(shc_rmse(network.estimate(cloud), light * exposure))
    return float(np.mean(errors))


def errors(folder: Path) -> Iterator[dict[str, float]]:
    """For each walk."""
    content = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    first = {one["name"]: one for one in reversed(content["places"])}.values()
    truth = {
        "at_m": [np.array(one["position_m"]) for one in first],
        "hdr": [np.array(one["hdr"]) / content["exposure"] for one in first],
    }
    frames = list(open_capture(folder))
    light = [read_radiance(folder / "radiance" / f"captured_{frame.frame:04d}.exr") for frame in frames]
    exposure = content["exposure"]
    for seed in range(N_WALKS):
        gains = gains_of_walk(len(frames), np.random.default_rng(seed))
        shown: dict[str, list[RgbdFrame]] = {}
        for name, each in (("locked", np.ones_like(gains)), ("ignored", gains)):
            shown[name] = [
                replace(frame, srgb_u8=encode_exposed((one * gain).astype(np.float32), exposure), exposure=1.0)
                for frame, one, gain in zip(frames, light, each, strict=True)
            ]
        found = follow_drift(shown["ignored"])
        shown["followed"] = [
            replace(frame, white_balance=gain) for frame, gain in zip(shown["ignored"], found.gains, strict=True)
        ]
        off = np.abs(found.gains / gains - 1)[found.is_known]
        yield {name: error(some, truth, exposure) for name, some in shown.items()} | {"gains off by": float(off.mean())}


def main() -> None:
    folders = given(__doc__, "rooms+").rooms
    print("| recording | locked | ignored | followed | followed / locked | gains off by |\n|" + " --- |" * 6)
    for folder in folders:
        walks = list(errors(folder))
        mean = {name: float(np.mean([one[name] for one in walks])) for name in walks[0]}
        cells = " | ".join(f"{mean[name]:.3f}" for name in ("locked", "ignored", "followed"))
        ratio = mean["followed"] / mean["locked"]
        print(f"| {folder.name} | {cells} | {ratio:.3f} | {mean['gains off by']:.1%} |", flush=True)


if __name__ == "__main__":
    main()
