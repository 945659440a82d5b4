"""The two buffers into which frames merge: what a position has seen so far, and what its light was estimated from.

Two clouds per position: the temporary one merges every frame since the last fire, the persistent one is merged from it
when the trigger fires, and the estimate is made from the persistent one after that merge. The trigger compares the two.
Both are replaced, never changed, so a report can keep the clouds it was made from.

A frame from another side sees surfaces that something hides from the position, and need not see what hides them. So
what lies behind what is known does not replace it (`in_sight`), unless the frame sees through the place where that was.

Nor does a surface look the same from all sides: a floor mirrors a lamp to one of them. So where the light has not
changed, what several views show of a surface is averaged (`merge_views`), when the trigger fires.

Paper: section 4.2.1 and `Merging` in its figure 7, in which whatever is newer wins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import sees_through
from xihenet.colour import CLIPPED_FROM
from xihenet.records import FAR_FROM_M, AnchorSurfaces, ArrayBool, ArrayF32, ArrayF64, RgbdFrame, UnitSphereCloud
from xihenet.sampling import SAME_SURFACE, sample_again
from xihenet.sh import facing_weights
from xihenet.sphere import AnchorLattice

BEHIND_FROM = 1.5
"""A surface is behind another one beyond so many times its distance. Less may be noise: that of a table 5 cm away."""

N_BESIDE = 6
"""An anchor and its nearest neighbours, of which all but one have to be nearer to hide a surface that is not far away.

