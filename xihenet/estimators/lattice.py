"""The default estimator: a small network on the fixed anchor lattice, in NumPy alone.

What was seen is projected to coefficients (`xihenet.sh.project_anchors`); a network looks at the anchors on ever
coarser lattices and says what radiance that projection lacks in each of 80 directions, which an exact quadrature turns
into coefficients. The result is a light and not 27 loose numbers, and where nothing varies nothing is added: constant
light comes out constant, one set anchor gives its colour from everywhere, and none gives black.

`xihenet.nets.lattice` is the same network in torch, for training; tests hold the two within 1e-5. Directions never
change, so what they add to each layer is computed once per number of anchors.
"""

from __future__ import annotations

import itertools
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.colour import srgb_to_linear
from xihenet.estimators.base import EstimateContext, Estimator, Target
from xihenet.estimators.lattice_format import LatticeWeights, load_weights
from xihenet.estimators.lattice_tables import N_SH, PoolingTable, anchor_tables, pooling_table, quadrature_matrix
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, UnitSphereCloud
from xihenet.sh import L1_VARIANCE, RESIDUAL_NOISE, SMALLEST_PENALTY

WEIGHTS_FOLDER = Path(__file__).resolve().parents[1] / "weights"

SMALLEST_MEAN = 1e-3  # Darker clouds are not brightened further: it would be noise.
CONTRAST_SCALE = 0.02  # Relative spread of the seen light at which the network is half trusted.
CLIPPED_FROM = 0.995
NEAREST_M = 0.05
SMALLEST_SHARE = 1e-6
SMALLEST_ERROR = 1e-4
N_DIRECTION_FEATURES = 3
SQUARED_BAND = np.repeat(np.arange(3.0), [1, 3, 5]) ** 2

# OpenBLAS wakes its threads above 2^18 multiplications, which stalls on a busy machine.
_UNTHREADED_PRODUCT = 2**18
_CLOUDS_AT_ONCE = 8  # their features stay in the cache


class _Level(NamedTuple):
    """Features (B, n, F) of one lattice, the share of each anchor's surroundings that was seen (B, n, 1), and light."""

    features: ArrayF32
    share: ArrayF32
    projected: ArrayF32


class Lattice(Estimator):
    """The lattice network with weights trained for one target; any number of anchors.

    Parameters
    ----------
    n_anchors, target : as for every estimator
    weights : file of weights; None takes the one shipped for the target

    Raises
    ------
    ValueError : if the file is missing, broken, of another version, or was trained for the other target
    """

    name = "lattice"

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr", *, weights: Path | None = None) -> None:
        super().__init__(n_anchors, target)
        path = WEIGHTS_FOLDER / f"lattice_{target}.npz" if weights is None else weights
        loaded = load_weights(path)
        if loaded.target != target:
            raise ValueError(f"{path}: expected weights for the target {target!r}, got {loaded.target!r}")
        self._network = LatticeNetwork(loaded, n_anchors)

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """As `estimate`, and the SHC RMSE that the network expects of it."""
        self._check_size(cloud)
        sh_radiance, expected_error = self._network.run(cloud.srgb[None], cloud.distance_m[None], cloud.is_set[None])
        return self._checked(sh_radiance[0]), float(expected_error[0])

    def estimate_batch(self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike) -> ArrayF64:
        """(B, 9, 3) of B clouds; ValueError for shapes that do not fit and for colours or distances out of range."""
        return self.estimate_batch_with_error(srgb, distance_m, is_set)[0]

    def estimate_batch_with_error(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike
    ) -> tuple[ArrayF64, ArrayF64]:
        """As `estimate_batch`, and (B,) the SHC RMSE expected of each."""
        colours, distances, known = self._checked_batch(srgb, distance_m, is_set)
        sh_radiance, expected_error = np.empty((len(known), 9, 3)), np.empty(len(known))
        for start in range(0, len(sh_radiance), _CLOUDS_AT_ONCE):
            block = slice(start, start + _CLOUDS_AT_ONCE)
            light, error = self._network.run(colours[block], distances[block], known[block])
            sh_radiance[block], expected_error[block] = light, error
        if not np.isfinite(sh_radiance).all():
            raise ValueError("lattice: an estimate is not finite; refusing to pass it on")
        return sh_radiance, expected_error

    def _checked_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike
    ) -> tuple[ArrayF32, ArrayF32, ArrayBool]:
        colours, distances = np.asarray(srgb, np.float32), np.asarray(distance_m, np.float32)
        known = np.asarray(is_set, bool)
        expected = (len(known), self.n_anchors) if known.ndim else (0, self.n_anchors)
        if known.shape != expected or distances.shape != expected or colours.shape != (*expected, 3):
            shapes = f"{colours.shape}, {distances.shape} and {known.shape}"
            raise ValueError(f"lattice: expected (B, n, 3), (B, n), (B, n) with n = {self.n_anchors}, got {shapes}")
        if known.size and not (colours.min() >= 0 and colours.max() <= 1):
            raise ValueError("lattice: expected colours in [0, 1], got values outside or NaN")
        if known.size and not (distances.min() >= 0 and distances.max() < np.inf):
            raise ValueError("lattice: expected finite distances >= 0, got negative, infinite or NaN")
        return colours * known[..., None], distances * known, known

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        return self.estimate_with_error(cloud, context)[0]


