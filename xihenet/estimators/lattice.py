"""The default estimator: a small network on the fixed anchor lattice, in NumPy alone.

What was seen is projected to coefficients (`xihenet.sh.project_anchors`); a network looks at the anchors on ever
coarser lattices and says what radiance that projection lacks in each direction of the second, which an exact quadrature
turns into coefficients. The result is a light and not 27 loose numbers, and where nothing varies nothing is added:
constant light comes out constant, one set anchor gives its colour from everywhere, and none gives black.

`xihenet.nets.lattice` is the same network in torch, plain and for training; tests hold the two within 1e-5. What makes
this one fast: features come first and anchors last, (features, B, n), in the order in which they are pooled, so that
every step runs along contiguous memory; directions, biases and what is not set are folded into the weights
(`_Folded`); and clouds go in blocks that stay in the cache.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.estimators.ambient import Ambient
from xihenet.estimators.base import EstimateContext, Estimator, NotFinite, Target
from xihenet.estimators.calibration import Calibration
from xihenet.estimators.lattice_format import (
    N_SH,
    LatticeWeights,
    anchor_tables,
    load_weights,
    pooling_matrix,
    quadrature_matrix,
    slot_order,
)
from xihenet.estimators.weights_format import loaded_for
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, ArrayInt, UnitSphereCloud
from xihenet.sh import FACING_OFFSET, L1_VARIANCE, LEAST_WEIGHT, RESIDUAL_NOISE, SMALLEST_PENALTY

SMALLEST_MEAN = 1e-3  # Darker clouds are not brightened further: it would be noise.
CONTRAST_SCALE = 0.02  # Relative spread of the seen light at which the network is half trusted.
CLIPPED_FROM = 0.995
NEAREST_M = 0.05
FARTHEST_M = 100.0  # The test rooms end at 8 m. Unclipped, 1e38 m made a light of 16 times white.
SMALLEST_SHARE = 1e-6
SEEN_ENOUGH = 0.01  # Share of the sphere from which an estimate counts more than the ambient sensor.
SMALLEST_ERROR = 1e-4
WHITE_L00 = float(np.sqrt(4 * np.pi))  # Of light that is 1 from everywhere.
SQUARED_BAND = np.repeat(np.arange(3.0), [1, 3, 5]) ** 2

# OpenBLAS wakes its threads above 2^18 multiplications, which stalls on a busy machine.
_UNTHREADED_PRODUCT = 2**18
_CLOUDS_AT_ONCE = 8  # their features stay in the cache

# Rows of the input: relative and encoded colour, clipped or not, log distance, facing, projected light, -1 where unset.
_RELATIVE, _SRGB, _CLIPPED, _DISTANCE, _FACING, _PROJECTED, _UNSET = slice(3), slice(3, 6), 6, 7, 8, slice(9, 12), 12
_N_INPUTS = 13
_FORBIDDING = 1e30  # Weight of "not set": whatever else such an anchor says, rectified it is 0.

# The 45 products on and above the diagonal of a symmetric 9 x 9 matrix, and where each of the 81 finds its own.
_ROWS, _COLUMNS = np.triu_indices(N_SH)
_UPPER = _ROWS * N_SH + _COLUMNS
_FROM_UPPER = np.zeros((N_SH, N_SH), np.intp)
_FROM_UPPER[_ROWS, _COLUMNS] = _FROM_UPPER[_COLUMNS, _ROWS] = np.arange(len(_UPPER))
_SQUARED_BANDS = np.diag(SQUARED_BAND)


class Lattice(Estimator):
    """The lattice network with weights trained for one target; any number of anchors.

    `weights` is a file; None takes the one shipped for the target. ValueError if it is missing, broken, of another
    version, or was trained for the other target.
    """

    name = "lattice"
    farthest_m = FARTHEST_M

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr", *, weights: Path | None = None) -> None:
        super().__init__(n_anchors, target)
        loaded = loaded_for(self, weights, load_weights)
        self._network = LatticeNetwork(loaded, n_anchors)
        self._calibration = Calibration.from_figures(loaded.figures)
        self._sensor = Ambient(n_anchors, target)

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """With a frame in the context, a cloud of which next to nothing is set leans on the phone's sensor."""
        self._check_size(cloud)
        facing = None if cloud.surfaces is None else cloud.surfaces.facing[None]
        light, raw_error = self._run(cloud.srgb[None], cloud.distance_m[None], cloud.is_set[None], facing)
        coverage = cloud.is_set.mean(keepdims=True)
        if context is not None and context.frame is not None:
            light = lean_on_sensor(light, coverage, self._sensor.estimate(cloud, context)[None])
        return self._checked(light[0]), float(self._calibration.expected(raw_error, coverage)[0])

    def estimate_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> ArrayF64:
        """(B, 9, 3) of B clouds; ValueError for wrong shapes, colours, distances or facing."""
        return self.estimate_batch_with_error(srgb, distance_m, is_set, facing=facing)[0]

    def estimate_batch_with_error(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> tuple[ArrayF64, ArrayF64]:
        """As `estimate_batch`, and (B,) the SHC RMSE expected of each."""
        colours, distances, known = self._checked_batch(srgb, distance_m, is_set)
        turned = None if facing is None else self._checked_facing(facing, len(known))
        sh_radiance, expected_error = np.empty((len(known), 9, 3)), np.empty(len(known))
        for start in range(0, len(sh_radiance), _CLOUDS_AT_ONCE):
            block = slice(start, start + _CLOUDS_AT_ONCE)
            of_block = None if turned is None else turned[block]
            light, error = self._run(colours[block], distances[block], known[block], of_block)
            sh_radiance[block], expected_error[block] = light, error
        if not np.isfinite(sh_radiance).all():
            raise NotFinite("lattice: an estimate is not finite; refusing to pass it on")
        return sh_radiance, self._calibration.expected(expected_error, known.mean(axis=1))

    def _run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None
    ) -> tuple[ArrayF64, ArrayF64]:
        """What the network says, (B, 9, 3) and (B,); the mean of clipped light is no brighter than white."""
        light, raw_error = self._network.run(srgb, distance_m, is_set, facing)
        if self.target == "ldr":
            np.minimum(light[:, 0], WHITE_L00, out=light[:, 0])
        return light, raw_error

    def _checked_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike
    ) -> tuple[ArrayF32, ArrayF32, ArrayBool]:
        known = np.asarray(is_set)
        if known.dtype != bool and not np.isin(known, (0, 1)).all():
            raise ValueError(f"lattice: expected is_set to be true or false, got {known.dtype} of other values")
        colours, distances, known = self._checked_shapes(srgb, distance_m, known.astype(bool, copy=False))
        if known.size and not (colours.min() >= 0 and colours.max() <= 1):
            raise ValueError("lattice: expected colours in [0, 1], got values outside or NaN")
        if known.size and not (distances.min() >= 0 and distances.max() < np.inf):
            raise ValueError("lattice: expected finite distances >= 0, got negative, infinite or NaN")
        return colours, distances, known

    def _checked_facing(self, facing: ArrayLike, n_clouds: int) -> ArrayF32:
        turned = np.asarray(facing, np.float32)
        if turned.shape != (n_clouds, self.n_anchors) or not (np.abs(turned) <= 1).all():
            wanted = f"cosines of shape ({n_clouds}, {self.n_anchors})"
            raise ValueError(f"lattice: expected facing as {wanted}, got {turned.shape} or values outside of -1 to 1")
        return turned

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        return self.estimate_with_error(cloud, context)[0]


