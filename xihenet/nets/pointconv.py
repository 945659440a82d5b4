"""The paper's network: two density-weighted PointConv blocks, (64, 128) and (128, 256), and dense layers to 27 numbers.

PointConv (Wu, Qi and Li 2019): around some of the points a convolution whose weights are a function of the neighbours'
relative positions, each neighbour weighted by the inverse of its density. Centroids are farthest points, neighbours the
k nearest. Differences from the reference, each for a reason: anchors that are not set are left out instead of being put
at the origin, where they are one point repeated hundreds of times (`keeps_unset_at_origin` shows what that changes);
layers are normalised per point and not per batch, so that one cloud gives what it gives in a batch; and there is no
ReLU at the end, because coefficients of l >= 1 are negative half of the time.

Written for two cores. Points and centroids pass the first layer of each block, which is linear, before neighbours are
gathered; density and weights are multiplied where they are narrow; unset points are cut off; and a few clouds at a time
are convolved, so that they stay in the cache. The plain form stands in the tests, which hold the two together.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from xihenet.estimators.pointconv_network import PointConvArchitecture

_FAR = 1e9
# Larger blocks leave the cache, smaller ones gain nothing.
_NEIGHBOURS_AT_ONCE = 8192  # rows of some 100 numbers
_PAIRS_AT_ONCE = 160_000  # whose distances are taken


class PointConvNet(nn.Module):  # type: ignore[misc]
    """`forward(points_m (B, N, 3), srgb (B, N, 3), is_set (B, N))` gives (B, 9, 3), float32.

    Points are relative to the position; their order says nothing. B and N are at least 1 and may differ from call to
    call. A cloud without a set point gives what the dense layers make of nothing: finite.
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
        inputs = _known_first(points_m * is_set[..., None], srgb * is_set[..., None], known)
        is_halved = self.training and self.architecture.is_bfloat16_in_training
        with torch.autocast(points_m.device.type, torch.bfloat16, enabled=is_halved):
            _, features, known = self.block_2(*self.block_1(*inputs))
        features, weight = features.float(), known[..., None].float()
        mean = (features * weight).sum(1) / weight.sum(1).clamp(min=1)
        largest = torch.where(known[..., None], features, -_FAR).amax(1)
        largest = torch.where(known.any(1, keepdim=True), largest, 0.0)
        return self.head(torch.cat([mean, largest], 1)).reshape(-1, 9, 3)


class Neighbourhoods(NamedTuple):
    """What does not depend on weights: who is near whom. S centroids with k neighbours each.

    Points that are not known are near only where others are missing, and have an inverse density of 0.
    """

    places: Tensor  # (B, N, 3) relative to the cloud's size
    inverse_density: Tensor  # (B, N)
    centroids: Tensor  # (B, S) numbers of points
    is_centroid: Tensor  # (B, S), False where the known points were used up
    near: Tensor  # (B, S, k) numbers of points


