"""Baselines, predictors without a network; those that are fitted are fitted on the same rooms as the networks.

The mean light of the training rooms, whose error is what all others are divided by; what a phone's sensor gives, as it
is and with a scale and an offset; the projection, as it is and with a regularised linear fit of its coefficients and
the share not seen, which is a serious baseline: on real data such a fit comes close to the paper's network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.codec import facing_of_codes
from xihenet.estimators.ambient import constant_light
from xihenet.estimators.base import Target
from xihenet.records import AnchorSurfaces, ArrayF64, UnitSphereCloud
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
    """Fitted to training clouds; `lights` predicts.

    Parameters
    ----------
    target : "ldr" or "hdr"
    mean_light : (9, 3) of the training clouds of one view
    ambient_fit : (4, 27), see `fit_linear`
    projection_fit : (56, 27)
    n_clouds, n_rooms : that were fitted to
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
            AMBIENT: sensed_lights(clouds.ambient, self.target),
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
    lattice = AnchorLattice(clouds.is_set.shape[1])
    unasked_m, lights = np.zeros(clouds.is_set.shape[1], np.float32), []
    for srgb_u8, is_set, facing_i8 in zip(clouds.srgb_u8, clouds.is_set, clouds.facing_i8, strict=True):
        surfaces = AnchorSurfaces.of_facing(facing_of_codes(facing_i8)) if facing_i8.any() else None
        cloud = UnitSphereCloud(srgb_u8 / np.float32(255), unasked_m, is_set, surfaces=surfaces)
        lights.append(project_anchors(cloud, lattice))
    return np.array(lights).reshape(-1, 9, 3)


def sensed_lights(ambient: ArrayLike, target: Target) -> ArrayF64:
    """(M, 9, 3) what `ambient` says of what sensors measured, (M, 3)."""
    radiance = np.asarray(ambient, np.float64)
    shown = np.minimum(radiance, 1.0) if target == "ldr" else radiance
    return np.array([constant_light(one) for one in shown]).reshape(-1, 9, 3)


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
    light: ArrayF64 = (features @ fit[:-1] + fit[-1]).reshape(-1, 9, 3)
    return light


def _projection_features(projection: ArrayF64, clouds: CloudSet) -> ArrayF64:
    """(M, 55): the coefficients, and again times the share not seen, and that share."""
    unseen = 1 - clouds.coverage[:, None]
    flat = projection.reshape(len(projection), 27)
    return np.concatenate([flat, flat * unseen, unseen], axis=1)
