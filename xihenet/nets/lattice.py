"""The lattice network in torch: what is trained, and what runs on a GPU.

`xihenet.estimators.lattice_network` runs the same network in NumPy and explains it; the two share tables and constants,
and a test holds them within 1e-5. Here each layer is one `Linear` under the name that the weights file uses, with the
heights among its inputs: plain, where the NumPy side is fast.

Rejected: attention over the anchors (slower in NumPy by a magnitude) and 27 numbers straight from a dense layer, which
do not know that they are one light.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from xihenet.colour import CLIPPED_FROM
from xihenet.estimators.lattice_format import (
    GATE_OF,
    LEVELS,
    N_SH,
    LatticeArchitecture,
    basis_products,
    place_tables,
    pooling_matrix,
    pooling_table,
    quadrature_matrix,
)
from xihenet.estimators.lattice_network import (
    BRIGHT_GUESS,
    BRIGHT_GUESS_LDR,
    BRIGHT_LAMPS,
    CONTRAST_SCALE,
    DOUBT,
    FARTHEST_M,
    MOST_ADDED,
    NEAREST_M,
    SKY_FROM_M,
    SMALLEST_ERROR,
    SMALLEST_MEAN,
    SMALLEST_SHARE,
    SQUARED_BAND,
)
from xihenet.estimators.ring_grid import N_TURNS, ring_grid, turns_of_light
from xihenet.sh import FACING_OFFSET, L1_VARIANCE, LEAST_WEIGHT, RESIDUAL_NOISE, SMALLEST_PENALTY


class LatticeNet(nn.Module):  # type: ignore[misc]
    """Starts as the plain projection: the layers that change it start at 0.

    `forward(srgb (B, N, 3), distance_m (B, N), is_set (B, N), facing (B, N) or None)` gives (B, 9, 3) coefficients and
    (B,) expected errors; N may differ from call to call. Anchors that are not set must be 0. The expected error sends
    no gradient into the layers that make the light. While it trains, all that it adds counts, bright or doubtful.
    """

    def __init__(self, architecture: LatticeArchitecture | None = None) -> None:
        super().__init__()
        self.architecture = architecture or LatticeArchitecture()
        for name, (n_in, n_out) in self.architecture.layer_sizes().items():
            self.add_module(name, nn.Linear(n_in, n_out))
        for name in ("radiance", "gate"):
            nn.init.zeros_(self.layer(name).weight)
            nn.init.zeros_(self.layer(name).bias)
        self._on_device: dict[tuple[str, int, torch.device], Tensor] = {}

    def layer(self, name: str) -> nn.Linear:
        return cast(nn.Linear, self.get_submodule(name))

    def forward(
        self, srgb: Tensor, distance_m: Tensor, is_set: Tensor, facing: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        known = is_set.to(torch.float32)
        counted = known if facing is None else known * (facing + FACING_OFFSET).clamp(LEAST_WEIGHT, 1.0)
        facing = torch.zeros_like(known) if facing is None else known * facing
        linear = linear_from_srgb(srgb)
        n_set = known.sum(1).clamp(min=1)
        mean = (linear.double().sum(1) / n_set[:, None]).float()
        level = mean.clamp(min=SMALLEST_MEAN)[:, None]
        residual = (linear - mean[:, None]) * known[..., None]
        contrast = _contrast(residual / level, n_set)
        projection = self._project(residual, counted, mean)
        relative = projection / level
        clipped = (srgb.amax(2) >= CLIPPED_FROM).float()
        inputs = [
            linear / (linear + level),
            clipped[..., None],
            torch.log(distance_m.clamp(max=FARTHEST_M) + NEAREST_M)[..., None],
            facing[..., None],
        ]
        middle, aside, coarse = self._levels(torch.cat(inputs, 2), known, relative)
        code = self._code(coarse, relative, known)
        mean_code = code.mean(1)
        raw = self.layer("error")(torch.relu(self.layer("error_hidden")(mean_code.detach())))[:, 0]
        expected_error = nn.functional.softplus(raw) * level.mean((1, 2)) + SMALLEST_ERROR
        lamp_anchors, added_level = torch.zeros_like(known), level
        if self.architecture.opens_clipped:
            lamp_anchors = known * clipped * (distance_m < SKY_FROM_M).float()
            added_level = self._lit_level(linear, known * (1 - clipped), level)
        open_sphere = contrast * (1 - known + lamp_anchors).mean(1)
        gate = open_sphere[:, None] * torch.tanh(self.layer("gate")(mean_code)[:, GATE_OF])
        radiance = self._radiance(middle, aside, code) * contrast[:, None, None]
        to_light = self._constant("quadrature", 0, srgb.device)
        lamps = (to_light @ (radiance * self._share(lamp_anchors))) * added_level
        guessed = gate[..., None] * projection + (to_light @ (radiance * self._share(1 - known))) * added_level
        kept = (MOST_ADDED * expected_error.detach() / _size(guessed + lamps)).clamp(max=1)[:, None, None]
        guessed, lamps = guessed * kept, lamps * kept
        if not self.training:
            guessed, lamps = self._believed(guessed, lamps, expected_error, level, relative, 1 - known.mean(1))
        sh_radiance = projection + guessed + lamps
        return torch.cat([sh_radiance[:, :1].clamp(min=0), sh_radiance[:, 1:]], 1), expected_error

    def _believed(
        self, guessed: Tensor, lamps: Tensor, expected_error: Tensor, level: Tensor, relative: Tensor, unseen: Tensor
    ) -> tuple[Tensor, Tensor]:
        """What counts of both (B, 9, 3); `unseen` (B,) is a share of the sphere."""
        seen, bright = _size(relative), BRIGHT_GUESS_LDR
        if self.architecture.opens_clipped:
            bright = BRIGHT_GUESS
            lamps = lamps * _logarithmic(_size(lamps / level), BRIGHT_LAMPS * seen)
            certain = _size(guessed / level) / (DOUBT * expected_error / level.mean((1, 2)))
            guessed = guessed * (certain**4 / (certain**4 + 1))[:, None, None]
        return guessed * _logarithmic(_size(guessed / level), bright * seen * unseen**2), lamps

    def _lit_level(self, linear: Tensor, unclipped: Tensor, level: Tensor) -> Tensor:
        """(B, 1, 3) as bright as `level` (B, 1, 3), in the colour of the light that the unclipped surfaces show."""
        n_unclipped = unclipped.sum(1).clamp(min=1)[:, None]
        shade = (linear.square().square() * unclipped[..., None]).sum(1) / n_unclipped
        shade = shade.clamp(min=SMALLEST_MEAN**4).sqrt().sqrt()[:, None]
        return shade * (level.mean(2, keepdim=True) / shade.mean(2, keepdim=True))

    def _project(self, residual: Tensor, counted: Tensor, mean: Tensor) -> Tensor:
        """(B, 9, 3): `xihenet.sh.project_anchors` for a batch, its small systems in float64."""
        n, device = counted.shape[1], counted.device
        products = self._constant("products", n, device)
        gram = (counted @ products).reshape(-1, N_SH, N_SH).double() * (4 * np.pi / n)
        penalty = (1 - counted.double().mean(1)) * RESIDUAL_NOISE / L1_VARIANCE + SMALLEST_PENALTY
        identity = torch.eye(N_SH, dtype=torch.float64, device=device)
        bands = torch.diag(torch.as_tensor(SQUARED_BAND, device=device))
        normal_matrix = torch.where(counted.amax(1)[:, None, None] > 0, gram + penalty[:, None, None] * bands, identity)
        weighted = residual * counted[..., None]
        right_side = (self._constant("basis 0", n, device).T @ weighted).double() * (4 * np.pi / n)
        coefficients = torch.linalg.solve(normal_matrix, right_side).float()
        constant = mean[:, None] * float(np.sqrt(4 * np.pi))
        return torch.cat([coefficients[:, :1] + constant, coefficients[:, 1:]], 1)

    def _levels(self, inputs: Tensor, known: Tensor, relative: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Features of the middle and of the coarsest cells, and what else is known of the middle ones."""
        n = known.shape[1]
        features, weight = torch.relu(self.layer("stem")(torch.cat([inputs, self._placed(relative, 0, n)], 2))), known
        weight, levels = weight[..., None], []
        for level, name in enumerate(("fine", "middle", "coarse"), start=1):
            pooled, weight = self._pool(features, weight, level, n)
            aside = torch.cat([weight, self._placed(relative, level, n)], 2)
            features = torch.relu(self.layer(name)(torch.cat([pooled, aside], 2)))
            levels.append((features, aside))
        return levels[1][0], levels[1][1], levels[2][0]

    def _placed(self, relative: Tensor, level: int, n: int) -> Tensor:
        """(B, n, 4) squeezed radiance of the projection in the directions of a level, and their height."""
        height = self._constant(f"height {level}", n, relative.device)[:, None]
        light = _squeezed(self._constant(f"basis {level}", n, relative.device) @ relative)
        return torch.cat([light, height.expand(len(relative), -1, -1)], 2)

    def _pool(self, features: Tensor, weight: Tensor, level: int, n: int) -> tuple[Tensor, Tensor]:
        """Weighted means over what each cell of a level stands for, and its mean weight (B, n, 1)."""
        weighted = torch.cat([features * weight, weight], 2)
        if level == 1:
            members = self._constant("members", n, features.device)
            sums = nn.functional.pad(weighted, (0, 0, 0, 1))[:, members].sum(2)
            sums = sums / self._constant("counts", n, features.device)[:, None]
        else:
            sums = self._constant(f"matrix {level}", 0, features.device).T @ weighted
        return sums[..., :-1] / sums[..., -1:].clamp(min=SMALLEST_SHARE), sums[..., -1:]

    def _code(self, coarse: Tensor, relative: Tensor, known: Tensor) -> Tensor:
        """(B, 16, code): what the whole sphere says in each turn of the room."""
        narrow = torch.relu(self.layer("narrow")(coarse))[:, self._constant("turned", 0, known.device)].flatten(2)
        light = _squeezed(self._constant("turns", 0, known.device) @ relative[:, None]).flatten(2)
        seen = known.mean(1)[:, None, None].expand(-1, N_TURNS, 1)
        hidden = torch.relu(self.layer("dense")(torch.cat([narrow, light, seen], 2)))
        of_all = hidden.mean(1, keepdim=True).expand_as(hidden)
        return torch.relu(self.layer("code")(torch.cat([hidden, of_all], 2)))

    def _share(self, open_anchors: Tensor) -> Tensor:
        """(B, n, 1) of the middle cells; `open_anchors` (B, N) are shares of anchors to which light is added."""
        n, device = open_anchors.shape[1], open_anchors.device
        fine = nn.functional.pad(open_anchors, (0, 1))[:, self._constant("members", n, device)].sum(2)
        fine = fine / self._constant("counts", n, device)
        return (fine @ self._constant("matrix 2", 0, device))[..., None]

    def _radiance(self, middle: Tensor, aside: Tensor, code: Tensor) -> Tensor:
        """(B, n, 3) what the projection lacks in the middle cells, relative to channel means."""
        n = middle.shape[1]
        spread = self.layer("spread")(code).reshape(len(code), N_TURNS, n, -1)
        turned_back = self._constant("turned back", 0, code.device)[None, ..., None]
        spread = spread.gather(2, turned_back.expand(len(code), -1, -1, spread.shape[3])).mean(1)
        hidden = self.layer("decoder")(torch.cat([middle, spread, aside], 2))
        return self.layer("radiance")(torch.relu(hidden))

    def _constant(self, name: str, n: int, device: torch.device) -> Tensor:
        """A table as a tensor, kept per device; no part of the state. `n` is the number of anchors, 0 for no matter."""
        key = (name, n, device)
        if key not in self._on_device:
            self._on_device[key] = torch.tensor(_table(name, n), device=device)
        return self._on_device[key]


