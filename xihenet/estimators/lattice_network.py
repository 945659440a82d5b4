"""The network of the default estimator, on the fixed anchor lattice, in NumPy alone.

What was seen is projected to coefficients (`xihenet.sh.project_anchors`); a network looks at the anchors on ever
coarser grids and says what radiance that projection lacks in each cell of the second, which an exact quadrature turns
into coefficients. The result is a light and not 27 loose numbers. Where all was seen, or nothing varies, nothing is
added: constant light comes out constant, one set anchor gives its colour from everywhere, and none gives black. What is
added is no larger than twice the error that the network expects of itself.

It is added where nothing was seen and, in all of the light, where anchors are clipped (`opens_clipped`) and have a
distance. The sky in a window has none; taken for a lamp, it made rooms in daylight too bright. A clipped lamp is white
in the picture; what surfaces that are not clipped show of it has its colour. So what is added has that, by shades of
grey: the mean of their fourth powers (Finlayson and Trezzi, Shades of Gray and Colour Constancy, 2004), by which the
brightest count most.

How bright a lamp is can hardly be read off a clipped picture, nor whether there is one where nobody looked, and too
bright a guess costs more than too dark a one. So what is guessed of the unseen counts the less the further it exceeds
what was seen, and that the sooner the less is unseen (`BRIGHT_GUESS`): a few holes do not hold most of the light. In
all of the light, lamps that were seen count likewise (`BRIGHT_LAMPS`), and a guess counts only where the network is
sure enough of it: by half where it is `DOUBT` times the error that the network expects, and soon not at all below that.

What must not matter does not, by construction. Each channel is taken relative to its own mean, so that exposure and
white balance act on the light as on the pictures, unless something is clipped. The layers that see the whole sphere see
it turned by eighths about the vertical, and mirrored, with the same weights (`xihenet.estimators.ring_grid`).

`xihenet.nets.lattice` is the same network in torch, plain and for training; tests hold the two within 1e-5. What makes
this one fast: features come first and anchors last, (features, B, n), in the order in which they are pooled, so that
every step runs along contiguous memory; directions, biases and what is not set are folded into the weights
(`_Folded`); and clouds go in blocks that stay in the cache.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.colour import CLIPPED_FROM
from xihenet.estimators.lattice_format import (
    GATE_OF,
    LEVELS,
    N_GATES,
    N_LEVEL_FEATURES,
    N_SH,
    LatticeWeights,
    basis_products,
    place_tables,
    pooling_matrix,
    quadrature_matrix,
    slot_order,
)
from xihenet.estimators.ring_grid import N_TURNS, ring_grid, turns_of_light
from xihenet.records import FAR_M, ArrayBool, ArrayF32, ArrayF64
from xihenet.sh import FACING_OFFSET, L1_VARIANCE, LEAST_WEIGHT, RESIDUAL_NOISE, SMALLEST_PENALTY

SMALLEST_MEAN = 1e-3  # Darker clouds are not brightened further: it would be noise.
CONTRAST_SCALE = 0.02  # Relative spread of the seen light at which the network is half trusted.
NEAREST_M = 0.05
FARTHEST_M = 100.0  # The test rooms end at 8 m. Unclipped, 1e38 m made a light of 16 times white.
SKY_FROM_M = 0.75 * FAR_M  # Light without a distance, also if it has been carried some way.
SMALLEST_SHARE = 1e-6
SMALLEST_ERROR = 1e-4
MOST_ADDED = 2.0  # Times its raw expected error, the most that the network adds to the projection, root mean square.
# A light x counts as log(1 + x), where the unit of x is so many times the projection; for guesses it is that many times
# the square of the unseen share of the sphere, more in clipped light, whose guesses are smaller.
BRIGHT_LAMPS, BRIGHT_GUESS, BRIGHT_GUESS_LDR = 4.0, 20.0, 60.0
DOUBT = 0.3
SQUARED_BAND = np.repeat(np.arange(3.0), [1, 3, 5]) ** 2

# OpenBLAS wakes its threads above 2^18 multiplications, which stalls on a busy machine.
_UNTHREADED_PRODUCT = 2**18

# Rows of the input: relative colour, clipped or not, log distance, facing, projected light, -1 where not set.
_RELATIVE, _CLIPPED, _DISTANCE, _FACING, _PROJECTED, _UNSET = slice(3), 3, 4, 5, slice(6, 9), 9
_N_INPUTS = 10
_FORBIDDING = 1e30  # Weight of "not set": whatever else such an anchor says, rectified it is 0.

# The 45 products on and above the diagonal of a symmetric 9 x 9 matrix, and where each of the 81 finds its own.
_ROWS, _COLUMNS = np.triu_indices(N_SH)
_UPPER = _ROWS * N_SH + _COLUMNS
_FROM_UPPER = np.zeros((N_SH, N_SH), np.intp)
_FROM_UPPER[_ROWS, _COLUMNS] = _FROM_UPPER[_COLUMNS, _ROWS] = np.arange(len(_UPPER))
_SQUARED_BANDS = np.diag(SQUARED_BAND)


class LatticeNetwork:
    """The network proper, for `n_anchors` anchors: arrays in, arrays out, nothing checked."""

    def __init__(self, weights: LatticeWeights, n_anchors: int) -> None:
        self.n_anchors = n_anchors
        self._to_fine = slot_order(n_anchors)
        self._to_middle = pooling_matrix(*LEVELS[:2])[self._to_fine.cells]
        self._to_coarse = pooling_matrix(*LEVELS[1:])
        self._turned, self._turned_back = ring_grid(LEVELS[2]).turned, ring_grid(LEVELS[1]).turned_back
        self._has_repeats = len(self._to_fine.anchors) > n_anchors
        orders = (self._to_fine.anchors, self._to_fine.cells, np.arange(LEVELS[1]), np.arange(LEVELS[2]))
        tables = place_tables(n_anchors)
        self._bases = [np.ascontiguousarray(t.basis[order].T) for t, order in zip(tables, orders, strict=True)]
        heights = [t.height[order] for t, order in zip(tables, orders, strict=True)]
        self._fine_height = heights[1]
        self._products = basis_products(n_anchors)[:, _UPPER][orders[0]]
        self._quadrature = np.ascontiguousarray(quadrature_matrix().T)
        self._turns = turns_of_light().astype(np.float32)
        self._channel_order = (3 * orders[0] + np.arange(3)[:, None]).reshape(-1)
        self._opens_clipped = weights.architecture.opens_clipped
        self._layers = _Folded(weights, heights)

    def run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None = None
    ) -> tuple[ArrayF64, ArrayF64]:
        """(B, 9, 3) coefficients and (B,) expected errors of B clouds; anchors that are not set have no say."""
        known = is_set.take(self._to_fine.anchors, axis=1, mode="clip").astype(np.float32)
        inputs, colours = self._inputs(srgb, distance_m, known)
        linear = _linear(colours)
        counted = known * self._to_fine.is_first if self._has_repeats else known
        counted_once, n_set = counted, counted.sum(axis=1)
        # Rounded to 1e-6 of itself; what the mean lacks is in the residual, whose fit puts it back.
        mean = np.einsum("cbn,bn->cb", linear, counted) / np.maximum(n_set, 1)
        residual = (linear - mean[..., None]) * counted
        level = np.maximum(mean, np.float32(SMALLEST_MEAN))
        contrast = _contrast(residual, n_set, level)
        inputs[_FACING] = 0
        if facing is not None:
            np.multiply(facing.take(self._to_fine.anchors, axis=1, mode="clip"), known, out=inputs[_FACING])
            counted = counted * (inputs[_FACING] + np.float32(FACING_OFFSET)).clip(np.float32(LEAST_WEIGHT), 1)
        projection = self._project(residual, counted, mean)
        np.divide(linear, linear + level[..., None], out=inputs[_RELATIVE])
        relative = projection / level.T[:, None]
        decoder_inputs, coarse = self._levels(inputs, relative)
        code = self._code(coarse, relative, n_set)
        gate, error_hidden = self._layers.from_mean_code(code.mean(axis=1))
        raw = self._layers.dense("error", _rectified(error_hidden))[:, 0]
        expected_error = np.logaddexp(raw, 0) * level.mean(axis=0) + SMALLEST_ERROR
        unseen = 1 - counted_once.sum(axis=1) / np.float32(self.n_anchors)
        radiance = self._radiance(decoder_inputs, self._spread(code)) * contrast[:, None]
        guessed, added_level, open_sphere = self._light_of(radiance, 1 - decoder_inputs[-4]), level, unseen
        lamps = np.zeros_like(guessed)
        if self._opens_clipped:
            lamp_cells, lamp_sphere = self._lamps(inputs, known, counted_once)
            added_level = _lit_level(linear, counted_once * (1 - inputs[_CLIPPED]), level)
            lamps = self._light_of(radiance, lamp_cells) * added_level.T[:, None]
            open_sphere = unseen + lamp_sphere
        guessed *= added_level.T[:, None]
        guessed += ((open_sphere * contrast)[:, None] * np.tanh(gate[:, GATE_OF]))[..., None] * projection
        size = _size(guessed + lamps)
        kept = np.minimum(1, MOST_ADDED * expected_error / np.maximum(size, SMALLEST_ERROR))[:, None, None]
        doubt = DOUBT * expected_error / level.mean(axis=0)
        sh_radiance = projection + self._believed(guessed * kept, lamps * kept, level, doubt, _size(relative), unseen)
        np.maximum(sh_radiance[:, 0], 0, out=sh_radiance[:, 0])
        return sh_radiance.astype(np.float64), expected_error.astype(np.float64)

    def _inputs(self, srgb: ArrayF32, distance_m: ArrayF32, known: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """(rows, B, n) of the first layer, without colour, facing and projected light, and the colours (3, B, n)."""
        n_clouds, n = known.shape
        inputs = np.empty((_N_INPUTS, n_clouds, n), np.float32)
        channels = srgb.reshape(n_clouds, -1).take(self._channel_order, axis=1, mode="clip")
        colours = channels.reshape(n_clouds, 3, n).transpose(1, 0, 2) * known
        brightest = np.maximum(colours[0], colours[1])
        np.maximum(brightest, colours[2], out=brightest)
        inputs[_CLIPPED] = brightest >= CLIPPED_FROM
        distances = distance_m.take(self._to_fine.anchors, axis=1, mode="clip")
        np.minimum(distances, np.float32(FARTHEST_M), out=distances)
        distances += np.float32(NEAREST_M)
        np.log(distances, out=inputs[_DISTANCE])
        np.subtract(known, 1, out=inputs[_UNSET])
        return inputs, colours

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
        return coefficients.astype(np.float32)

    def _levels(self, inputs: ArrayF32, relative: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """(rows, B, n) what the decoder sees but for what the code gives, and the features of the coarsest cells."""
        by_channel = np.ascontiguousarray(relative.transpose(2, 0, 1)).reshape(-1, N_SH)
        self._put_projected(inputs[_PROJECTED], 0, by_channel)
        weighted = self._fine_level(self._layers.placed("stem", inputs), by_channel)
        pooled = self._pooled(2, weighted, self._to_middle, by_channel)
        middle = self._layers.placed("middle", pooled)
        aside = pooled[-4:]
        weighted = np.concatenate([middle * aside[0], aside[:1]])
        coarse = self._layers.placed("coarse", self._pooled(3, weighted, self._to_coarse, by_channel))
        return np.concatenate([middle, aside]), coarse

    def _fine_level(self, stem: ArrayF32, by_channel: ArrayF32) -> ArrayF32:
        """(features + 1, B, n) of the first level, times the share of members that is set, and that share.

        A rectifier lets a factor through, so all its inputs are multiplied by the share instead of divided by it.
        """
        sums = self._to_fine.sums(stem)
        n_sums, n_clouds, n = sums.shape
        inputs = np.empty((n_sums + 5, n_clouds, n), np.float32)
        np.divide(sums, self._to_fine.counts, out=inputs[:n_sums])
        share = inputs[n_sums - 1]
        np.multiply(share, share, out=inputs[n_sums])
        projected = inputs[n_sums + 1 : n_sums + 4]
        self._put_projected(projected, 1, by_channel)
        projected *= share
        np.multiply(self._fine_height, share, out=inputs[n_sums + 4])
        return _rectified(_product(self._layers.fine, inputs.reshape(len(inputs), -1))).reshape(-1, n_clouds, n)

    def _pooled(self, level: int, weighted: ArrayF32, matrix: ArrayF32, by_channel: ArrayF32) -> ArrayF32:
        """(features + 4, B, n): weighted means, 0 without weight, the share that was seen, and the projected light."""
        sums = _product(weighted.reshape(-1, len(matrix)), matrix).reshape(*weighted.shape[:2], -1)
        pooled = np.empty((len(sums) + 3, *sums.shape[1:]), np.float32)
        np.divide(sums[:-1], np.maximum(sums[-1], np.float32(SMALLEST_SHARE)), out=pooled[:-4])
        pooled[-4] = sums[-1]
        self._put_projected(pooled[-3:], level, by_channel)
        return pooled

    def _put_projected(self, out: ArrayF32, level: int, by_channel: ArrayF32) -> None:
        """(3, B, n) the projection's relative radiance in the directions of a level, squeezed into -1 to 1."""
        _squeeze(_product(by_channel, self._bases[level]).reshape(out.shape), out)

    def _code(self, coarse: ArrayF32, relative: ArrayF32, n_set: ArrayF32) -> ArrayF32:
        """(B, 16, code): what the whole sphere says in each turn of the room."""
        n_clouds = len(relative)
        narrow = self._layers.placed("narrow", coarse).take(self._turned, axis=2)
        light = self._turns @ relative[:, None]
        seen = np.broadcast_to((n_set / np.float32(self.n_anchors))[:, None, None], (n_clouds, N_TURNS, 1))
        parts = (narrow.transpose(1, 2, 0, 3), _squeeze(light, light))
        everything = np.concatenate([*(part.reshape(n_clouds, N_TURNS, -1) for part in parts), seen], axis=2)
        hidden = _rectified(self._layers.dense("dense", everything.reshape(n_clouds * N_TURNS, -1)))
        hidden = hidden.reshape(n_clouds, N_TURNS, -1)
        of_all = np.broadcast_to(hidden.mean(axis=1, keepdims=True), hidden.shape)
        both = np.concatenate([hidden, of_all], axis=2).reshape(n_clouds * N_TURNS, -1)
        return _rectified(self._layers.dense("code", both)).reshape(n_clouds, N_TURNS, -1)

    def _spread(self, code: ArrayF32) -> ArrayF32:
        """(features, B, n) that the code gives to the middle cells: the mean of what it says in each turn."""
        n_clouds = len(code)
        spread = self._layers.dense("spread", code.reshape(n_clouds * N_TURNS, -1))
        by_cell = spread.reshape(n_clouds, N_TURNS, LEVELS[1], -1)
        turned_back = by_cell[:, np.arange(N_TURNS)[:, None], self._turned_back]
        return np.ascontiguousarray(turned_back.mean(axis=1).transpose(2, 0, 1))

    def _lamps(self, inputs: ArrayF32, known: ArrayF32, counted: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """The share of clipped anchors with a distance, (B, n) of the middle cells and (B,) of the sphere."""
        lamps = inputs[_CLIPPED] * (inputs[_DISTANCE] < np.float32(np.log(SKY_FROM_M + NEAREST_M)))
        cells = _product(self._to_fine.sums(known * lamps) / self._to_fine.counts, self._to_middle)
        return cells, (counted * lamps).sum(axis=1) / np.float32(self.n_anchors)

    def _believed(
        self, guessed: ArrayF32, lamps: ArrayF32, level: ArrayF32, doubt: ArrayF32, seen: ArrayF32, unseen: ArrayF32
    ) -> ArrayF32:
        """(B, 9, 3) what counts of both; `doubt` and `seen` (B,) are sizes, `unseen` (B,) is a share of the sphere.

        Sizes are relative to the means of the channels, on which white balance acts.
        """
        relative_to, bright = level.T[:, None], BRIGHT_GUESS_LDR
        if self._opens_clipped:
            bright = BRIGHT_GUESS
            lamps = lamps * _logarithmic(_size(lamps / relative_to), BRIGHT_LAMPS * seen)[:, None, None]
            certain = _size(guessed / relative_to) / doubt
            guessed = guessed * (certain**4 / (certain**4 + 1))[:, None, None]
        counted = _logarithmic(_size(guessed / relative_to), bright * seen * unseen**2)
        return guessed * counted[:, None, None] + lamps

    def _radiance(self, decoder_inputs: ArrayF32, spread: ArrayF32) -> ArrayF32:
        """(3, B, n) that the projection lacks in the middle cells, relative to each channel's mean."""
        return self._layers.radiance(self._layers.placed("decoder", np.concatenate([decoder_inputs, spread])))

    def _light_of(self, radiance: ArrayF32, share: ArrayF32) -> ArrayF32:
        """(B, 9, 3) coefficients of the radiance (3, B, n) in shares (B, n) of the middle cells."""
        n_clouds, n = share.shape
        coefficients = _product((radiance * share).reshape(3 * n_clouds, n), self._quadrature)
        return coefficients.reshape(3, n_clouds, N_SH).transpose(1, 2, 0)


class _Folded:
    """The weights as `LatticeNetwork` multiplies them: heights and biases a constant per place, orders its own."""

    def __init__(self, weights: LatticeWeights, heights: list[ArrayF32]) -> None:
        sizes, self._arrays = weights.architecture, weights.arrays
        self._placed: dict[str, tuple[ArrayF32, ArrayF32]] = {}
        for name, level in (("stem", 0), ("middle", 2), ("coarse", 3), ("decoder", 2)):
            matrix, bias = self._layer(name)
            constant = matrix[:, -1:] * heights[level] + bias[:, None]
            self._placed[name] = np.ascontiguousarray(matrix[:, :-1]), constant[:, None]
        matrix, constant = self._placed["stem"]
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
        self._dense = {name: self._transposed(name) for name in ("code", "spread", "error")}
        matrix, bias = self._layer("dense")
        split = LEVELS[2] * sizes.narrow
        # By feature and then by cell, as `_code` has them.
        narrow = matrix[:, :split].reshape(len(matrix), LEVELS[2], sizes.narrow).transpose(0, 2, 1)
        together = np.concatenate([narrow.reshape(len(matrix), -1), matrix[:, split:]], axis=1)
        self._dense["dense"] = np.ascontiguousarray(together.T), bias
        matrices, biases = zip(self._layer("gate"), self._layer("error_hidden"), strict=True)
        self._dense["from_mean_code"] = np.ascontiguousarray(np.concatenate(matrices).T), np.concatenate(biases)
        matrix, bias = self._layer("radiance")
        self._placed["radiance"] = matrix, bias[:, None, None]

    def _layer(self, name: str) -> tuple[ArrayF32, ArrayF32]:
        return self._arrays[f"{name}.weight"], self._arrays[f"{name}.bias"]

    def _transposed(self, name: str) -> tuple[ArrayF32, ArrayF32]:
        matrix, bias = self._layer(name)
        return np.ascontiguousarray(matrix.T), bias

    def _fine(self) -> ArrayF32:
        """(outputs + 1, inputs): the bias is the weight of the share, and one more output gives the share back."""
        matrix, bias = self._layer("fine")
        n_pooled = matrix.shape[1] - N_LEVEL_FEATURES
        outputs = np.concatenate([matrix[:, :n_pooled], bias[:, None], matrix[:, n_pooled:]], axis=1)
        return np.concatenate([outputs, np.eye(1, outputs.shape[1], n_pooled, dtype=np.float32)])

    def dense(self, name: str, rows: ArrayF32) -> ArrayF32:
        """(B, outputs), not rectified."""
        matrix, bias = self._dense[name]
        product = _product(rows, matrix)
        product += bias
        return product

    def from_mean_code(self, code: ArrayF32) -> tuple[ArrayF32, ArrayF32]:
        """Outputs of `gate` and `error_hidden`, not rectified."""
        together = self.dense("from_mean_code", code)
        return together[:, :N_GATES], together[:, N_GATES:]

    def placed(self, name: str, inputs: ArrayF32) -> ArrayF32:
        """(outputs, B, n), rectified, of (inputs, B, n)."""
        return _rectified(self._linear(name, inputs))

    def radiance(self, hidden: ArrayF32) -> ArrayF32:
        """(3, B, n), of (decoder, B, n)."""
        return self._linear("radiance", hidden)

    def _linear(self, name: str, inputs: ArrayF32) -> ArrayF32:
        matrix, constant = self._placed[name]
        product = _product(matrix, inputs.reshape(len(inputs), -1)).reshape(len(matrix), *inputs.shape[1:])
        product += constant
        return product


def _linear(srgb: ArrayF32) -> ArrayF32:
    """`xihenet.colour.srgb_to_linear` for float32 in [0, 1], within 1e-6 of it and in a third of its time."""
    linear = srgb + np.float32(0.055)
    linear *= np.float32(1 / 1.055)
    np.log(linear, out=linear)
    linear *= np.float32(2.4)
    np.exp(linear, out=linear)
    np.copyto(linear, srgb * np.float32(1 / 12.92), where=srgb <= np.float32(0.04045))
    return linear


def _size(light: ArrayF32) -> ArrayF32:
    """(B,) root mean square of (B, 9, 3)."""
    return np.sqrt(np.mean(np.square(light), axis=(1, 2)))


def _logarithmic(size: ArrayF32, unit: ArrayF32) -> ArrayF32:
    """(B,) the share that counts of a light of that size, by its logarithm in units (B,) of another."""
    in_units = np.maximum(size / np.maximum(unit, SMALLEST_ERROR), SMALLEST_ERROR)
    return np.log1p(in_units) / in_units


def _lit_level(linear: ArrayF32, unclipped: ArrayF32, level: ArrayF32) -> ArrayF32:
    """(3, B) as bright as `level` (3, B), in the colour of the light that the `unclipped` (B, n) surfaces show.

    `linear` (3, B, n); grey where all of them are black, or there are none.
    """
    squared = np.square(linear)
    shade = np.einsum("cbn,bn->cb", np.square(squared, out=squared), unclipped) / np.maximum(unclipped.sum(axis=1), 1)
    shade = np.sqrt(np.sqrt(np.maximum(shade, np.float32(SMALLEST_MEAN**4))))
    return shade * (level.mean(axis=0) / shade.mean(axis=0))


def _contrast(residual: ArrayF32, n_set: ArrayF32, level: ArrayF32) -> ArrayF32:
    """(B,) 0 where all that was seen is alike, near 1 for any real picture."""
    variance = (np.einsum("cbn,cbn->cb", residual, residual) / level**2).sum(axis=0) / (3 * np.maximum(n_set, 1))
    return variance / (variance + np.float32(CONTRAST_SCALE**2))


def _squeeze(values: ArrayF32, out: ArrayF32) -> ArrayF32:
    """values / (|values| + 1): any size within -1 to 1."""
    size = np.abs(values)
    size += 1
    return np.divide(values, size, out=out)


def _rectified(values: ArrayF32) -> ArrayF32:
    return np.maximum(values, 0, out=values)


def _product(a: ArrayF32, b: ArrayF32) -> NDArray[Any]:
    """a @ b in blocks of its longer side that BLAS computes without waking its threads."""
    n_rows, n_columns = len(a), b.shape[1]
    if n_rows == 1:  # BLAS takes one row for a vector, for which threads wake above 9216 multiplications.
        return _product(a.repeat(2, axis=0), b)[:1]
    step = max(1, _UNTHREADED_PRODUCT // (a.shape[1] * min(n_rows, n_columns)))
    product = np.empty((n_rows, n_columns), np.float32)
    for start in range(0, max(n_rows, n_columns), step):
        block = slice(start, start + step)
        if n_rows > n_columns:
            np.matmul(a[block], b, out=product[block])
        else:
            np.matmul(a, b[:, block], out=product[:, block])
    return product