class LatticeNetwork:
    """The network proper, for `n_anchors` anchors: arrays in, arrays out, nothing checked."""

    def __init__(self, weights: LatticeWeights, n_anchors: int) -> None:
        self.architecture = weights.architecture
        self.n_anchors = n_anchors
        self._matrices = {
            name.removesuffix(".weight"): np.ascontiguousarray(array.T)
            for name, array in weights.arrays.items()
            if name.endswith(".weight")
        }
        self._biases = {
            name.removesuffix(".bias"): array for name, array in weights.arrays.items() if name.endswith(".bias")
        }
        self._tables = [anchor_tables(n) for n in (n_anchors, *self.architecture.levels)]

    @cached_property
    def _pooling(self) -> list[PoolingTable]:
        sizes = (self.n_anchors, *self.architecture.levels)
        return [pooling_table(fine, coarse) for fine, coarse in itertools.pairwise(sizes)]

    @cached_property
    def _of_directions(self) -> dict[str, ArrayF32]:
        """What a layer's last inputs, the directions, and its bias add: (n, outputs)."""
        tables = dict(zip(("stem", "fine", "middle", "coarse"), self._tables, strict=True))
        tables["decoder"] = tables["middle"]
        return {
            name: table.directions @ self._matrices[name][-N_DIRECTION_FEATURES:] + self._biases[name]
            for name, table in tables.items()
        }

    def run(self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool) -> tuple[ArrayF64, ArrayF64]:
        """(B, 9, 3) coefficients and (B,) expected errors of B clouds, 0 wherever an anchor is not set."""
        known = is_set.astype(np.float32)
        linear = srgb_to_linear(srgb)
        n_set = np.maximum(known.sum(axis=1), 1)
        mean, residual = _mean_and_residual(linear, known, n_set)
        level = np.maximum(mean.mean(axis=1), np.float32(SMALLEST_MEAN))
        contrast = _contrast(residual, n_set, level)
        scale = level if self.architecture.is_exposure_normalised else np.ones_like(level)
        projection = self._project(residual, known, mean)
        levels = self._levels(srgb, linear, distance_m, known, projection, scale)
        code = self._code(levels[2], projection, known, level, scale)
        radiance = self._radiance(levels[1], code) * contrast[:, None, None]
        gate = 1 + contrast[:, None] * np.tanh(self._dense("gate", code))
        quadrature = quadrature_matrix(self.architecture.levels[1])
        sh_radiance = gate[..., None] * projection + np.matmul(quadrature, radiance) * scale[:, None, None]
        np.maximum(sh_radiance[:, 0], 0, out=sh_radiance[:, 0])
        return sh_radiance.astype(np.float64), self._expected_error(code, scale)

    def _project(self, residual: ArrayF32, known: ArrayF32, mean: ArrayF32) -> ArrayF32:
        """(B, 9, 3): `xihenet.sh.project_anchors` for a batch, its small systems in float64."""
        table = self._tables[0]
        per_anchor = 4 * np.pi / self.n_anchors
        gram = np.matmul((table.basis * known[..., None]).transpose(0, 2, 1), table.basis) * per_anchor
        penalty = (1 - known.mean(axis=1, dtype=np.float64)) * RESIDUAL_NOISE / L1_VARIANCE + SMALLEST_PENALTY
        normal_matrix = gram + penalty[:, None, None] * np.diag(SQUARED_BAND)
        normal_matrix[known.max(axis=1) == 0] = np.eye(N_SH)
        right_side = np.matmul(table.basis.T, residual) * per_anchor
        # By eigenvectors: solve() wakes BLAS threads whatever the size.
        values, vectors = np.linalg.eigh(normal_matrix)
        rotated = np.matmul(vectors.transpose(0, 2, 1), right_side) / values[..., None]
        coefficients = np.matmul(vectors, rotated)
        coefficients[:, 0] += mean * np.sqrt(4 * np.pi)
        result: ArrayF32 = coefficients.astype(np.float32)
        return result

    def _levels(
        self, srgb: ArrayF32, linear: ArrayF32, distance_m: ArrayF32, known: ArrayF32, projection: ArrayF32,
        scale: ArrayF32,
    ) -> list[_Level]:  # fmt: skip
        """The three coarser lattices, from fine to coarse."""
        by_scale = scale[:, None, None]
        inputs = np.concatenate(
            [
                linear / (linear + by_scale),
                srgb,
                _is_clipped(srgb)[..., None],
                np.log(distance_m + np.float32(NEAREST_M))[..., None],
                self._projected(0, projection, by_scale),
            ],
            axis=2,
        )
        features, weight = self._placed("stem", inputs), known[..., None]
        levels = []
        for i, name in enumerate(("fine", "middle", "coarse"), start=1):
            pooled, share = _pool(features, weight, self._pooling[i - 1])
            projected = self._projected(i, projection, by_scale)
            features = self._placed(name, np.concatenate([pooled, share, projected], axis=2))
            weight = share
            levels.append(_Level(features, share, projected))
        return levels

    def _projected(self, level: int, projection: ArrayF32, by_scale: ArrayF32) -> ArrayF32:
        """(B, n, 3) the projection's radiance in the anchors' directions, squeezed into -1 to 1."""
        light: ArrayF32 = np.matmul(self._tables[level].basis, projection)
        light /= np.abs(light) + by_scale
        return light

    def _code(
        self, coarsest: _Level, projection: ArrayF32, known: ArrayF32, level: ArrayF32, scale: ArrayF32
    ) -> ArrayF32:
        """(B, code): what the whole sphere says."""
        n_clouds = len(known)
        narrow = _rectified(self._dense("narrow", coarsest.features)).reshape(n_clouds, -1)
        light = (projection / (np.abs(projection) + scale[:, None, None])).reshape(n_clouds, -1)
        coverage = known.mean(axis=1, keepdims=True)
        brightness = np.log(level)[:, None] / 3
        everything = np.concatenate([narrow, light, coverage, brightness], axis=1)
        return _rectified(self._dense("code", _rectified(self._dense("dense", everything))))

    def _radiance(self, middle: _Level, code: ArrayF32) -> ArrayF32:
        """(B, n, 3) what the projection lacks in the directions of the middle lattice, relative to the scale."""
        spread = self._dense("spread", code).reshape(*middle.features.shape[:2], -1)
        inputs = np.concatenate([middle.features, spread, middle.share, middle.projected], axis=2)
        return self._dense("radiance", self._placed("decoder", inputs))

    def _expected_error(self, code: ArrayF32, scale: ArrayF32) -> ArrayF64:
        raw = self._dense("error", _rectified(self._dense("error_hidden", code)))[:, 0]
        expected: ArrayF64 = (np.logaddexp(raw, 0) * scale + SMALLEST_ERROR).astype(np.float64)
        return expected

    def _dense(self, name: str, inputs: ArrayF32) -> ArrayF32:
        product = _blocked_product(inputs.reshape(-1, inputs.shape[-1]), self._matrices[name])
        product += self._biases[name]
        return product.reshape(*inputs.shape[:-1], -1)

    def _placed(self, name: str, inputs: ArrayF32) -> ArrayF32:
        """A layer whose last inputs are the anchors' directions, rectified."""
        matrix = self._matrices[name][:-N_DIRECTION_FEATURES]
        product = _blocked_product(inputs.reshape(-1, inputs.shape[-1]), matrix).reshape(*inputs.shape[:2], -1)
        product += self._of_directions[name]
        return _rectified(product)


