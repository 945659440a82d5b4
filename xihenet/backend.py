"""Where does an estimate come from: this machine, or another one?

The controller asks an `InferenceBackend` and does not know. Paper: section 5, `InferenceBackend`.
"""

from __future__ import annotations

from typing import Protocol

from xihenet.estimators.base import EstimateContext, Estimator
from xihenet.records import ArrayF64, UnitSphereCloud


class InferenceBackend(Protocol):
    """Turns a cloud into (9, 3) radiance coefficients that carry the session's exposure.

    A backend may also have `estimate_with_error`, as `LocalBackend` has; the controller asks it where it is there.
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
