"""The light probe rendered at the position: the best that order-2 spherical harmonics can do."""

from __future__ import annotations

import numpy as np

from xihenet.estimators.base import EstimateContext, Estimator
from xihenet.records import ArrayF64, UnitSphereCloud


class Truth(Estimator):
    """Hands on `context.truth_sh`; ValueError where it is missing."""

    name = "truth"
    uses_anchors = False
    needs = frozenset({"truth_sh"})

    def unknown_because(self, cloud: UnitSphereCloud, context: EstimateContext) -> str:
        """Known whatever the phone has seen."""
        return ""

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        if context.truth_sh is None:
            raise ValueError("truth: needs the rendered light probe; give EstimateContext(truth_sh=...)")
        return np.array(context.truth_sh, np.float64)