def _mean_and_residual(linear: ArrayF32, known: ArrayF32, n_set: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
    """(B, 3) mean over the set anchors and (B, N, 3) what is over, 0 where unset.

    The mean is rounded to 1e-6 of itself; what it lacks is in the residual, whose fit puts it back.
    """
    mean = np.matmul(known[:, None], linear)[:, 0] / n_set[:, None]
    return mean, (linear - mean[:, None]) * known[..., None]


def _is_clipped(srgb: ArrayF32) -> ArrayF32:
    """(B, N) 1 where any channel is at the end of its range."""
    clipped = (srgb[..., 0] >= CLIPPED_FROM) | (srgb[..., 1] >= CLIPPED_FROM) | (srgb[..., 2] >= CLIPPED_FROM)
    return clipped.astype(np.float32)


def _contrast(residual: ArrayF32, n_set: ArrayF32, level: ArrayF32) -> ArrayF32:
    """(B,) 0 where all that was seen is alike, near 1 for any real picture."""
    relative = residual / level[:, None, None]
    variance = np.einsum("bnc,bnc->b", relative, relative) / (3 * n_set)
    result: ArrayF32 = variance / (variance + np.float32(CONTRAST_SCALE**2))
    return result


def _pool(features: ArrayF32, weight: ArrayF32, table: PoolingTable) -> tuple[ArrayF32, ArrayF32]:
    """Weighted means over each coarse anchor's members, 0 without weight, and their mean weight (B, n, 1)."""
    n_clouds, n_fine, n_features = features.shape
    padded = np.empty((n_clouds, n_fine + 1, n_features + 1), np.float32)
    np.multiply(features, weight, out=padded[:, :n_fine, :n_features])
    padded[:, :n_fine, n_features:] = weight
    padded[:, n_fine] = 0
    sums = padded.take(table.members[:, 0], axis=1)
    for slot in table.members.T[1:]:
        sums += padded.take(slot, axis=1)
    total = sums[..., n_features:]
    return sums[..., :n_features] / np.maximum(total, np.float32(SMALLEST_SHARE)), total / table.counts[:, None]


def _rectified(values: ArrayF32) -> ArrayF32:
    return np.maximum(values, 0, out=values)


def _blocked_product(rows: ArrayF32, matrix: ArrayF32) -> NDArray[Any]:
    """rows @ matrix in blocks that BLAS computes without waking its threads."""
    product = np.empty((len(rows), matrix.shape[1]), np.float32)
    step = max(1, _UNTHREADED_PRODUCT // matrix.size)
    for start in range(0, len(rows), step):
        np.matmul(rows[start : start + step], matrix, out=product[start : start + step])
    return product
