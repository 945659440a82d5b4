"""Export of a trained network to the weights file that an estimator reads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from xihenet.estimators.weights_format import NetworkWeights, save_weights
from xihenet.nets import lattice, pointconv
from xihenet.training.networks import load_network


def export_network(
    trained: Path,
    out: Path,
    *,
    data: str = "",
    figures: Mapping[str, Any] | None = None,
    n_points: int | None = None,
    is_half: bool = True,
) -> None:
    """Write the network in `trained` (.pt) to `out` (.npz), in float16 unless `is_half` is False.

    `data` and `figures` are for people to read. `n_points` are the anchors or points of the clouds it was trained with:
    `pointar` draws as many. ValueError if the file is broken or float16 cannot hold the weights.
    """
    loaded = load_network(trained)
    notes = {"data": data, "seed": loaded.seed, "figures": figures or {}, "n_points": n_points}
    weights: NetworkWeights[Any]
    if isinstance(loaded.net, lattice.LatticeNet):
        weights = lattice.weights_of(loaded.net, loaded.target, **notes)
    else:
        assert isinstance(loaded.net, pointconv.PointConvNet)
        weights = pointconv.weights_of(loaded.net, loaded.target, estimator=loaded.estimator, **notes)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_weights(out, weights, is_half=is_half)