def _table(name: str, n: int) -> NDArray[Any]:
    """Of `LatticeNet._constant`; the number behind a name is its level."""
    kind, _, level = name.rpartition(" ")
    tables: dict[str, Callable[[], Any]] = {
        "quadrature": quadrature_matrix,
        "products": lambda: basis_products(n),
        "turns": lambda: turns_of_light().astype(np.float32),
        "turned": lambda: ring_grid(LEVELS[2]).turned,
        "turned back": lambda: ring_grid(LEVELS[1]).turned_back,
        "basis": lambda: place_tables(n)[int(level)].basis,
        "height": lambda: place_tables(n)[int(level)].height,
        "members": lambda: pooling_table(n).members,
        "counts": lambda: pooling_table(n).counts,
        "matrix": lambda: pooling_matrix(*LEVELS[int(level) - 2 : int(level)]),
    }
    return tables[name if name in tables else kind]()


def linear_from_srgb(srgb: Tensor) -> Tensor:
    """`xihenet.colour.srgb_to_linear` for colours in [0, 1]."""
    return torch.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _contrast(relative: Tensor, n_set: Tensor) -> Tensor:
    """(B,) 0 where all that was seen is alike, near 1 for any real picture."""
    variance = relative.square().sum((1, 2)) / (3 * n_set)
    return variance / (variance + CONTRAST_SCALE**2)


def _logarithmic(size: Tensor, unit: Tensor) -> Tensor:
    """(B, 1, 1) the share that counts of a light of that size (B,), by its logarithm in units (B,) of another."""
    in_units = (size / unit.clamp(min=SMALLEST_ERROR)).clamp(min=SMALLEST_ERROR)
    return (torch.log1p(in_units) / in_units)[:, None, None]


def _size(light: Tensor) -> Tensor:
    """(B,) root mean square of (B, 9, 3), not quite 0, where a root has no slope."""
    return light.square().mean((1, 2)).clamp(min=SMALLEST_ERROR**2).sqrt()


def _squeezed(values: Tensor) -> Tensor:
    return values / (values.abs() + 1)
