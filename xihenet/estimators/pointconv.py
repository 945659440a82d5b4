"""The paper's network as an estimator: `xihenet` on unit-sphere samples, `pointar` on uniformly drawn points.

Both run one and the same PointConv network, each with weights of its own; only what they are given differs. Estimating
takes NumPy (`pointconv_network`), training torch (`xihenet.nets.pointconv`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from xihenet.estimators.base import EstimateContext, Estimator, NotFinite, Target
from xihenet.estimators.pointconv_network import PointConvNetwork, known_points
from xihenet.estimators.weights_format import WEIGHTS_FOLDER, NetworkWeights, read_weights
from xihenet.records import ArrayBool, ArrayF32, ArrayF64, UnitSphereCloud
from xihenet.sampling import has_usable_points, sample_uniform
from xihenet.sphere import AnchorLattice

FARTHEST_M = 65504.0  # As training stores them, in float16.
DRAWING_SEED = 0


@dataclass(frozen=True)
class PointConvArchitecture:
    """Sizes of the network; the defaults are the paper's and make 1,511,021 parameters.

    Parameters
    ----------
    centroids : points kept by the first and by the second block
    n_neighbours : points around each centroid
    n_weights : outputs of the function that makes weights from relative positions
    bandwidth : of the density's Gaussian, relative to the cloud's mean distance
    keeps_unset_at_origin : unset anchors enter as black points at the origin, as in the reference
    is_bfloat16_in_training : matrix products in bfloat16 while it trains, where the processor has them; never after
    """

    centroids: tuple[int, int] = (128, 32)
    n_neighbours: int = 32
    n_weights: int = 16
    bandwidth: float = 0.1
    keeps_unset_at_origin: bool = False
    is_bfloat16_in_training: bool = False

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


class _PointConv(Estimator):
    """What the two share: weights are found, checked and put into the network.

    Parameters
    ----------
    n_anchors, target : as for every estimator
    weights : file of weights; None takes the one shipped for the target

    Raises
    ------
    ValueError : if the file is missing, broken, of another version, or was trained for another estimator or target
    """

    farthest_m = FARTHEST_M

    def __init__(self, n_anchors: int = 1280, target: Target = "ldr", *, weights: Path | None = None) -> None:
        super().__init__(n_anchors, target)
        path = WEIGHTS_FOLDER / f"{self.name}_{target}.npz" if weights is None else weights
        loaded = load_pointconv_weights(path, self.name)
        if loaded.target != target:
            raise ValueError(f"{path}: expected weights for the target {target!r}, got {loaded.target!r}")
        self._n_points_trained_with = loaded.n_points
        sizes = loaded.architecture
        self._keeps_unset_at_origin = sizes.keeps_unset_at_origin
        self._network = PointConvNetwork(loaded.arrays, sizes.centroids, sizes.n_neighbours, sizes.bandwidth)

    def _light(self, points_m: ArrayF32, srgb: ArrayF32, is_set: ArrayBool) -> ArrayF64:
        """(9, 3) from points (N, 3) relative to the position, their colours, and which of them there are."""
        known = known_points(points_m, srgb, is_set, self._keeps_unset_at_origin)
        sh_radiance = self._network.light(*known).astype(np.float64)
        if not np.isfinite(sh_radiance).all():
            raise NotFinite(f"{self.name}: an estimate is not finite; refusing to pass it on")
        return sh_radiance


class XiheNet(_PointConv):
    """The set anchors as points in the directions and at the distances at which they were seen."""

    name = "xihenet"

    def estimate_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> ArrayF64:
        """(B, 9, 3) of B clouds, one after the other; ValueError for shapes or values that do not fit.

        What stands at anchors that are not set does not matter, and `facing` is not asked.
        """
        known = np.asarray(is_set, bool)
        n_clouds = len(known) if known.ndim else 0
        colours, distances = np.asarray(srgb, np.float32), np.asarray(distance_m, np.float32)
        expected = n_clouds, self.n_anchors
        if known.shape != expected or distances.shape != expected or colours.shape != (*expected, 3):
            shapes = f"{colours.shape}, {distances.shape} and {known.shape}"
            raise ValueError(f"{self.name}: expected (B, n, 3), (B, n), (B, n) with n = {self.n_anchors}, got {shapes}")
        colours, distances = np.where(known[..., None], colours, 0), np.where(known, distances, 0)
        UnitSphereCloud(colours.reshape(-1, 3), distances.ravel(), known.ravel())  # refuses values out of range
        light = [self._light(*cloud) for cloud in zip(self._points(distances), colours, known, strict=True)]
        return np.array(light).reshape(-1, 9, 3)

    def _points(self, distance_m: ArrayF32) -> ArrayF32:
        """(..., N, 3) metres, relative to the position."""
        directions = AnchorLattice(self.n_anchors).directions.astype(np.float32)
        points: ArrayF32 = directions * np.minimum(distance_m, np.float32(FARTHEST_M))[..., None]
        return points

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        return self._light(self._points(cloud.distance_m), cloud.srgb, cloud.is_set)


class PointAR(_PointConv):
    """Points drawn from the raw points of the moment, each equally likely, as many as the network was trained with.

    Takes nothing from the cloud of anchors. The drawing has a fixed seed: the same points give the same light.
    """

    name = "pointar"
    needs = frozenset({"points"})

    def estimate_batch(
        self, srgb: ArrayLike, distance_m: ArrayLike, is_set: ArrayLike, *, facing: ArrayLike | None = None
    ) -> ArrayF64:
        """ValueError: clouds of anchors no longer hold the raw points."""
        raise ValueError(
            "pointar: draws from the raw points, which clouds of anchors no longer hold; "
            "call estimate with EstimateContext(points=..., position_m=...) for each"
        )

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """Anchors of earlier frames do not help: the points are those of the moment."""
        points = context.points
        return "no_points" if points is not None and not has_usable_points(points) else ""

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        if context.points is None or context.position_m is None:
            raise ValueError("pointar: needs the raw points; give EstimateContext(points=..., position_m=...)")
        position = np.asarray(context.position_m, np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise ValueError(f"pointar: expected a position of three finite numbers, got {context.position_m!r}")
        n_points = self._n_points_trained_with or self.n_anchors
        drawn = sample_uniform(context.points, n_points, np.random.default_rng(DRAWING_SEED))
        # A position beyond float32's range, or a point, is as good as one at the farthest distance.
        relative = np.clip(drawn.points_m - position, -FARTHEST_M, FARTHEST_M).astype(np.float32)
        return self._light(relative, drawn.srgb.clip(0, 1), np.ones(len(relative), bool))


def load_pointconv_weights(path: Path, estimator: str) -> PointConvWeights:
    """Read and check the PointConv weights of `estimator`; ValueError naming the file, and what to do if it is missing.

    See `xihenet.estimators.weights_format.read_weights`.
    """
    if not path.exists():
        raise ValueError(
            f"{path}: expected {estimator} weights, found no file: those for ldr are shipped; "
            "choose another estimator, or train the network and export it with `xihe train` and `xihe train export`"
        )
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
