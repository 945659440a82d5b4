"""Baselines, predictors without a network; those that are fitted are fitted on the same rooms as the networks.

The mean light of the training rooms, whose error is what all others are divided by; what a phone's sensor gives, as it
is and with a scale and an offset; the projection, as it is and with a regularised linear fit of its coefficients and
the share not seen, which is a serious baseline: on real data such a fit comes close to the paper's network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xihenet.codec import facing_of_codes
from xihenet.estimators.ambient import constant_light
from xihenet.estimators.base import Target
from xihenet.records import AnchorSurfaces, ArrayF32, ArrayF64, UnitSphereCloud
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice
from xihenet.training.dataset import CloudSet

RIDGE = 3.0
"""Penalty of the linear fits in clouds: that many clouds' worth of belief in the mean."""

MEAN = "mean predictor"
AMBIENT = "ambient"
AMBIENT_FITTED = "ambient, fitted"
PROJECTION = "projection"
PROJECTION_FITTED = "projection, linear fit"
BASELINES = (MEAN, AMBIENT, AMBIENT_FITTED, PROJECTION, PROJECTION_FITTED)


@dataclass(frozen=True, eq=False)
class Baselines:
    """Fitted to `n_clouds` training clouds of `n_rooms`; `lights` predicts.

    `mean_light` (9, 3) is that of the training clouds of one view; `ambient_fit` is (4, 27), `projection_fit` (56, 27),
    see `fit_linear`.
    """

    target: Target
    mean_light: ArrayF64
    ambient_fit: ArrayF64
    projection_fit: ArrayF64
    n_clouds: int
    n_rooms: int

    def lights(self, clouds: CloudSet) -> dict[str, ArrayF64]:
        """(M, 9, 3) by the names in `BASELINES`; clouds must be sampled on the sphere."""
        projection = projected(clouds)
        features = _projection_features(projection, clouds)
        return {
            MEAN: np.broadcast_to(self.mean_light, projection.shape),
            AMBIENT: _sensed_lights(clouds.ambient, self.target),
            AMBIENT_FITTED: apply_linear(self.ambient_fit, clouds.ambient),
            PROJECTION: projection,
            PROJECTION_FITTED: apply_linear(self.projection_fit, features),
        }


def fit_baselines(clouds: CloudSet, target: Target) -> Baselines:
    """Fit all to training clouds of one view and merged ones. ValueError if there are none of one view."""
    truth, is_single = clouds.truth(target), clouds.n_views == 1
    if not is_single.any():
        raise ValueError("baselines: expected training clouds of one view, got none; more rooms are needed")
    return Baselines(
        target,
        truth[is_single].mean(axis=0, dtype=np.float64),
        fit_linear(clouds.ambient.astype(np.float64), truth),
        fit_linear(_projection_features(projected(clouds), clouds), truth),
        len(clouds),
        len(np.unique(clouds.room)),
    )


def projected(clouds: CloudSet) -> ArrayF64:
    """(M, 9, 3) what `projection` says of every cloud, by how its surfaces face where that is known."""
    n_anchors, lights = clouds.is_set.shape[1], []
    lattice, unasked_m = AnchorLattice(n_anchors), np.zeros(n_anchors, np.float32)
    for srgb_u8, is_set, facing_i8 in zip(clouds.srgb_u8, clouds.is_set, clouds.facing_i8, strict=True):
        surfaces = AnchorSurfaces.of_facing(facing_of_codes(facing_i8)) if facing_i8.any() else None
        cloud = UnitSphereCloud(srgb_u8 / np.float32(255), unasked_m, is_set, surfaces=surfaces)
        lights.append(project_anchors(cloud, lattice))
    return np.array(lights).reshape(-1, 9, 3)


def _sensed_lights(ambient: ArrayF32, target: Target) -> ArrayF64:
    """(M, 9, 3) what `ambient` says of what sensors measured, (M, 3)."""
    radiance = np.minimum(ambient, 1.0 if target == "ldr" else np.inf).astype(np.float64)
    return np.array([constant_light(one) for one in radiance]).reshape(-1, 9, 3)


def fit_linear(features: ArrayF64, truth: NDArray[Any]) -> ArrayF64:
    """(F + 1, 27) ridge regression from features (M, F) to coefficients (M, 9, 3), the offset unpenalised and last."""
    means, answers = features.mean(axis=0), truth.reshape(len(truth), -1).astype(np.float64)
    spread = features.std(axis=0) + 1e-9
    centred = (features - means) / spread
    gram = centred.T @ centred + RIDGE * np.eye(len(means))
    slopes = np.linalg.solve(gram, centred.T @ (answers - answers.mean(axis=0))) / spread[:, None]
    return np.vstack([slopes, answers.mean(axis=0) - means @ slopes])


def apply_linear(fit: ArrayF64, features: NDArray[Any]) -> ArrayF64:
    """(M, 9, 3) what a fit says of features (M, F)."""
    return (features @ fit[:-1] + fit[-1]).reshape(-1, 9, 3)


def _projection_features(projection: ArrayF64, clouds: CloudSet) -> ArrayF64:
    """(M, 55): the coefficients, and again times the share not seen, and that share."""
    unseen = 1 - clouds.coverage[:, None]
    flat = projection.reshape(len(projection), 27)
    return np.concatenate([flat, flat * unseen, unseen], axis=1)
