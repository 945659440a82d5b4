"""By how much would what has been seen since change the light that is in force?

A colour that changes says little of the light: a poster that comes into view is no lamp. So each anchor is held
against what was expected of it: its old colour, or in a direction that was not known the light in force there. What is
unexpected is projected as the light is, with the same statistics of rooms, and drawn towards no change where little
was seen. What comes out is a change of the light's coefficients, held against the light's own.

Rejected, on pairs of frames and on walks: the difference of two fits, one of what was known and one of what was seen
since, which takes for a change of the light that each saw another part of a still room; and to hold the change against
the root of the light, by which a lamp that comes up from the dark asks less often, and pairs are told apart worse.

Not in the paper.
"""

from __future__ import annotations

import numpy as np

from xihenet.colour import srgb_to_linear
from xihenet.records import ArrayF64, UnitSphereCloud
from xihenet.sh import L1_VARIANCE, RESIDUAL_NOISE, anchor_basis, project_anchors
from xihenet.sh_basis import per_coefficient
from xihenet.sphere import AnchorLattice

# Variance of the constant coefficient around what the light in force says: 0.15 of white in radiance. A third or three
# times as much changes 1.3 % of the decisions on pairs of frames.
L0_VARIANCE = 0.3
# Root mean square of coefficients that is added to the light's, in its unit: even light of 0.085, where white is 1. So
# the dark, where every change is a large share, asks no more often than anybody sees.
DARK_LIGHT = 0.1


def expected_change(previous: UnitSphereCloud, current: UnitSphereCloud, lattice: AnchorLattice) -> float:
    """How much the light of `previous` is expected to change by what `current` shows: a share of that light, 0 or more.

    Root mean square over the nine coefficients and three channels of the expected change, linear, over that of the
    light that `project_anchors` makes of `previous` plus `DARK_LIGHT`. The change is the maximum a posteriori one:
    anchors that are not as expected are off by the change and by what order 2 cannot hold (`RESIDUAL_NOISE`), and
    coefficients change with variances `L0_VARIANCE` and `L1_VARIANCE` / l^2.

    Clouds and lattice have N anchors, else ValueError. Anchors that are not set, or whose colour became NaN, say
    nothing; 0 where `current` has no other, or is as expected.
    """
    light = project_anchors(_without_nan(previous), lattice)
    table = anchor_basis(lattice, 2)
    if len(current) != len(table):
        raise ValueError(f"expected_change: the lattice has {len(table)} anchors and the cloud {len(current)}")
    asked = _without_nan(current).is_set
    known = (_without_nan(previous).is_set & asked)[asked]
    seen = table[asked]
    expected = np.einsum("ni,ic->nc", seen, light)
    expected[known] = srgb_to_linear(previous.srgb[asked][known].astype(np.float64))
    unexpected = srgb_to_linear(current.srgb[asked].astype(np.float64)) - expected
    change = _projected(seen, unexpected, len(table))
    return _size(change) / (_size(light) + DARK_LIGHT)


def _without_nan(cloud: UnitSphereCloud) -> UnitSphereCloud:
    is_nan = np.isnan(cloud.srgb).any(axis=1)
    if not is_nan.any():
        return cloud
    kept = cloud.is_set & ~is_nan
    return UnitSphereCloud(
        np.where(kept[:, None], cloud.srgb, np.float32(0)), np.where(kept, cloud.distance_m, np.float32(0)), kept
    )


def _projected(seen: ArrayF64, unexpected: ArrayF64, n_anchors: int) -> ArrayF64:
    """(9, 3) the expected change of the light, of K directions' basis (K, 9) and unexpected radiance (K, 3)."""
    per_anchor = 4 * np.pi / n_anchors
    variance = per_coefficient(np.array([L0_VARIANCE, L1_VARIANCE, L1_VARIANCE / 4]))
    # As in `project_anchors`: neither a matrix product nor solve(), which wake all cores for this little.
    gram = np.einsum("ni,nj->ij", seen, seen) * per_anchor
    values, vectors = np.linalg.eigh(gram + np.diag(RESIDUAL_NOISE / variance))
    right_side = np.einsum("ni,nc->ic", seen, unexpected) * per_anchor
    change: ArrayF64 = vectors @ ((vectors.T @ right_side) / values[:, None])
    return change


def _size(coefficients: ArrayF64) -> float:
    return float(np.sqrt(np.mean(coefficients**2)))
