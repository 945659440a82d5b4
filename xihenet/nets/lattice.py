"""The lattice network in torch: what is trained, and what runs on a GPU.

`xihenet.estimators.lattice` runs the same network in NumPy and explains it; the two share tables and constants, and a
test holds them within 1e-5. Here each layer is one `Linear` under the name that the weights file uses, with the
directions among its inputs: plain, where the NumPy side is fast.

Rejected: attention over the anchors (slower in NumPy by a magnitude) and 27 numbers straight from a dense layer, which
do not know that they are one light.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from xihenet.estimators.lattice import (
    CLIPPED_FROM,
    CONTRAST_SCALE,
    FARTHEST_M,
    NEAREST_M,
    SMALLEST_ERROR,
    SMALLEST_MEAN,
    SMALLEST_SHARE,
    SQUARED_BAND,
)
from xihenet.estimators.lattice_format import N_SH, LatticeArchitecture, anchor_tables, pooling_table, quadrature_matrix
from xihenet.sh import FACING_OFFSET, L1_VARIANCE, LEAST_WEIGHT, RESIDUAL_NOISE, SMALLEST_PENALTY


class LatticeNet(nn.Module):  # type: ignore[misc]
    """Starts as the plain projection: the layers that change it start at 0.

    `forward(srgb (B, N, 3), distance_m (B, N), is_set (B, N), facing (B, N) or None)` gives (B, 9, 3) coefficients and
    (B,) expected errors; N may differ from call to call. Anchors that are not set must be 0. The expected error sends
    no gradient into the layers that make the light.
    """

    def __init__(self, architecture: LatticeArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or LatticeArchitecture()
        for name, (n_in, n_out) in self.architecture.layer_sizes().items():
            self.add_module(name, nn.Linear(n_in, n_out))
        for name in ("radiance", "gate"):
            nn.init.zeros_(self.layer(name).weight)
            nn.init.zeros_(self.layer(name).bias)
        self._on_device: dict[tuple[str, int, int, torch.device], Tensor] = {}

    def layer(self, name: str) -> nn.Linear:
        return cast(nn.Linear, self.get_submodule(name))

    def forward(
        self, srgb: Tensor, distance_m: Tensor, is_set: Tensor, facing: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        known = is_set.to(torch.float32)
        counted = known
        if facing is None or not self.architecture.knows_facing:
            facing = torch.zeros_like(known)
        else:
            counted = known * (facing + FACING_OFFSET).clamp(LEAST_WEIGHT, 1.0)
            facing = known * facing
        linear = linear_from_srgb(srgb)
        n_set = known.sum(1).clamp(min=1)
        mean = (linear.double().sum(1) / n_set[:, None]).float()
        level = mean.mean(1).clamp(min=SMALLEST_MEAN)
        residual = (linear - mean[:, None]) * known[..., None]
        contrast = _contrast(residual, n_set, level)
        scale = level if self.architecture.is_exposure_normalised else torch.ones_like(level)
        projection = self._project(residual, counted, mean)
        middle, coarse, share, projected = self._levels(srgb, linear, distance_m, known, facing, projection, scale)
        code = self._code(coarse, projection, known, level, scale)
        radiance = self._radiance(middle, share, projected, code) * contrast[:, None, None]
        gate = 1 + contrast[:, None] * torch.tanh(self.layer("gate")(code))
        quadrature = self._constant("quadrature", self.architecture.levels[1], 0, srgb.device)
        sh_radiance = gate[..., None] * projection + (quadrature @ radiance) * scale[:, None, None]
        sh_radiance = torch.cat([sh_radiance[:, :1].clamp(min=0), sh_radiance[:, 1:]], 1)
        raw = self.layer("error")(torch.relu(self.layer("error_hidden")(code.detach())))[:, 0]
        return sh_radiance, nn.functional.softplus(raw) * scale + SMALLEST_ERROR

    def _project(self, residual: Tensor, counted: Tensor, mean: Tensor) -> Tensor:
        """(B, 9, 3): `xihenet.sh.project_anchors` for a batch, its small systems in float64."""
        n, device = counted.shape[1], counted.device
        products = self._constant("basis_products", n, 0, device)
        gram = (counted @ products).reshape(-1, N_SH, N_SH).double() * (4 * np.pi / n)
        penalty = (1 - counted.double().mean(1)) * RESIDUAL_NOISE / L1_VARIANCE + SMALLEST_PENALTY
        identity = torch.eye(N_SH, dtype=torch.float64, device=device)
        bands = torch.diag(torch.as_tensor(SQUARED_BAND, device=device))
        normal_matrix = torch.where(counted.amax(1)[:, None, None] > 0, gram + penalty[:, None, None] * bands, identity)
        weighted = residual * counted[..., None]
        right_side = (self._constant("basis", n, 0, device).T @ weighted).double() * (4 * np.pi / n)
        coefficients = torch.linalg.solve(normal_matrix, right_side).float()
        constant = mean[:, None] * float(np.sqrt(4 * np.pi))
        return torch.cat([coefficients[:, :1] + constant, coefficients[:, 1:]], 1)

    def _levels(
        self, srgb: Tensor, linear: Tensor, distance_m: Tensor, known: Tensor, facing: Tensor, projection: Tensor,
        scale: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
        """Features of the middle and the coarsest lattice; share set and projection of the middle one."""
        by_scale = scale[:, None, None]
        inputs = [
            linear / (linear + by_scale),
            srgb,
            (srgb.amax(2, keepdim=True) >= CLIPPED_FROM).float(),
            torch.log(distance_m.clamp(max=FARTHEST_M) + NEAREST_M)[..., None],
            *([facing[..., None]] if self.architecture.knows_facing else []),
            *self._placed_inputs(projection, by_scale, srgb.shape[1]),
        ]
        features, weight = torch.relu(self.layer("stem")(torch.cat(inputs, 2))), known[..., None]
        levels, n_fine = [], srgb.shape[1]
        for name, n_coarse in zip(("fine", "middle", "coarse"), self.architecture.levels, strict=True):
            pooled, weight = self._pool(features, weight, n_fine, n_coarse)
            placed = self._placed_inputs(projection, by_scale, n_coarse)
            features = torch.relu(self.layer(name)(torch.cat([pooled, weight, *placed], 2)))
            levels.append((features, weight, placed[0]))
            n_fine = n_coarse
        return levels[1][0], levels[2][0], levels[1][1], levels[1][2]

    def _placed_inputs(self, projection: Tensor, by_scale: Tensor, n: int) -> tuple[Tensor, Tensor]:
        """(B, n, 3) squeezed radiance of the projection in the anchors' directions, and those directions."""
        light = self._constant("basis", n, 0, projection.device) @ projection
        directions = self._constant("directions", n, 0, projection.device)
        return light / (light.abs() + by_scale), directions.expand(len(projection), -1, -1)

    def _pool(self, features: Tensor, weight: Tensor, n_fine: int, n_coarse: int) -> tuple[Tensor, Tensor]:
        """Weighted means over each coarse anchor's members, and their mean weight (B, n, 1)."""
        members = self._constant("members", n_fine, n_coarse, features.device)
        counts = self._constant("counts", n_fine, n_coarse, features.device)
        padded = nn.functional.pad(torch.cat([features * weight, weight], 2), (0, 0, 0, 1))
        sums = padded[:, members].sum(2)
        total = sums[..., -1:]
        return sums[..., :-1] / total.clamp(min=SMALLEST_SHARE), total / counts[:, None]

    def _code(self, coarse: Tensor, projection: Tensor, known: Tensor, level: Tensor, scale: Tensor) -> Tensor:
        """(B, code): what the whole sphere says."""
        narrow = torch.relu(self.layer("narrow")(coarse)).flatten(1)
        light = (projection / (projection.abs() + scale[:, None, None])).flatten(1)
        inputs = [narrow, light, known.mean(1, keepdim=True), torch.log(level)[:, None] / 3]
        hidden = torch.relu(self.layer("dense")(torch.cat(inputs, 1)))
        return torch.relu(self.layer("code")(hidden))

    def _radiance(self, middle: Tensor, share: Tensor, projected: Tensor, code: Tensor) -> Tensor:
        """(B, n, 3) what the projection lacks in the directions of the middle lattice, relative to the scale."""
        n = middle.shape[1]
        spread = self.layer("spread")(code).reshape(len(code), n, -1)
        directions = self._constant("directions", n, 0, code.device).expand(len(code), -1, -1)
        hidden = self.layer("decoder")(torch.cat([middle, spread, share, projected, directions], 2))
        return cast(Tensor, self.layer("radiance")(torch.relu(hidden)))

    def _constant(self, name: str, n: int, n_coarse: int, device: torch.device) -> Tensor:
        """A table as a tensor, kept per device; no part of the state that is saved."""
        key = (name, n, n_coarse, device)
        if key not in self._on_device:
            tables = pooling_table(n, n_coarse) if n_coarse else anchor_tables(n)
            table = quadrature_matrix(n) if name == "quadrature" else getattr(tables, name)
            self._on_device[key] = torch.tensor(table, device=device)
        return self._on_device[key]


def linear_from_srgb(srgb: Tensor) -> Tensor:
    """`xihenet.colour.srgb_to_linear` for colours in [0, 1]."""
    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _contrast(residual: Tensor, n_set: Tensor, level: Tensor) -> Tensor:
    """(B,) 0 where all that was seen is alike, near 1 for any real picture."""
    variance = (residual / level[:, None, None]).square().sum((1, 2)) / (3 * n_set)
    return variance / (variance + CONTRAST_SCALE**2)
