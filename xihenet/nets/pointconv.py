"""The paper's network: two density-weighted PointConv blocks, (64, 128) and (128, 256), and dense layers to 27 numbers.

PointConv (Wu, Qi and Li 2019): around some of the points a convolution whose weights are a function of the neighbours'
relative positions, each neighbour weighted by the inverse of its density. Centroids are farthest points, neighbours the
k nearest. Differences from the reference, each for a reason: anchors that are not set are left out instead of being put
at the origin, where they are one point repeated hundreds of times (`keeps_unset_at_origin` shows what that changes);
layers are normalised per point and not per batch, so that one cloud gives what it gives in a batch; and there is no
ReLU at the end, because coefficients of l >= 1 are negative half of the time.

Uniform and farthest-point samples enter as points too: only the sampling tells `pointar` from `xihenet`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

_FAR = 1e9


@dataclass(frozen=True)
class PointConvArchitecture:
    """Sizes of the network.

    Parameters
    ----------
    centroids : points kept by the first and by the second block
    n_neighbours : points around each centroid
    n_weights : outputs of the function that makes weights from relative positions
    bandwidth : of the density's Gaussian, relative to the cloud's mean distance
    keeps_unset_at_origin : unset anchors enter as black points at the origin, as in the reference
    """

    centroids: tuple[int, int] = (128, 32)
    n_neighbours: int = 32
    n_weights: int = 16
    bandwidth: float = 0.1
    keeps_unset_at_origin: bool = False


class PointConvNet(nn.Module):  # type: ignore[misc]
    """`forward(points_m (B, N, 3), srgb (B, N, 3), is_set (B, N))` gives (B, 9, 3).

    Points are relative to the position. N may differ from call to call. A cloud without a set point gives what the
    dense layers make of nothing: finite.
    """

    def __init__(self, architecture: PointConvArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or PointConvArchitecture()
        first, second = self.architecture.centroids
        self.block_1 = PointConvBlock(3, (64, 128), first, self.architecture)
        self.block_2 = PointConvBlock(128, (128, 256), second, self.architecture)
        self.head = nn.Sequential(nn.Linear(512, 256), nn.LayerNorm(256), nn.ReLU(), nn.Linear(256, 27))

    def forward(self, points_m: Tensor, srgb: Tensor, is_set: Tensor) -> Tensor:
        known = torch.ones_like(is_set) if self.architecture.keeps_unset_at_origin else is_set
        places, features, known = self.block_1(points_m * is_set[..., None], srgb * is_set[..., None], known)
        _, features, known = self.block_2(places, features, known)
        weight = known[..., None].float()
        mean = (features * weight).sum(1) / weight.sum(1).clamp(min=1)
        largest = torch.where(known[..., None], features, -_FAR).amax(1)
        largest = torch.where(known.any(1, keepdim=True), largest, 0.0)
        return cast(Tensor, self.head(torch.cat([mean, largest], 1))).reshape(-1, 9, 3)


class PointConvBlock(nn.Module):  # type: ignore[misc]
    """One density-weighted PointConv: N points with features in, `n_centroids` points with features out."""

    def __init__(
        self, n_in: int, widths: tuple[int, int], n_centroids: int, architecture: PointConvArchitecture
    ) -> None:
        super().__init__()
        self.n_centroids, self.n_neighbours = n_centroids, architecture.n_neighbours
        self.bandwidth = architecture.bandwidth
        self.per_point = _dense(n_in + 3, *widths)
        self.weights = _dense(3, 8, architecture.n_weights)
        self.density = _dense(1, 8, 1)
        self.combine = _dense(architecture.n_weights * widths[1], widths[1])

    def forward(self, points_m: Tensor, features: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # Relative to the cloud's size: rooms differ by a factor of ten, and a bandwidth in metres would fit one.
        size = (points_m.norm(dim=2) * known).sum(1) / known.sum(1).clamp(min=1)
        places = points_m / size.clamp(min=1e-3)[:, None, None]
        inverse_density = _inverse_density(places, known, self.bandwidth)
        centroids, is_centroid = farthest_points(places, known, self.n_centroids)
        near, is_near = _nearest(_rows(places, centroids), places, known, self.n_neighbours)
        relative = _rows(places, near) - _rows(places, centroids)[:, :, None]
        inputs = torch.cat([relative, _rows(features, near)], -1)
        convolved = self.per_point(inputs) * self.density(_rows(inverse_density[..., None], near))
        convolved = convolved * is_near[..., None]
        mixed = torch.matmul(convolved.transpose(2, 3), self.weights(relative)) / self.n_neighbours
        combined = self.combine(mixed.flatten(2)) * is_centroid[..., None]
        return _rows(points_m, centroids), combined, is_centroid


def farthest_points(points: Tensor, known: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """(B, n) numbers of points of which each is the farthest from those before, and whether it is a new one.

    Starts at the first known point. Where the known points are used up, numbers repeat and are marked False.
    """
    with torch.no_grad():
        rows = torch.arange(len(points), device=points.device)
        remaining = torch.where(known, _FAR, -1.0)
        chosen, is_new = [], []
        for _ in range(n):
            value, index = remaining.max(1)
            chosen.append(index)
            is_new.append(value > 0)
            squared = (points - points[rows, index][:, None]).square().sum(2)
            remaining = torch.minimum(remaining, squared)
        return torch.stack(chosen, 1), torch.stack(is_new, 1)


def _dense(*widths: int) -> nn.Sequential:
    """Linear layers, each normalised per point and rectified; a single output is only squashed."""
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise(widths):
        layers.append(nn.Linear(n_in, n_out))
        layers.extend([nn.LayerNorm(n_out), nn.ReLU()] if n_out > 1 else [nn.Sigmoid()])
    return nn.Sequential(*layers)


def _rows(values: Tensor, index: Tensor) -> Tensor:
    """values (B, N, C) at index (B, ...): (B, ..., C)."""
    batch = torch.arange(len(values), device=values.device).reshape(-1, *[1] * (index.ndim - 1))
    return values[batch, index]


def _squared_distances(a: Tensor, b: Tensor) -> Tensor:
    """(B, S, N), without the cancellation that a product of the two would bring."""
    return torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist").square()


def _inverse_density(places: Tensor, known: Tensor, bandwidth: float) -> Tensor:
    """(B, N) in 0 to 1, 1 where a cloud is thinnest; 0 for what is not known. Gaussian kernel density."""
    with torch.no_grad():
        kernel = torch.exp(-_squared_distances(places, places) / (2 * bandwidth**2)) * known[:, None]
        inverse = known / kernel.sum(2).clamp(min=1e-6)
        return inverse / inverse.amax(1, keepdim=True).clamp(min=1e-6)


def _nearest(centroids: Tensor, places: Tensor, known: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """(B, S, k) numbers of the nearest known points, and which of them are known."""
    with torch.no_grad():
        squared = torch.where(known[:, None], _squared_distances(centroids, places), _FAR)
        value, index = squared.topk(min(k, places.shape[1]), dim=2, largest=False)
        return index, value < _FAR
