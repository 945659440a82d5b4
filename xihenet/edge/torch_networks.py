"""Networks in torch in the place of those in NumPy, for a service that has a GPU.

An estimator keeps its checks, clipping and calibration and gets another network to call, with the same weights. Tests
hold both within 1e-4 on the processor. Of the served estimators `lattice` and `xihenet` have one; clouds of `xihenet`
are still asked for one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from xihenet.estimators.base import Estimator
from xihenet.estimators.lattice import Lattice
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.pointconv import XiheNet
from xihenet.estimators.pointconv_network import load_pointconv_weights
from xihenet.estimators.weights_format import NetworkWeights, loaded_for
from xihenet.nets.lattice import LatticeNet
from xihenet.nets.pointconv import PointConvNet
from xihenet.records import ArrayBool, ArrayF32, ArrayF64


def put_on(estimator: Estimator, device: str) -> None:
    """Have the estimator run its network, with the shipped weights, on a device of torch.

    ValueError for an estimator without a network, and for a device that this machine's torch does not have.
    """
    if device.startswith("cuda") and not torch.cuda.is_available():
        raise ValueError("torch finds no CUDA device on this machine: leave --device out")
    if isinstance(estimator, Lattice):
        estimator.use_network(_TorchLattice(loaded_for(estimator, None, load_weights), device))
    elif isinstance(estimator, XiheNet):
        weights = loaded_for(estimator, None, lambda path: load_pointconv_weights(path, estimator.name))
        estimator.use_network(_TorchPointConv(weights, device))
    else:
        raise ValueError(f"{estimator.name} has no network that could run on {device}: leave --device out")


class _TorchLattice:
    """`LatticeNetwork.run` in torch."""

    def __init__(self, weights: NetworkWeights[Any], device: str) -> None:
        self.device, self.net = device, _with_weights(LatticeNet(weights.architecture), weights, device)

    def run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None = None
    ) -> tuple[ArrayF64, ArrayF64]:
        arrays = [srgb, distance_m, is_set] + ([] if facing is None else [facing])
        with torch.no_grad():
            light, error = self.net(*(torch.tensor(array, device=self.device) for array in arrays))
        return light.cpu().numpy().astype(np.float64), error.cpu().numpy().astype(np.float64)


class _TorchPointConv:
    """`PointConvNetwork.light` in torch."""

    def __init__(self, weights: NetworkWeights[Any], device: str) -> None:
        self.device, self.net = device, _with_weights(PointConvNet(weights.architecture), weights, device)

    def light(self, points_m: ArrayF32, srgb: ArrayF32) -> ArrayF32:
        # The net takes a cloud of no point for one of an unset point.
        is_set = np.ones(max(1, len(points_m)), bool) if len(points_m) else np.zeros(1, bool)
        points_m, srgb = (array if len(array) else np.zeros((1, 3), np.float32) for array in (points_m, srgb))
        with torch.no_grad():
            parts = (torch.tensor(array, device=self.device)[None] for array in (points_m, srgb, is_set))
            found: ArrayF32 = self.net(*parts)[0].cpu().numpy()
        return found


def _with_weights(net: torch.nn.Module, weights: NetworkWeights[Any], device: str) -> torch.nn.Module:
    net.load_state_dict({name: torch.tensor(array) for name, array in weights.arrays.items()})
    return net.to(device).eval()
