"""The difference of two lights: how unlike are those that two clouds show?

Each cloud's light is the fast fit of `project_anchors`, with the statistics of rooms where nothing was seen; the share
by which two of them differ is asked of each colour channel, and the channel that differs most counts, so that a lamp
that turns from white to yellow counts by the blue that goes missing. Direction counts twice as much as the mean: it is
what one sees on an object. A poster that comes into view counts by as much light as it sends.

Rejected, on pairs of frames and on walks of sixteen recordings: to hold each anchor against what was expected of it
and to project what is unexpected, which is as good on walks and tells pairs apart worse; what the difference must be
even under one light, since the two saw other parts of it, taken off; the lights of `lattice`, which tell pairs apart no
better and take four times as long; all channels as one, which notices a lamp's colour late.

Not in the paper.
"""

from __future__ import annotations

import numpy as np

from xihenet.records import ArrayF64, UnitSphereCloud
from xihenet.sh import project_anchors
from xihenet.sphere import AnchorLattice

DIRECTION_WEIGHT = 2.0
_WEIGHTS = np.array([1.0, *[DIRECTION_WEIGHT] * 8])[:, None]
# Root mean square of coefficients that is added to the lights', in their unit: even light of 0.04, where white is 1. So
# the dark, where every change is a large share, asks no more often than anybody sees.
DARK_LIGHT = 0.05


def light_difference(first: UnitSphereCloud, second: UnitSphereCloud, lattice: AnchorLattice) -> float:
    """The share by which the lights of two clouds differ: 0 for the same, at most 2; the order does not matter.

    By channel the root mean square over the nine coefficients of their difference, linear and those of l = 1 and 2
    times `DIRECTION_WEIGHT`, over that of both lights plus `DARK_LIGHT`; the largest of the three.

    Clouds and lattice have N anchors, else ValueError. Anchors that are not set, or whose colour became NaN, say
    nothing; 0 where one of the clouds has no other.
    """
    clouds = [_without_nan(cloud) for cloud in (first, second)]
    lights = [project_anchors(cloud, lattice) * _WEIGHTS for cloud in clouds]
    if not all(cloud.is_set.any() for cloud in clouds):
        return 0.0
    both = np.sqrt((_mean_square(lights[0]) + _mean_square(lights[1])) / 2)
    return float(np.max(np.sqrt(_mean_square(lights[1] - lights[0])) / (both + DARK_LIGHT)))


def _without_nan(cloud: UnitSphereCloud) -> UnitSphereCloud:
    is_nan = np.isnan(cloud.srgb).any(axis=1)
    if not is_nan.any():
        return cloud
    kept = cloud.is_set & ~is_nan
    return UnitSphereCloud(
        np.where(kept[:, None], cloud.srgb, np.float32(0)), np.where(kept, cloud.distance_m, np.float32(0)), kept
    )


def _mean_square(light: ArrayF64) -> ArrayF64:
    """(3,) by channel."""
    return np.mean(light**2, axis=0)
