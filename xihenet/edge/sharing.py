"""Sharing: what one position has seen, as another one sees it, and clouds at another exposure.

Where a position has seen nothing in a direction, points that were seen from a position nearby may lie there. They are
the points of that cloud moved over, nearest first; what hid them from here may be seen by nobody, so a shared point can
lie behind a wall. It is therefore asked for request by request, counts for that estimate alone, and is never stored.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from xihenet.buffers import merge
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.edge.sessions import SeenPosition
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_again
from xihenet.sphere import AnchorLattice

FARTHEST_SHARED_M = 3.0
"""Between two positions: from farther away a cloud of anchors leaves too many holes."""

MOST_SHARED = 3
"""Positions that one estimate borrows from; each takes some 0.7 ms."""


def with_others(seen: SeenPosition, others: Iterable[SeenPosition], lattice: AnchorLattice) -> UnitSphereCloud:
    """What a position has seen, and in directions that it does not know what `others` have, the nearest of them first.

    At the position's exposure. Others without a place, or too far away, are left out; ValueError if it has none itself.
    """
    if seen.position_m is None:
        raise ValueError("with_others: expected a position that is somewhere")
    near = [
        (float(np.linalg.norm(other.position_m - seen.position_m)), number, seen.position_m - other.position_m, other)
        for number, other in enumerate(others)
        if other.position_m is not None and other.cloud.is_set.any()
    ]
    cloud = seen.cloud
    for distance_m, _, moved_m, other in sorted(near, key=lambda one: one[:2])[:MOST_SHARED]:
        if distance_m <= FARTHEST_SHARED_M:
            shared = sample_again(re_exposed(other.cloud, seen.exposure / other.exposure), moved_m, lattice)
            cloud = merge(shared, cloud)
    return cloud


def re_exposed(cloud: UnitSphereCloud, gain: float) -> UnitSphereCloud:
    """The cloud at an exposure `gain` times its own, clipped at white as a camera clips."""
    if gain == 1.0:
        return cloud
    srgb = linear_to_srgb(srgb_to_linear(cloud.srgb) * np.float32(gain))
    return replace(cloud, srgb=srgb)