def lean_on_sensor(sh_radiance: ArrayF64, coverage: ArrayF64, sensed: ArrayF64) -> ArrayF64:
    """Lights (B, 9, 3) mixed with the ambient sensor's (B, 9, 3) where the coverage (B,) is next to nothing.

    A few anchors say less than the mean of the whole picture. The estimate's share is 1 - exp(-coverage / SEEN_ENOUGH):
    8 % for one anchor of 1280, 99 % from a twentieth of the sphere on. Constant light stays constant.
    """
    share = -np.expm1(-coverage / SEEN_ENOUGH)[:, None, None]
    mixed: ArrayF64 = share * sh_radiance + (1 - share) * sensed
    return mixed


class LatticeNetwork:
    """The network proper, for `n_anchors` anchors: arrays in, arrays out, nothing checked."""

    def __init__(self, weights: LatticeWeights, n_anchors: int) -> None:
        self.architecture = weights.architecture
        self.n_anchors = n_anchors
        fine, middle, coarse = self.architecture.levels
        self._to_fine, self._to_middle = slot_order(n_anchors, fine), slot_order(fine, middle)
        place_of_fine = np.argsort(self._to_fine.coarse)
        self._members_of_middle = place_of_fine[self._to_middle.fine]
        self._to_coarse = pooling_matrix(middle, coarse)[self._to_middle.coarse]
        self._coarse_counts = pooling_matrix(middle, coarse).sum(axis=0)
        self._has_repeats = len(self._to_fine.fine) > n_anchors
        orders = (self._to_fine.fine, self._to_fine.coarse, self._to_middle.coarse, np.arange(coarse))
        tables = [anchor_tables(n) for n in (n_anchors, fine, middle, coarse)]
        self._bases = [np.ascontiguousarray(t.basis[order].T) for t, order in zip(tables, orders, strict=True)]
        directions = [np.ascontiguousarray(t.directions[order].T) for t, order in zip(tables, orders, strict=True)]
        self._fine_directions = directions[1][:, None]
        self._products = tables[0].basis_products[:, _UPPER][orders[0]]
        self._quadrature = np.ascontiguousarray(quadrature_matrix(middle).T[orders[2]])
        self._channel_order = (3 * orders[0] + np.arange(3)[:, None]).reshape(-1)
        self._layers = _Folded(weights, directions, orders[2])

    def run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None = None
    ) -> tuple[ArrayF64, ArrayF64]:
        """(B, 9, 3) coefficients and (B,) expected errors of B clouds; anchors that are not set have no say."""
        known = is_set.take(self._to_fine.fine, axis=1, mode="clip").astype(np.float32)
        inputs = self._inputs(srgb, distance_m, known)
        inputs[_FACING] = 0
        if facing is not None and self.architecture.knows_facing:
            np.multiply(facing.take(self._to_fine.fine, axis=1, mode="clip"), known, out=inputs[_FACING])
        linear = _linear(inputs[_SRGB])
        counted = known * self._to_fine.is_first if self._has_repeats else known
        n_set = counted.sum(axis=1)
        # Rounded to 1e-6 of itself; what the mean lacks is in the residual, whose fit puts it back.
        mean = np.einsum("cbn,bn->cb", linear, counted) / np.maximum(n_set, 1)
        residual = (linear - mean[..., None]) * counted
        level = np.maximum(mean.mean(axis=0), np.float32(SMALLEST_MEAN))
        contrast = _contrast(residual, n_set, level)
        scale = level if self.architecture.is_exposure_normalised else np.ones_like(level)
        if facing is not None and self.architecture.knows_facing:
            counted = counted * (inputs[_FACING] + np.float32(FACING_OFFSET)).clip(np.float32(LEAST_WEIGHT), 1)
        projection = self._project(residual, counted, mean)
        np.divide(linear, linear + scale[:, None], out=inputs[_RELATIVE])
        decoder_inputs, coarse = self._levels(inputs, projection, scale)
        code = self._code(coarse, projection, n_set, level, scale)
        spread, gate, error_hidden = self._layers.from_code(code)
        lacking = self._lacking(decoder_inputs, spread) * (contrast * scale)[:, None]
        gate = 1 + contrast[:, None] * np.tanh(gate)
        sh_radiance = gate[..., None] * projection + lacking.transpose(1, 2, 0)
        np.maximum(sh_radiance[:, 0], 0, out=sh_radiance[:, 0])
        raw = self._layers.dense("error", _rectified(error_hidden))[:, 0]
        expected_error = np.logaddexp(raw, 0) * scale + SMALLEST_ERROR
        return sh_radiance.astype(np.float64), expected_error.astype(np.float64)

    def _inputs(self, srgb: ArrayF32, distance_m: ArrayF32, known: ArrayF32) -> ArrayF32:
        """(rows, B, n) what the first layer sees, but for the relative colour and the projected light."""
        n_clouds, n = known.shape
        inputs = np.empty((_N_INPUTS, n_clouds, n), np.float32)
        channels = srgb.reshape(n_clouds, -1).take(self._channel_order, axis=1, mode="clip")
        colours = np.multiply(channels.reshape(n_clouds, 3, n).transpose(1, 0, 2), known, out=inputs[_SRGB])
        brightest = np.maximum(colours[0], colours[1])
        np.maximum(brightest, colours[2], out=brightest)
        inputs[_CLIPPED] = brightest >= CLIPPED_FROM
        distances = distance_m.take(self._to_fine.fine, axis=1, mode="clip")
        np.minimum(distances, np.float32(FARTHEST_M), out=distances)
        distances += np.float32(NEAREST_M)
        np.log(distances, out=inputs[_DISTANCE])
        np.subtract(known, 1, out=inputs[_UNSET])
        return inputs

    def _project(self, residual: ArrayF32, counted: ArrayF32, mean: ArrayF32) -> ArrayF32:
        """(B, 9, 3): `xihenet.sh.project_anchors` for a batch, its small systems in float64."""
        n_clouds, per_anchor = len(counted), np.float64(4 * np.pi / self.n_anchors)
        n_set = counted.sum(axis=1)
        gram = _product(counted, self._products).take(_FROM_UPPER, axis=1) * per_anchor
        penalty = (1 - n_set / np.float64(self.n_anchors)) * RESIDUAL_NOISE / L1_VARIANCE + SMALLEST_PENALTY
        normal_matrix = gram + penalty[:, None, None] * _SQUARED_BANDS
        normal_matrix[n_set == 0] = np.eye(N_SH)
        moments = _product((residual * counted).reshape(3 * n_clouds, -1), self._bases[0].T)
        moments = moments.reshape(3, n_clouds, N_SH)
        # By eigenvectors: solve() wakes BLAS threads whatever the size.
        values, vectors = np.linalg.eigh(normal_matrix)
        rotated = np.matmul(vectors.transpose(0, 2, 1), moments.transpose(1, 2, 0) * per_anchor) / values[..., None]
        coefficients = np.matmul(vectors, rotated)
        coefficients[:, 0] += mean.T * np.sqrt(4 * np.pi)
        result: ArrayF32 = coefficients.astype(np.float32)
        return result

    def _levels(self, inputs: ArrayF32, projection: ArrayF32, scale: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """(rows, B, n) what the decoder sees but for what the code gives, and the features of the coarsest lattice."""
        by_channel = np.ascontiguousarray(projection.transpose(2, 0, 1)).reshape(-1, N_SH)
        self._put_projected(inputs[_PROJECTED], 0, by_channel, scale)
        weighted = self._fine_level(self._layers.placed("stem", inputs), by_channel, scale)
        sums = self._to_middle.sums(weighted.take(self._members_of_middle, axis=1, mode="clip"), 1).transpose(2, 0, 1)
        pooled = self._pooled(2, sums, self._to_middle.counts, by_channel, scale)
        middle = self._layers.placed("middle", pooled)
        aside = pooled[-4:]
        sums = np.concatenate([middle * aside[0], aside[:1]]) @ self._to_coarse
        coarse = self._layers.placed("coarse", self._pooled(3, sums, self._coarse_counts, by_channel, scale))
        return np.concatenate([middle, aside]), coarse

    def _fine_level(self, stem: ArrayF32, by_channel: ArrayF32, scale: ArrayF32) -> ArrayF32:
        """(B, n, features + 1) of the first level, times the share of members that is set, and that share.

        A rectifier lets a factor through, so all its inputs are multiplied by the share instead of divided by it.
        """
        sums = self._to_fine.sums(stem, 2)
        n_sums, n_clouds, n = sums.shape
        inputs = np.empty((n_sums + 7, n_clouds, n), np.float32)
        np.divide(sums, self._to_fine.counts, out=inputs[:n_sums])
        share = inputs[n_sums - 1]
        np.multiply(share, share, out=inputs[n_sums])
        projected = inputs[n_sums + 1 : n_sums + 4]
        self._put_projected(projected, 1, by_channel, scale)
        projected *= share
        np.multiply(self._fine_directions, share, out=inputs[n_sums + 4 :])
        rows = inputs.reshape(len(inputs), -1).T
        return _rectified(_product(rows, self._layers.fine)).reshape(n_clouds, n, -1)

    def _pooled(self, level: int, sums: ArrayF32, counts: ArrayF32, by_channel: ArrayF32, scale: ArrayF32) -> ArrayF32:
        """(features + 4, B, n): weighted means, 0 without weight, the share that was seen, and the projected light."""
        pooled = np.empty((len(sums) + 3, *sums.shape[1:]), np.float32)
        np.divide(sums[:-1], np.maximum(sums[-1], np.float32(SMALLEST_SHARE)), out=pooled[:-4])
        np.divide(sums[-1], counts, out=pooled[-4])
        self._put_projected(pooled[-3:], level, by_channel, scale)
        return pooled

    def _put_projected(self, out: ArrayF32, level: int, by_channel: ArrayF32, scale: ArrayF32) -> None:
        """(3, B, n) the projection's radiance in the anchors' directions, squeezed into -1 to 1."""
        light = _product(by_channel, self._bases[level]).reshape(out.shape)
        size = np.abs(light)
        size += scale[:, None]
        np.divide(light, size, out=out)

    def _code(
        self, coarse: ArrayF32, projection: ArrayF32, n_set: ArrayF32, level: ArrayF32, scale: ArrayF32
    ) -> ArrayF32:
        """(B, code): what the whole sphere says."""
        n_clouds = len(projection)
        narrow = self._layers.placed("narrow", coarse).transpose(1, 0, 2).reshape(n_clouds, -1)
        light = (projection / (np.abs(projection) + scale[:, None, None])).reshape(n_clouds, -1)
        coverage = n_set / np.float32(self.n_anchors)
        brightness = np.log(level) / 3
        everything = np.concatenate([narrow, light, coverage[:, None], brightness[:, None]], axis=1)
        return _rectified(self._layers.dense("code", _rectified(self._layers.dense("dense", everything))))

    def _lacking(self, decoder_inputs: ArrayF32, spread: ArrayF32) -> ArrayF32:
        """(3, B, 9) coefficients of what the projection lacks, relative to the scale."""
        _, n_clouds, n = decoder_inputs.shape
        by_feature = spread.reshape(n_clouds, -1, n).transpose(1, 0, 2)
        hidden = self._layers.placed("decoder", np.concatenate([decoder_inputs, by_feature]))
        radiance = _product(self._layers.radiance, hidden.reshape(len(hidden), -1)).reshape(3 * n_clouds, n)
        lacking = _product(radiance, self._quadrature).reshape(3, n_clouds, N_SH)
        lacking += self._layers.radiance_constant
        return lacking


class _Folded:
    """The weights as `LatticeNetwork` multiplies them: directions and biases a constant per anchor, orders its own."""

    def __init__(self, weights: LatticeWeights, directions: list[ArrayF32], middle_order: ArrayInt) -> None:
        sizes, self._arrays = weights.architecture, weights.arrays
        self._placed: dict[str, tuple[ArrayF32, ArrayF32]] = {}
        for name, level in (("stem", 0), ("middle", 2), ("coarse", 3), ("decoder", 2)):
            matrix, bias = self._layer(name)
            constant = matrix[:, -3:] @ directions[level] + bias[:, None]
            self._placed[name] = np.ascontiguousarray(matrix[:, :-3]), constant[:, None]
        matrix, constant = self._placed["stem"]
        if not sizes.knows_facing:
            matrix = np.insert(matrix, _FACING, 0, axis=1)
        # One more input, -1 where not set, silences the anchor; one more output says whether it is set.
        matrix = np.block([[matrix, np.full((len(matrix), 1), _FORBIDDING)], [np.eye(1, _N_INPUTS, _UNSET)]])
        constant = np.concatenate([constant, np.ones_like(constant[:1])])
        self._placed["stem"] = matrix.astype(np.float32), constant
        matrix, constant = self._placed["decoder"]
        # The inputs that the code gives come last here.
        columns = np.r_[: sizes.middle, sizes.middle + sizes.spread : matrix.shape[1]]
        given = slice(sizes.middle, sizes.middle + sizes.spread)
        self._placed["decoder"] = np.concatenate([matrix[:, columns], matrix[:, given]], axis=1), constant
        matrix, bias = self._layer("narrow")
        self._placed["narrow"] = matrix, bias[:, None, None]
        self.fine = self._fine()
        self._dense = {name: self._transposed(name) for name in ("code", "error")}
        matrix, bias = self._layer("dense")
        split = sizes.levels[2] * sizes.narrow
        narrow = matrix[:, :split].reshape(len(matrix), sizes.levels[2], sizes.narrow).transpose(0, 2, 1)
        together = np.concatenate([narrow.reshape(len(matrix), -1), matrix[:, split:]], axis=1)
        self._dense["dense"] = np.ascontiguousarray(together.T), bias
        self._from_code(sizes.levels[1], sizes.spread, middle_order)
        self.radiance, bias = self._layer("radiance")
        self.radiance_constant = bias[:, None, None] * quadrature_matrix(sizes.levels[1]).sum(axis=1)

    def _layer(self, name: str) -> tuple[ArrayF32, ArrayF32]:
        return self._arrays[f"{name}.weight"], self._arrays[f"{name}.bias"]

    def _transposed(self, name: str) -> tuple[ArrayF32, ArrayF32]:
        matrix, bias = self._layer(name)
        return np.ascontiguousarray(matrix.T), bias

    def _fine(self) -> ArrayF32:
        """(inputs, outputs + 1): the bias is the weight of the share, and one more output gives the share back."""
        matrix, bias = self._layer("fine")
        n_pooled = matrix.shape[1] - 7
        outputs = np.concatenate([matrix[:, :n_pooled].T, bias[None], matrix[:, n_pooled:].T])
        return np.concatenate([outputs, np.eye(1, len(outputs), n_pooled, dtype=np.float32).T], axis=1)

    def _from_code(self, n: int, n_spread: int, middle_order: ArrayInt) -> None:
        """The three layers that read the code as one, `spread` ordered by feature and then by anchor."""
        matrix, bias = self._layer("spread")
        order = (middle_order * n_spread + np.arange(n_spread)[:, None]).reshape(-1)
        layers = [(matrix[order], bias[order]), self._layer("gate"), self._layer("error_hidden")]
        matrices, biases = zip(*layers, strict=True)
        self._dense["from_code"] = np.ascontiguousarray(np.concatenate(matrices).T), np.concatenate(biases)
        self._ends = (n * n_spread, n * n_spread + N_SH)

    def dense(self, name: str, rows: ArrayF32) -> ArrayF32:
        """(B, outputs), not rectified."""
        matrix, bias = self._dense[name]
        product = _product(rows, matrix)
        product += bias
        return product

    def from_code(self, code: ArrayF32) -> tuple[ArrayF32, ArrayF32, ArrayF32]:
        """Outputs of `spread`, `gate` and `error_hidden`, not rectified."""
        together, (first, second) = self.dense("from_code", code), self._ends
        return together[:, :first], together[:, first:second], together[:, second:]

    def placed(self, name: str, inputs: ArrayF32) -> ArrayF32:
        """(outputs, B, n), rectified, of (inputs, B, n)."""
        matrix, constant = self._placed[name]
        product = _product(matrix, inputs.reshape(len(inputs), -1)).reshape(len(matrix), *inputs.shape[1:])
        product += constant
        return _rectified(product)


def _linear(srgb: ArrayF32) -> ArrayF32:
    """`xihenet.colour.srgb_to_linear` for float32 in [0, 1], within 1e-6 of it and in a third of its time."""
    linear = srgb + np.float32(0.055)
    linear *= np.float32(1 / 1.055)
    np.log(linear, out=linear)
    linear *= np.float32(2.4)
    np.exp(linear, out=linear)
    np.copyto(linear, srgb * np.float32(1 / 12.92), where=srgb <= np.float32(0.04045))
    return linear


def _contrast(residual: ArrayF32, n_set: ArrayF32, level: ArrayF32) -> ArrayF32:
    """(B,) 0 where all that was seen is alike, near 1 for any real picture."""
    variance = np.einsum("cbn,cbn->b", residual, residual) / (level**2 * 3 * np.maximum(n_set, 1))
    result: ArrayF32 = variance / (variance + np.float32(CONTRAST_SCALE**2))
    return result


def _rectified(values: ArrayF32) -> ArrayF32:
    return np.maximum(values, 0, out=values)


def _product(a: ArrayF32, b: ArrayF32) -> NDArray[Any]:
    """a @ b in blocks of its longer side that BLAS computes without waking its threads."""
    n_rows, n_columns = len(a), b.shape[1]
    step = max(1, _UNTHREADED_PRODUCT // (a.shape[1] * min(n_rows, n_columns)))
    product = np.empty((n_rows, n_columns), np.float32)
    for start in range(0, max(n_rows, n_columns), step):
        block = slice(start, start + step)
        if n_rows > n_columns:
            np.matmul(a[block], b, out=product[block])
        else:
            np.matmul(a, b[:, block], out=product[:, block])
    return product
