"""Completeness: how much of the light around a position has been seen?

Coverage is the share of anchors that are set: the paper's observation completeness, and what the trigger and the report
use. Joint entropy, the paper's equation 1, also asks how evenly the points of a cloud are spread, at several scales at
once, and compares clouds of the same size; it needs no sampled cloud. Its P is the share of the points in an anchor's
cell and sums to 1 for each number of anchors. Rejected: one sum over all numbers together, which would weigh the scales
by a constant that carries no information.

What decides the figure is what the cloud holds: pixels without depth that are kept as points at the camera make a whole
cloud look incomplete, and every sampling that thins them out complete.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from xihenet.records import ArrayInt, UnitSphereCloud
from xihenet.sampling import checked_position
from xihenet.sphere import AnchorLattice

ENTROPY_SIZES = tuple(2**k for k in range(1, 13))


def coverage(cloud: UnitSphereCloud) -> float:
    """Share of the anchors that are set, 0 to 1; 0 for a cloud without anchors."""
    return int(np.count_nonzero(cloud.is_set)) / len(cloud) if len(cloud) else 0.0


def share_from_behind(cloud: UnitSphereCloud) -> float:
    """Share of the set anchors whose surface turns its unseen side to the position, 0 to 1.

    0 where no surface is known. Some 0.1 in a furnished room, over a half inside a closed thing or behind a wall.
    """
    if cloud.surfaces is None or not cloud.is_set.any():
        return 0.0
    return float((cloud.surfaces.facing[cloud.is_set] < 0).mean())


def joint_entropy(points_m: ArrayLike, position_m: ArrayLike, *, sizes: Sequence[int] = ENTROPY_SIZES) -> float:
    """Joint entropy of the points' directions and the anchors, in bits, summed over `sizes`, numbers of anchors.

    `points_m` (P, 3) and `position_m` (3,) are in the world frame, metres. Points that are not finite or lie at the
    position are left out. 0 if all points lie in one direction, or if there are none; at most the sum of log2 of the
    sizes: 1 + 2 + ... + 12 = 78 for the paper's, and 66 without its last, which its published figures leave out.
    ValueError for another shape, or a position that is not finite.
    """
    points, position = np.asarray(points_m, np.float64), checked_position(position_m)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points_m: expected an array of shape (any, 3), got {points.shape}")
    with np.errstate(over="ignore"):  # What float64 cannot hold becomes infinite, and is left out below.
        relative = points - position
    usable = np.isfinite(relative).all(axis=1) & relative.any(axis=1)
    columns = np.ascontiguousarray(relative[usable].T)
    return sum(_entropy(AnchorLattice(n).nearest_to_columns(columns)) for n in sizes)


def _entropy(labels: ArrayInt) -> float:
    """Entropy of the labels' shares, in bits; 0 without labels."""
    counts = np.bincount(labels)
    shares = counts[counts > 0] / max(len(labels), 1)
    # Adding 0 turns the -0.0 of a single share into 0.0.
    return float(-(shares * np.log2(shares)).sum()) + 0.0
