"""How does a trained lattice network become the weights file that the estimator reads without torch?"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from xihenet.estimators.lattice_format import save_weights
from xihenet.nets.lattice import LatticeNet, weights_of
from xihenet.training.networks import load_network


def export_lattice(
    trained: Path, out: Path, *, data: str = "", figures: Mapping[str, Any] | None = None, is_half: bool = True
) -> None:
    """Write the network in `trained` (.pt) to `out` (.npz), in float16 unless `is_half` is False.

    `data` and `figures` are for people to read. ValueError if the file is broken or holds another kind of network.
    """
    loaded = load_network(trained)
    if not isinstance(loaded.net, LatticeNet):
        raise ValueError(f"{trained}: expected a trained lattice network, got {loaded.estimator}")
    weights = weights_of(loaded.net, loaded.target, data=data, seed=loaded.seed, figures=figures or {})
    out.parent.mkdir(parents=True, exist_ok=True)
    save_weights(out, weights, is_half=is_half)