class PointConvBlock(nn.Module):  # type: ignore[misc]
    """One density-weighted PointConv: N points with features in, `n_centroids` points (or N) with features out."""

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
        around = self.neighbourhoods(points_m, known)
        middle = _rows(around.places, around.centroids)
        relative = _rows(around.places, around.near) - middle[:, :, None]
        share = self.density(around.inverse_density[..., None]) * (known[..., None] / self.n_neighbours)
        first = cast(nn.Linear, self.per_point[0])
        # In float32 also while training in bfloat16: near points differ by less than bfloat16 tells apart.
        with torch.autocast(points_m.device.type, enabled=False):
            of_points = first(torch.cat([around.places, features.float()], -1))
            of_centroids = middle @ first.weight[:, :3].T
        parts = (of_points, of_centroids, share, relative, around.near)
        n_clouds, n_centroids, k = around.near.shape
        n_at_once = n_clouds if around.near.is_cuda else max(1, _NEIGHBOURS_AT_ONCE // (n_centroids * k))
        blocks = zip(*(part.split(n_at_once) for part in parts), strict=True)
        convolved = torch.cat([self._convolve(*block) for block in blocks])
        return _rows(points_m, around.centroids), convolved * around.is_centroid[..., None], around.is_centroid

    def neighbourhoods(self, points_m: Tensor, known: Tensor) -> Neighbourhoods:
        """From points_m (B, N, 3) and known (B, N)."""
        with torch.no_grad():
            # Relative to the cloud's size: rooms differ by a factor of ten, and a bandwidth in metres would fit one.
            size = (points_m.norm(dim=2) * known).sum(1) / known.sum(1).clamp(min=1)
            places = points_m / size.clamp(min=1e-3)[:, None, None]
            n_points = known.shape[1]
            centroids, is_centroid = farthest_points(places, known, min(self.n_centroids, n_points))
            from_centroids = _squared_distances(_rows(places, centroids), places)
            from_centroids = torch.where(known[:, None], from_centroids, _FAR)
            near = from_centroids.topk(min(self.n_neighbours, n_points), dim=2, largest=False).indices
            inverse_density = _inverse_density(places, known, self.bandwidth)
            return Neighbourhoods(places, inverse_density, centroids, is_centroid, near)

    def _convolve(
        self, of_points: Tensor, of_centroids: Tensor, share: Tensor, relative: Tensor, near: Tensor
    ) -> Tensor:
        """(B, S, features) of some clouds."""
        first = _gather(of_points, near) - of_centroids[:, :, None]
        features = self.per_point[1:](first)
        weights = self.weights(relative) * _gather(share, near)
        return self.combine(torch.matmul(features.transpose(2, 3), weights).flatten(2))


def farthest_points(points: Tensor, known: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """(B, n) numbers of points (B, N, 3) of which each is the farthest from those before, and whether it is a new one.

    Starts at the known point farthest from the origin, so that the order of the points says nothing. Where the known
    points are used up, numbers repeat and are marked False.
    """
    with torch.no_grad():
        rows = torch.arange(len(points), device=points.device)
        index = torch.where(known, points.square().sum(2), -1.0).argmax(1)
        remaining = torch.where(known, _FAR, -1.0)
        chosen, is_new = [index], [known.any(1)]
        for _ in range(n - 1):
            remaining = torch.minimum(remaining, _squared_distances(points[rows, index, None], points)[:, 0])
            value, index = remaining.max(1)
            chosen.append(index)
            is_new.append(value > 0)
        return torch.stack(chosen, 1), torch.stack(is_new, 1)


def _known_first(points: Tensor, colours: Tensor, known: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same clouds, their known points first, cut to as many points as the fullest has."""
    order = known.to(torch.uint8).argsort(dim=1, descending=True, stable=True)
    order = order[:, : max(1, int(known.sum(1).max()))]
    return _rows(points, order), _rows(colours, order), known.gather(1, order)


def _dense(*widths: int) -> nn.Sequential:
    """Linear layers, each normalised per point and rectified; a single output is only squashed."""
    layers: list[nn.Module] = []
    for n_in, n_out in itertools.pairwise(widths):
        layers.append(nn.Linear(n_in, n_out))
        layers.extend([nn.LayerNorm(n_out), nn.ReLU(inplace=True)] if n_out > 1 else [nn.Sigmoid()])
    return nn.Sequential(*layers)


def _rows(values: Tensor, index: Tensor) -> Tensor:
    """values (B, N, C) at index (B, ...): (B, ..., C)."""
    batch = torch.arange(len(values), device=values.device).reshape(-1, *[1] * (index.ndim - 1))
    return values[batch, index]


def _gather(values: Tensor, index: Tensor) -> Tensor:
    """As `_rows`, by a look-up whose gradient is summed in a fixed order, also on a GPU."""
    n_clouds, n_points, n_features = values.shape
    offsets = torch.arange(0, n_clouds * n_points, n_points, device=values.device)
    table = values.reshape(n_clouds * n_points, n_features)
    return nn.functional.embedding(index + offsets.reshape(-1, *[1] * (index.ndim - 1)), table)


def _squared_distances(some: Tensor, others: Tensor) -> Tensor:
    """(B, M, N) of (B, M, 3) and (B, N, 3), without the cancellation that a product of the two would bring."""
    x, y, z = (some[..., axis, None] - others.mT.contiguous()[:, axis, None] for axis in range(3))
    return x.square_().addcmul_(y, y).addcmul_(z, z)


def _inverse_density(places: Tensor, known: Tensor, bandwidth: float) -> Tensor:
    """(B, N) in 0 to 1, 1 where a cloud is thinnest; 0 for what is not known. Gaussian kernel density."""
    n_clouds, n_points, _ = places.shape
    clouds_at_once, rows_at_once = (n_clouds, n_points) if places.is_cuda else (1, max(1, _PAIRS_AT_ONCE // n_points))
    density = places.new_empty(known.shape)
    for first in range(0, n_clouds, clouds_at_once):
        clouds = slice(first, first + clouds_at_once)
        for row in range(0, n_points, rows_at_once):
            rows = slice(row, row + rows_at_once)
            density[clouds, rows] = _kernel_sums(places[clouds, rows], places[clouds], known[clouds], bandwidth)
    inverse = known / density.clamp(min=1e-6)
    return inverse / inverse.amax(1, keepdim=True).clamp(min=1e-6)


def _kernel_sums(rows: Tensor, places: Tensor, known: Tensor, bandwidth: float) -> Tensor:
    """(B, M) at rows (B, M, 3)."""
    # Nothing beside the point itself, which adds 1; below that, exp gives denormal numbers ten times as slowly.
    kernel = _squared_distances(rows, places).mul_(-0.5 / bandwidth**2).clamp_(min=-80).exp_()
    return kernel.mul_(known[:, None]).sum(2)
