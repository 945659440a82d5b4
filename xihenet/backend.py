"""Where does an estimate come from: this machine, or another one? And what if it cannot be known?

The controller asks an `InferenceBackend` and does not know. What it gets back is a `LightEstimate` in any case: of a
light that cannot be known, or that comes back NaN, it says so and why, and the one who asked keeps the light before.
Rejected: an exception there, which would end a session for one frame. Paper: section 5, `InferenceBackend`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from xihenet.completeness import coverage
from xihenet.estimators.base import EstimateContext, Estimator, NotFinite
from xihenet.records import ArrayF64, LightEstimate, UnitSphereCloud


class InferenceBackend(Protocol):
    """Turns a cloud into (9, 3) radiance coefficients that carry the session's exposure.

    A backend may also have what else `LocalBackend` has; it is asked where it is there.
    """

    name: str
    n_anchors: int

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64: ...


class LocalBackend:
    """Estimates in this process with `estimator`."""

    def __init__(self, estimator: Estimator) -> None:
        self.estimator = estimator
        self.name = estimator.name
        self.n_anchors = estimator.n_anchors

    def estimate(self, cloud: UnitSphereCloud, context: EstimateContext | None = None) -> ArrayF64:
        """(9, 3); ValueError as the estimator raises it."""
        return self.estimator.estimate(cloud, context)

    def estimate_with_error(
        self, cloud: UnitSphereCloud, context: EstimateContext | None = None
    ) -> tuple[ArrayF64, float | None]:
        """As `estimate`, and the SHC RMSE that the estimator expects of it; None if it does not know."""
        return self.estimator.estimate_with_error(cloud, context)

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """As the estimator says it."""
        return self.estimator.unknown_because(cloud, context)

    @property
    def farthest_m(self) -> float:
        """The estimator's."""
        return self.estimator.farthest_m


def estimate_light(
    backend: InferenceBackend, cloud: UnitSphereCloud, context: EstimateContext, exposure: float
) -> LightEstimate:
    """The light that `cloud` and `context` show, carrying `exposure`; where it cannot be known, 0, not valid, and why.

    ValueError as the backend raises it, but for a result that is not finite.
    """
    sh_radiance, expected_error = np.zeros((9, 3)), None
    reason = _unknown_because(backend, cloud, context)
    if not reason:
        try:
            found, error = _estimate_with_error(backend, cloud, context)
            is_finite = np.isfinite(found).all() and (error is None or np.isfinite(error))
        except NotFinite:
            is_finite = False
        if is_finite:
            sh_radiance, expected_error = found, error
        else:
            reason = "estimate_not_finite"
    return LightEstimate(sh_radiance, exposure, coverage(cloud), backend.name, not reason, expected_error, reason)


def _unknown_because(backend: InferenceBackend, cloud: UnitSphereCloud, context: EstimateContext) -> str:
    if hasattr(backend, "unknown_because"):
        return str(backend.unknown_because(cloud, context))
    return "" if cloud.is_set.any() else "nothing_seen"


def _estimate_with_error(
    backend: InferenceBackend, cloud: UnitSphereCloud, context: EstimateContext
) -> tuple[ArrayF64, float | None]:
    """The error is None from a backend that gives light alone."""
    if hasattr(backend, "estimate_with_error"):
        sh_radiance, expected_error = backend.estimate_with_error(cloud, context)
        return sh_radiance, expected_error
    return backend.estimate(cloud, context), None
