"""The PointConv network of `xihenet` and `pointar`, one cloud at a time in NumPy, so that Blender needs no torch.

It computes what `xihenet.nets.pointconv` computes, which trains it; the paper, and what differs from it, stand there,
and a test holds the two within 1e-5. A cloud's points that are not known are dropped first, so nothing here has a mask.
The first layer of a block is linear in a neighbour's place, so points and centroids pass through it before neighbours
are gathered. All is float32. Rejected: batches, which gain nothing here, since neighbours differ from cloud to cloud.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from xihenet.estimators.weights_format import NetworkWeights, read_weights
from xihenet.records import ArrayF32, ArrayInt

_SMALLEST_SIZE = np.float32(1e-3)
_SMALLEST_SUM = np.float32(1e-6)
_NORMALISING = np.float32(1e-5)
_LOWEST_EXPONENT = np.float32(-80)  # below it exp gives denormal numbers, ten times as slowly


@dataclass(frozen=True)
class PointConvArchitecture:
    """Sizes of the network; the defaults are the paper's and make 1,511,021 parameters."""

    centroids: tuple[int, int] = (128, 32)  # points kept by the first and by the second block
    n_neighbours: int = 32  # points around each centroid
    n_weights: int = 16  # outputs of the function that makes weights from relative positions
    bandwidth: float = 0.1  # of the density's Gaussian, relative to the cloud's mean distance
    keeps_unset_at_origin: bool = False  # unset anchors enter as black points at the origin, as in the reference
    is_bfloat16_in_training: bool = False  # matrix products while it trains, where the processor has them

    def __post_init__(self) -> None:
        sizes = [*self.centroids, self.n_neighbours, self.n_weights]
        if len(sizes) != 4 or any(type(size) is not int or not 1 <= size <= 65_536 for size in sizes):
            raise ValueError(f"architecture: expected two blocks and sizes of 1 to 65536, got {asdict(self)}")
        if type(self.bandwidth) is not float or not 0 < self.bandwidth < math.inf:
            raise ValueError(f"architecture: expected a positive bandwidth, got {self.bandwidth!r}")
        switches = self.keeps_unset_at_origin, self.is_bfloat16_in_training
        if any(type(switch) is not bool for switch in switches):
            raise ValueError(f"architecture: expected switches that are true or false, got {switches}")

    def array_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each array of a weights file, by the name that torch gives it."""
        shapes: dict[str, tuple[int, ...]] = {}
        for block, n_in, widths in (("block_1", 3, (64, 128)), ("block_2", 128, (128, 256))):
            shapes |= _dense_shapes(f"{block}.per_point", n_in + 3, *widths)
            shapes |= _dense_shapes(f"{block}.weights", 3, 8, self.n_weights)
            shapes |= _dense_shapes(f"{block}.density", 1, 8, 1)
            shapes |= _dense_shapes(f"{block}.combine", self.n_weights * widths[1], widths[1])
        return shapes | _dense_shapes("head", 512, 256) | {"head.3.weight": (27, 256), "head.3.bias": (27,)}


PointConvWeights = NetworkWeights[PointConvArchitecture]


def load_pointconv_weights(path: Path, estimator: str) -> PointConvWeights:
    """Read and check PointConv weights of `estimator`. ValueError naming the file, also if it is missing."""
    return read_weights(path, estimator, _architecture_from)


def _architecture_from(sizes: dict[str, Any]) -> PointConvArchitecture:
    return PointConvArchitecture(**{**sizes, "centroids": tuple(sizes["centroids"])})


def _dense_shapes(name: str, *widths: int) -> dict[str, tuple[int, ...]]:
    """Linear layers at every third place, each with its normalisation behind it unless it has a single output."""
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (n_in, n_out) in enumerate(itertools.pairwise(widths)):
        shapes[f"{name}.{3 * i}.weight"], shapes[f"{name}.{3 * i}.bias"] = (n_out, n_in), (n_out,)
        if n_out > 1:
            shapes[f"{name}.{3 * i + 1}.weight"] = shapes[f"{name}.{3 * i + 1}.bias"] = (n_out,)
    return shapes


class PointConvNetwork:
    """The network with these weights."""

    def __init__(self, weights: PointConvWeights) -> None:
        self._arrays, self._sizes = weights.arrays, weights.architecture

    def light(self, points_m: ArrayF32, srgb: ArrayF32) -> ArrayF32:
        """(9, 3) from the known points (P, 3), relative to the position, and their colours (P, 3); P may be 0."""
        summary = np.zeros(512, np.float32)
        if len(points_m):
            points_m, features = self._block("block_1", self._sizes.centroids[0], points_m, srgb)
            _, features = self._block("block_2", self._sizes.centroids[1], points_m, features)
            summary = np.concatenate([features.mean(axis=0), features.max(axis=0)])
        return self._dense("head", summary[None]).reshape(9, 3)

    def _block(self, block: str, n_centroids: int, points_m: ArrayF32, features: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """The centroids of P points (P, 3), and their features, from those of the points."""
        # Relative to the cloud's size: rooms differ by a factor of ten, and a bandwidth in metres would fit one.
        places = points_m / max(_SMALLEST_SIZE, np.sqrt(np.einsum("pi,pi->p", points_m, points_m)).mean())
        squared = _squared_distances(places)
        share = self._dense(f"{block}.density", _inverse_density(squared, self._sizes.bandwidth)[:, None])
        centroids = _farthest_points(places, squared, n_centroids)
        near = _nearest(squared[centroids], self._sizes.n_neighbours)
        middle = places[centroids]

        first = f"{block}.per_point.0"
        of_points = self._linear(first, np.concatenate([places, features], axis=1))
        of_centroids = middle @ self._arrays[f"{first}.weight"][:, :3].T
        per_neighbour = self._normalised(f"{block}.per_point.1", of_points[near] - of_centroids[:, None])
        per_neighbour = self._dense(f"{block}.per_point", per_neighbour, first=3)
        weights = self._dense(f"{block}.weights", places[near] - middle[:, None])
        weights *= share[near] / np.float32(self._sizes.n_neighbours)
        mixed = per_neighbour.swapaxes(1, 2) @ weights
        return points_m[centroids], self._dense(f"{block}.combine", mixed.reshape(len(centroids), -1))

    def _dense(self, name: str, values: ArrayF32, first: int = 0) -> ArrayF32:
        """Linear layers at every third place from `first` on, with what stands behind each."""
        while f"{name}.{first}.weight" in self._arrays:
            values = self._linear(f"{name}.{first}", values)
            if f"{name}.{first + 1}.weight" in self._arrays:
                values = self._normalised(f"{name}.{first + 1}", values)
            elif values.shape[-1] == 1:
                values = 1 / (1 + np.exp(-values))
            first += 3
        return values

    def _linear(self, name: str, values: ArrayF32) -> ArrayF32:
        # One product of two matrices: of a stack of small ones each would be one of its own.
        flat = values.reshape(-1, values.shape[-1]) @ self._arrays[f"{name}.weight"].T
        flat += self._arrays[f"{name}.bias"]
        return flat.reshape(*values.shape[:-1], -1)

    def _normalised(self, name: str, values: ArrayF32) -> ArrayF32:
        """To mean 0 and variance 1 per point, scaled, and rectified."""
        values = values - values.mean(axis=-1, keepdims=True)
        variance = np.einsum("...i,...i->...", values, values)[..., None] / np.float32(values.shape[-1])
        values /= np.sqrt(variance + _NORMALISING)
        values *= self._arrays[f"{name}.weight"]
        values += self._arrays[f"{name}.bias"]
        return np.maximum(values, 0, out=values)


def _squared_distances(places: ArrayF32) -> ArrayF32:
    """(P, P), without the cancellation that a matrix product would bring."""
    squared = np.zeros((len(places), len(places)), np.float32)
    for column in places.T:
        difference = column[:, None] - column
        difference *= difference
        squared += difference
    return squared


def _inverse_density(squared: ArrayF32, bandwidth: float) -> ArrayF32:
    """(P,) in 0 to 1, and 1 where the cloud is thinnest. Gaussian kernel density."""
    kernel = squared * np.float32(-0.5 / bandwidth**2)
    np.maximum(kernel, _LOWEST_EXPONENT, out=kernel)
    inverse = 1 / np.maximum(np.exp(kernel, out=kernel).sum(axis=1), _SMALLEST_SUM)
    return inverse / max(inverse.max(), _SMALLEST_SUM)


def _farthest_points(places: ArrayF32, squared: ArrayF32, n: int) -> ArrayInt:
    """Numbers of at most `n` points, each the farthest from those before; the first is the farthest from the origin.

    Fewer where the rest stand where one of these stands.
    """
    chosen = [int(np.einsum("pi,pi->p", places, places).argmax())]
    remaining = squared[chosen[0]].copy()
    while len(chosen) < min(n, len(places)):
        farthest = int(remaining.argmax())
        if not remaining[farthest] > 0:
            break
        chosen.append(farthest)
        np.minimum(remaining, squared[farthest], out=remaining)
    return np.array(chosen)


def _nearest(squared: ArrayF32, k: int) -> ArrayInt:
    """(S, k) numbers of the columns with the smallest of (S, P) squared distances, in no order; all of fewer."""
    if squared.shape[1] <= k:
        return np.broadcast_to(np.arange(squared.shape[1]), squared.shape)
    return np.argpartition(squared, k - 1, axis=1)[:, :k]
