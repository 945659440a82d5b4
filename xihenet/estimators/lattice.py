"""The default estimator: a small network on the fixed anchor lattice.

`xihenet.estimators.lattice_network` is the network and explains it. Here are its checks, its batches, the error that it
promises, and what a cloud with next to nothing in it leans on.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from xihenet.estimators.ambient import Ambient
from xihenet.estimators.base import EstimateContext, Estimator, NotFinite, Target
from xihenet.estimators.calibration import Calibration, raw_error
from xihenet.estimators.lattice_format import load_weights
from xihenet.estimators.lattice_network import FARTHEST_M, LatticeNetwork
from xihenet.estimators.weights_format import loaded_for
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, UnitSphereCloud

SEEN_ENOUGH = 0.01  # Share of the sphere from which an estimate counts more than the ambient sensor.
WHITE_L00 = float(np.sqrt(4 * np.pi))  # Of light that is 1 from everywhere.
FAINTEST = 1e-3  # Of the brightest channel: one that is fainter says nothing of the others' shape, nor they of its.
_CLOUDS_AT_ONCE = 8  # their features stay in the cache


class Lattice(Estimator):
    """The lattice network with weights trained for one target; any number of anchors.

    `weights` is a file; None takes the one shipped for the target. ValueError if it is missing, broken, of another
    version, or was trained for the other target.
    """

    name = "lattice"
    is_quick = True
    farthest_m = FARTHEST_M

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr", *, weights: Path | None = None) -> None:
        super().__init__(n_anchors, target)
        loaded = loaded_for(self, weights, load_weights)
        self._network: _Runs = LatticeNetwork(loaded, n_anchors)
        self._calibration = Calibration.from_figures(loaded.figures)
        self._sensor = Ambient(n_anchors, target)

    def use_network(self, network: _Runs) -> None:
        """Ask this network of the same weights from now on, one that runs elsewhere."""
        self._network = network

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """With a frame in the context, a cloud of which next to nothing is set leans on the phone's sensor."""
        self._check_size(cloud)
        facing = None if cloud.surfaces is None else np.nan_to_num(cloud.surfaces.facing[None])
        light, raw = self._run(cloud.srgb[None], cloud.distance_m[None], cloud.is_set[None], facing)
        coverage = cloud.is_set.mean(keepdims=True)
        if context is not None and context.frame is not None:
            light = lean_on_sensor(light, coverage, self.sensed(cloud, context)[None])
        return self._checked(light[0]), float(self._calibration.expected(raw, coverage)[0])

    def sensed(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        """(9, 3) that a cloud of which next to nothing is set leans on: the phone's sensor, or the anchors' mean."""
        return self._sensor.estimate(cloud, context)

    def estimate_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> ArrayF64:
        """(B, 9, 3) of B clouds, within 1e-5 of single estimates: float32 rounds sums of other sizes otherwise.

        ValueError for wrong shapes, colours, distances or facing.
        """
        return self.estimate_batch_with_error(srgb, distance_m, is_set, facing=facing)[0]

    def estimate_batch_with_error(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> tuple[ArrayF64, ArrayF64]:
        """As `estimate_batch`, and (B,) the SHC RMSE expected of each."""
        colours, distances, known = self._checked_batch(srgb, distance_m, is_set)
        turned = None if facing is None else self._checked_facing(facing, len(known))
        sh_radiance, raw = np.empty((len(known), 9, 3)), np.empty(len(known))
        for start in range(0, len(sh_radiance), _CLOUDS_AT_ONCE):
            block = slice(start, start + _CLOUDS_AT_ONCE)
            of_block = None if turned is None else turned[block]
            sh_radiance[block], raw[block] = self._run(colours[block], distances[block], known[block], of_block)
        if not np.isfinite(sh_radiance).all():
            raise NotFinite("lattice: an estimate is not finite; refusing to pass it on")
        return sh_radiance, self._calibration.expected(raw, known.mean(axis=1))

    def _run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None
    ) -> tuple[ArrayF64, ArrayF64]:
        """Lights (B, 9, 3) and raw errors (B,)."""
        light, network_error = self._network.run(srgb, distance_m, is_set, facing)
        light = given_light(light, is_set.mean(axis=1), self.target)
        return light, raw_error(network_error, light)

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


def given_light(sh_radiance: ArrayF64, coverage: ArrayF64, target: Target) -> ArrayF64:
    """Lights (B, 9, 3) that the estimator gives for its network's, from clouds of coverage (B,).

    The mean of clipped light is no brighter than white; for all of the light see `of_one_shape`.
    """
    if target == "hdr":
        return of_one_shape(sh_radiance, coverage)
    bounded: ArrayF64 = sh_radiance.copy()
    np.minimum(bounded[:, 0], WHITE_L00, out=bounded[:, 0])
    return bounded


def of_one_shape(sh_radiance: ArrayF64, coverage: ArrayF64) -> ArrayF64:
    """Lights (B, 9, 3) with channels as much of one shape as nobody saw their surroundings, of coverage (B,).

    What nobody saw is guessed for each channel, and wrong for each by chance: what they have in common is more certain.
    So 1 - coverage of the shape, a channel's coefficients over its first, is the mean of the three. The mean light and
    its colour stay; a turned or tinted light becomes the turned or tinted one; grey light stays as it is, and light
    from all around that was seen. So does a light with a channel that is not positive or below FAINTEST of another.
    """
    mean, share = sh_radiance[:, :1], (1 - coverage)[:, None, None]
    is_clear = (mean > FAINTEST * mean.max(axis=2, keepdims=True)) & (mean > np.finfo(np.float32).tiny)
    shape = sh_radiance / np.where(is_clear, mean, 1.0)
    mixed = mean * ((1 - share) * shape + share * shape.mean(axis=2, keepdims=True))
    return np.where(is_clear.all(axis=2, keepdims=True), mixed, sh_radiance)


def lean_on_sensor(sh_radiance: ArrayF64, coverage: ArrayF64, sensed: ArrayF64) -> ArrayF64:
    """Lights (B, 9, 3) mixed with the ambient sensor's (B, 9, 3) where the coverage (B,) is next to nothing.

    A few anchors say less than the mean of the whole picture. The estimate's share is 1 - exp(-coverage / SEEN_ENOUGH):
    8 % for one anchor of 1280, 99 % from a twentieth of the sphere on. Constant light stays constant.
    """
    share = -np.expm1(-coverage / SEEN_ENOUGH)[:, None, None]
    return share * sh_radiance + (1 - share) * sensed


class _Runs(Protocol):
    """What the estimator asks of its network, see `LatticeNetwork`."""

    def run(
        self, srgb: ArrayF32, distance_m: ArrayF32, is_set: ArrayBool, facing: ArrayF32 | None = None
    ) -> tuple[ArrayF64, ArrayF64]: ...
