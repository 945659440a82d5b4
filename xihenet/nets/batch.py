"""How is the light of many clouds estimated where torch, or a GPU, is at hand?

The weights that NumPy reads are put into the torch network, which runs them in chunks without gradients. On two cores
`xihenet.estimators.lattice` is the faster of the two; this is for a GPU. Input is checked by `Lattice`, not here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike

from xihenet.estimators.lattice_format import LatticeWeights
from xihenet.nets.lattice import LatticeNet
from xihenet.records import ArrayF64

CLOUDS_AT_ONCE = 256


def net_from_weights(weights: LatticeWeights, device: str = "cpu") -> LatticeNet:
    """The torch network with `weights`, ready to run on `device`."""
    net = LatticeNet(weights.architecture)
    net.load_state_dict({name: torch.tensor(np.asarray(array)) for name, array in weights.arrays.items()})
    net.to(device).eval()
    return net


def estimate_batch_torch(
    weights: LatticeWeights, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *,
    facing: ArrayLike | None = None, device: str = "cpu",
) -> ArrayF64:  # fmt: skip
    """(B, 9, 3) of srgb (B, N, 3), distance_m (B, N) and is_set (B, N), within 1e-5 of `Lattice.estimate_batch`.

    What stands where an anchor is not set does not matter. B may be 0. ValueError for shapes that do not fit.
    """
    colours, distances = np.asarray(srgb, np.float32), np.asarray(distance_m, np.float32)
    known = np.asarray(is_set, bool)
    turned = None if facing is None else np.asarray(facing, np.float32)
    if known.ndim != 2 or distances.shape != known.shape or colours.shape != (*known.shape, 3):
        shapes = f"{colours.shape}, {distances.shape} and {known.shape}"
        raise ValueError(f"estimate_batch_torch: expected (B, N, 3), (B, N) and (B, N), got {shapes}")
    net = net_from_weights(weights, device)
    light = np.empty((len(known), 9, 3))
    with torch.no_grad():
        for start in range(0, len(known), CLOUDS_AT_ONCE):
            block = slice(start, start + CLOUDS_AT_ONCE)
            parts: tuple[Any, ...] = (
                colours[block] * known[block, :, None],
                distances[block] * known[block],
                known[block],
            )
            if turned is not None:
                parts += (turned[block] * known[block],)
            made, _ = net(*(torch.from_numpy(part).to(device) for part in parts))
            light[block] = made.cpu().numpy()
    return light