Within a frame the nearest point wins an anchor. A thing narrower than that takes all of it; from many frames it would
come to hide whatever is around it, lamps among it.
"""


class FrameAtPosition(NamedTuple):
    """A frame, and the position (3,), world, metres, whose anchors are those of `lattice`."""

    frame: RgbdFrame
    position_m: ArrayLike
    lattice: AnchorLattice


def merge(old: UnitSphereCloud, new: UnitSphereCloud) -> UnitSphereCloud:
    """`old` with every anchor that `new` sets replaced by `new`'s colour, distance and surface; nothing is averaged.

    Where one of them has no surfaces, those of its anchors are unknown (0). Both have N anchors (ValueError otherwise).
    What is invalid is that of `new`: it belongs to a frame.
    """
    if len(old) != len(new):
        raise ValueError(f"merge: expected clouds with as many anchors, got {len(old)} and {len(new)}")
    return _merged(old, new, _merged_surfaces(old, new))


def merge_views(old: UnitSphereCloud, new: UnitSphereCloud) -> UnitSphereCloud:
    """`merge` of two views in the same light: of what both show of one surface (`SAME_SURFACE`) the colour is a mean.

    Of the encoded colours, in which a highlight counts less than in linear ones, weighted by how the surfaces face the
    position (`facing_weights`); alike where that is not known. Where only one of them is clipped (`CLIPPED_FROM`) the
    newer one wins: the mean would be of no lamp and of no wall. Both have N anchors (ValueError otherwise). A surface
    that both show alike keeps its colour to the last bit.
    """
    merged = merge(old, new)
    with np.errstate(over="ignore"):  # No surface is further away than what is at the end of float32.
        is_same = (new.distance_m <= SAME_SURFACE * old.distance_m) & (old.distance_m <= SAME_SURFACE * new.distance_m)
    is_clipped, was_clipped = (cloud.srgb.max(axis=1) >= CLIPPED_FROM for cloud in (new, old))
    both = np.flatnonzero(old.is_set & new.is_set & is_same & (is_clipped == was_clipped))
    before, after = (
        facing_weights(np.zeros(len(both)) if cloud.surfaces is None else cloud.surfaces.facing[both])
        for cloud in (old, new)
    )
    share, srgb = (after / (before + after)).astype(np.float32), merged.srgb.copy()
    srgb[both] = old.srgb[both] + (new.srgb[both] - old.srgb[both]) * share[:, None]
    known = merged.invalid, merged.surfaces, merged.beside_m
    return UnitSphereCloud.trusted(srgb, merged.distance_m, merged.is_set, *known)


def in_sight(old: UnitSphereCloud, new: UnitSphereCloud, sight: FrameAtPosition | None = None) -> UnitSphereCloud:
    """`new` without the anchors that lie behind `old`'s: something nearer hides them from the position.

    With the `sight` from which `new` comes they stay where its frame sees through the place at which `old`'s were: what
    hid them is gone. Both have N anchors (ValueError otherwise).
    """
    if len(old) != len(new):
        raise ValueError(f"in_sight: expected clouds with as many anchors, got {len(old)} and {len(new)}")
    return _without_hidden(old.distance_m, old.is_set, new, sight)


def merge_in_sight(old: UnitSphereCloud, new: UnitSphereCloud, sight: FrameAtPosition | None = None) -> UnitSphereCloud:
    """`merge` of `old` and what of `new` is `in_sight`."""
    return merge(old, in_sight(old, new, sight))


def _without_hidden(
    known_m: ArrayF32, is_known: ArrayBool, new: UnitSphereCloud, sight: FrameAtPosition | None
) -> UnitSphereCloud:
    """`in_sight`, of the distances (N,) of what is known."""
    with np.errstate(over="ignore"):  # Nothing is behind what is at the end of float32.
        limit_m = known_m * np.float32(BEHIND_FROM)
    hidden = np.flatnonzero(is_known & new.is_set & (new.distance_m > limit_m))
    if hidden.size:
        beside = AnchorLattice(len(new)).neighbours(min(N_BESIDE, len(new)))[hidden]
        n_nearer = (is_known[beside] & (new.distance_m[hidden, None] > limit_m[beside])).sum(axis=1)
        hidden = hidden[(n_nearer >= beside.shape[1] - 1) | (new.distance_m[hidden] >= FAR_FROM_M)]
    if sight is not None and hidden.size:
        points_m = sight.lattice.directions[hidden] * known_m[hidden, None] + np.asarray(sight.position_m, np.float64)
        hidden = hidden[~sees_through(points_m, sight.frame)]
    if not hidden.size:
        return new
    seen = new.is_set.copy()
    seen[hidden] = False
    known = new.invalid, new.surfaces, new.beside_m
    return UnitSphereCloud.trusted(new.srgb * seen[:, None], new.distance_m * seen, seen, *known)


def _merged(old: UnitSphereCloud, new: UnitSphereCloud, surfaces: AnchorSurfaces | None) -> UnitSphereCloud:
    taken = new.is_set
    # Channel by channel side by side, in half the time of a choice by rows.
    srgb = np.where(taken.repeat(3), new.srgb.reshape(-1), old.srgb.reshape(-1)).reshape(-1, 3)
    distance_m = np.where(taken, new.distance_m, old.distance_m)
    beside_m = None
    if old.beside_m is not None or new.beside_m is not None:
        before_m, after_m = (np.float32(0) if one.beside_m is None else one.beside_m for one in (old, new))
        beside_m = np.where(taken[:, None], after_m, before_m)
    return UnitSphereCloud.trusted(srgb, distance_m, old.is_set | new.is_set, new.invalid, surfaces, beside_m)


def _merged_surfaces(old: UnitSphereCloud, new: UnitSphereCloud) -> AnchorSurfaces | None:
    if old.surfaces is None and new.surfaces is None:
        return None
    unknown = AnchorSurfaces.of_facing(np.zeros(len(old), np.float32))
    before, after, taken = old.surfaces or unknown, new.surfaces or unknown, new.is_set
    return AnchorSurfaces(
        np.where(taken, after.facing, before.facing),
        np.where(taken, after.camera_distance_m, before.camera_distance_m),
        np.where(taken[:, None], after.view_direction, before.view_direction),
    )


@dataclass(frozen=True, eq=False)
class PositionBuffers:
    """The two clouds of one estimation position, N anchors each."""

    temporary: UnitSphereCloud
    persistent: UnitSphereCloud

    @classmethod
    def empty(cls, n_anchors: int) -> PositionBuffers:
        """Nothing seen yet."""
        nothing = UnitSphereCloud.empty(n_anchors)
        return cls(nothing, nothing)

    def in_sight(self, sampled: UnitSphereCloud, sight: FrameAtPosition | None = None) -> UnitSphereCloud:
        """`sampled`, of a frame, without what lies behind what was last seen: it is no change of the light."""
        old, new = self.persistent, self.temporary
        known_m = np.where(new.is_set, new.distance_m, old.distance_m)
        return _without_hidden(known_m, old.is_set | new.is_set, sampled, sight)

    def with_frame(self, sampled: UnitSphereCloud) -> PositionBuffers:
        """After one more frame was sampled."""
        return replace(self, temporary=merge(self.temporary, sampled))

    def fired(self, *, is_changed: bool = True) -> PositionBuffers:
        """After the trigger fired: the temporary cloud moves into the persistent one and starts anew.

        Whatever is newer wins where the light `is_changed`; where it is not, both are views of the same light.
        """
        merged = (merge if is_changed else merge_views)(self.persistent, self.temporary)
        return PositionBuffers(UnitSphereCloud.empty(len(self.temporary)), merged)

    def moved(self, by_m: ArrayF64, lattice: AnchorLattice) -> PositionBuffers:
        """After the position moved `by_m` (3,): both clouds as they look from there."""
        temporary, persistent = (sample_again(cloud, by_m, lattice) for cloud in (self.temporary, self.persistent))
        return PositionBuffers(in_sight(persistent, temporary), persistent)

    def last_seen(self) -> UnitSphereCloud:
        """Every anchor as it was last seen, whether or not the light in use was made from it; without surfaces."""
        return _merged(self.persistent, self.temporary, None)

    def coverage(self) -> float:
        """Share of the anchors that are known, whether or not the light in use was made from them."""
        return float((self.persistent.is_set | self.temporary.is_set).mean()) if len(self.temporary) else 0.0
