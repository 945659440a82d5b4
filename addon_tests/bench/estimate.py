"""Estimates: what does one of the lattice network cost, alone and in batches, and what the paper's network?

    python addon_tests/bench/estimate.py [--repeats 30]

1280 anchors, random clouds at 40 % coverage, the shipped weights. Candidates are timed in turn, so that the machine's
drift hits all alike, each after a call that is not timed: torch's threads keep both cores busy for some milliseconds
after their work, and whoever comes next would pay for it. Where torch is installed, both networks in torch (the paper's
with random weights and 512 and 1280 anchors) run beside them. Prints minimum, median and spread (quartiles).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable

import numpy as np
from given import given
from interleaved import interleaved_ms

from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.pointconv import XiheNet
from xihenet.estimators.weights_format import WEIGHTS_FOLDER
from xihenet.records import UnitSphereCloud

N_ANCHORS = 1280
BATCHES = (1, 8, 64, 512)
Candidates = dict[str, tuple[int, Callable[[], object]]]
"""Clouds and run of each candidate by name."""


def random_clouds(n_clouds: int, n: int):
    rng = np.random.default_rng(n_clouds)
    is_set = rng.random((n_clouds, n)) < 0.4
    srgb = rng.random((n_clouds, n, 3), np.float32) * is_set[..., None]
    return srgb, rng.random((n_clouds, n), np.float32) * 5 * is_set, is_set


def torch_candidates() -> Candidates:
    """None where torch is missing."""
    if importlib.util.find_spec("torch") is None:
        return {}
    import torch

    from xihenet.nets.lattice import LatticeNet
    from xihenet.nets.pointconv import PointConvNet

    torch.set_grad_enabled(False)
    torch.set_num_threads(2)
    weights = load_weights(WEIGHTS_FOLDER / "lattice_ldr.npz")
    net, paper = LatticeNet(weights.architecture).eval(), PointConvNet().eval()
    net.load_state_dict({name: torch.from_numpy(array) for name, array in weights.arrays.items()})
    candidates: Candidates = {}
    for size in BATCHES[1:]:
        parts = [torch.from_numpy(part) for part in random_clouds(size, N_ANCHORS)]
        candidates[f"lattice, torch, batch of {size}"] = size, lambda parts=parts: net(*parts)
    for n in (512, N_ANCHORS):
        srgb, distance_m, is_set = (torch.from_numpy(part) for part in random_clouds(1, n))
        points_m = torch.nn.functional.normalize(torch.randn(1, n, 3), dim=2) * distance_m[..., None]
        candidates[f"xihenet, torch, one of {n}"] = 1, lambda parts=(points_m, srgb, is_set): paper(*parts)
    return candidates


def main() -> None:
    repeats = given(__doc__, repeats=30).repeats
    lattice = Lattice(N_ANCHORS)
    one = UnitSphereCloud(*(part[0] for part in random_clouds(1, N_ANCHORS)))
    paper = XiheNet(N_ANCHORS)
    candidates: Candidates = {
        "lattice, NumPy, one": (1, lambda: lattice.estimate(one)),
        "xihenet, NumPy, one": (1, lambda: paper.estimate(one)),
    }
    for size in BATCHES:
        parts = random_clouds(size, N_ANCHORS)
        candidates[f"lattice, NumPy, batch of {size}"] = size, lambda parts=parts: lattice.estimate_batch(*parts)
    candidates |= torch_candidates()
    taken = interleaved_ms({name: run for name, (_, run) in candidates.items()}, repeats, is_called_before=True)
    print(f"{f'{N_ANCHORS} anchors':<34}{'min ms':>9}{'median':>9}{'quartiles':>20}{'clouds/s':>10}")
    for name, (size, _) in candidates.items():
        low, median, high = np.percentile(taken[name], [25, 50, 75])
        spread = f"{low:.3f} to {high:.3f}"
        print(f"{name:<34}{min(taken[name]):9.3f}{median:9.3f}{spread:>20}{1e3 * size / median:10.0f}")


if __name__ == "__main__":
    main()
