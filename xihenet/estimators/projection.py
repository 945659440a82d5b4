"""The light that was seen, projected: regularised least squares on the set anchors, no learning.

What was not seen is filled by the smoothest light that fits. Surfaces that face away from the position, which it would
see from their other side, count less where the cloud says so. See `xihenet.sh.project_anchors`.
"""

from __future__ import annotations

from xihenet.estimators.base import EstimateContext, Estimator
from xihenet.records import ArrayF64, UnitSphereCloud
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice


class Projection(Estimator):
    """Least squares on the anchors. They are clipped at 1, so both targets give the same light; without any, black."""

    name = "projection"
    is_quick = True

    def _estimate(self, cloud: UnitSphereCloud, context: EstimateContext) -> ArrayF64:
        return project_anchors(cloud, AnchorLattice(self.n_anchors))
