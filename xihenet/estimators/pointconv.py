"""The paper's network as an estimator: `xihenet` on unit-sphere samples, `pointar` on uniformly drawn points.

Both run one and the same PointConv network, each with weights of its own; only what they are given differs. Estimating
takes NumPy (`pointconv_network`), training torch (`xihenet.nets.pointconv`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from xihenet.codec import MAX_DISTANCE_M
from xihenet.estimators.base import EstimateContext, Estimator, Target
from xihenet.estimators.pointconv_network import PointConvNetwork, load_pointconv_weights
from xihenet.estimators.weights_format import loaded_for
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, UnitSphereCloud
from xihenet.sampling import checked_position, has_usable_points, sample_uniform
from xihenet.sphere import AnchorLattice

DRAWING_SEED = 0


class _GivesLight(Protocol):
    """What the estimators ask of their network, see `PointConvNetwork`."""

    def light(self, points_m: ArrayF32, srgb: ArrayF32) -> ArrayF32: ...


class _PointConv(Estimator):
    """What the two share: weights are found, checked and put into the network.

    `weights` is a file; None takes the one shipped for the target. ValueError if it is missing, broken, of another
    version, or was trained for another estimator or target.
    """

    farthest_m = MAX_DISTANCE_M  # as training stores points, in float16

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr", *, weights: Path | None = None) -> None:
        super().__init__(n_anchors, target)
        loaded = loaded_for(self, weights, lambda path: load_pointconv_weights(path, self.name))
        self._n_points_trained_with = loaded.n_points
        self._keeps_unset_at_origin = loaded.architecture.keeps_unset_at_origin
        self._network: _GivesLight = PointConvNetwork(loaded)

    def use_network(self, network: _GivesLight) -> None:
        """Ask this network of the same weights from now on, one that runs elsewhere."""
        self._network = network

    def _light(self, points_m: ArrayF32, srgb: ArrayF32, is_set: ArrayBool) -> ArrayF64:
        """(9, 3) from points (N, 3) relative to the position, their colours, and which of them there are."""
        if self._keeps_unset_at_origin:
            points_m, srgb = points_m * is_set[:, None], srgb * is_set[:, None]
        else:
            points_m, srgb = points_m[is_set], srgb[is_set]
        return self._network.light(points_m, srgb).astype(np.float64)


class XiheNet(_PointConv):
    """The set anchors as points in the directions and at the distances at which they were seen."""

    name = "xihenet"

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        directions = AnchorLattice(self.n_anchors).directions.astype(np.float32)
        points = directions * np.minimum(cloud.distance_m, np.float32(MAX_DISTANCE_M))[:, None]
        return self._light(points, cloud.srgb, cloud.is_set)


class PointAR(_PointConv):
    """Points drawn from the raw points of the moment, each equally likely, as many as the network was trained with.

    Takes nothing from the cloud of anchors. The drawing has a fixed seed: the same points give the same light.
    """

    name = "pointar"
    needs = frozenset({"points"})

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """Anchors of earlier frames do not help: the points are those of the moment."""
        points = context.points
        return "no_points" if points is not None and not has_usable_points(points) else ""

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        if context.points is None or context.position_m is None:
            raise ValueError("pointar: needs the raw points; give EstimateContext(points=..., position_m=...)")
        position = checked_position(context.position_m)
        n_points = self._n_points_trained_with or self.n_anchors
        drawn = sample_uniform(context.points, n_points, np.random.default_rng(DRAWING_SEED))
        # A position beyond float32's range, or a point, is as good as one at the farthest distance.
        relative = np.clip(drawn.points_m - position, -MAX_DISTANCE_M, MAX_DISTANCE_M).astype(np.float32)
        return self._light(relative, drawn.srgb.clip(0, 1), np.ones(len(relative), bool))
