"""The light has changed: what becomes of the directions that nobody has looked at since?

Merging keeps them as they were last seen, so a lamp that goes down stays bright behind the phone's back. What is seen
again tells by how much the light changed there. If nearly all of it changed alike, the lamp is the cause and not
something that moved, and the rest follows by the same factor, one per channel: a guess, and a better one than no
change. It can be wrong: a lamp that lights only what is in view takes the rest of the room with it.

Where nothing changed nothing is touched, to the last bit. Rejected: forgetting what is old, which throws away what a
still room has taught; following every small change, which lets noise creep into what nobody sees; and a factor for each
direction from its neighbours, which has none where the unseen half begins.

Ratios are of decoded light at the session's reference exposure, so that the camera's exposure has no say. Clipped
channels know no ratio and dark ones only noise: neither is asked. Not in the paper, whose buffers keep old colours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.records import ArrayF64, UnitSphereCloud

BRIGHTEST, DARKEST = 0.95, 0.01
"""A channel is asked where the brighter of its two values lies between: linear light, 1 is where pictures clip."""

DARK_LIGHT = 1 / 512
"""Added on both sides of a ratio that is judged: dark surfaces, whose ratio is noise, count as little changed."""

FIRST_CODE = 1 / (255 * 12.92)
"""Added to a ratio that is followed, which `DARK_LIGHT` would draw to 1: a lamp that goes out leaves codes of 0."""


@dataclass(frozen=True)
class LightFollowing:
    """When what is not seen follows a change of the light.

    Parameters
    ----------
    smallest_stops : median change of a channel, in stops, from which the rest follows; walks through rooms whose light
        did not change had one of 0.35 once
    agreeing_share : of the anchors that can be asked, as many must have changed in that direction by a quarter of the
        median or more: what moves through the picture changes some, a lamp all
    smallest_share : share of the sphere that has to be seen again and can be asked
    same_distance : two distances in one direction that differ by no more than this share are those of one surface
    """

    smallest_stops: float = 0.5
    agreeing_share: float = 0.9
    smallest_share: float = 0.05
    same_distance: float = 0.02

    def __post_init__(self) -> None:
        if not 0 < self.smallest_stops < np.inf:
            raise ValueError(f"LightFollowing.smallest_stops: expected a number above 0, got {self.smallest_stops}")
        for name in ("agreeing_share", "smallest_share", "same_distance"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"LightFollowing.{name}: expected a share above 0, got {getattr(self, name)}")


def follow_light(old: UnitSphereCloud, new: UnitSphereCloud, settings: LightFollowing) -> UnitSphereCloud:
    """`old` with the anchors that `new` does not set changed as those that it does; itself if the light is the same.

    Both have N anchors. Colours stay within [0, 1]; distances stay. Anchors that `new` sets are left alone: merging
    replaces them.
    """
    factor = light_change(old, new, settings)
    stale = old.is_set & ~new.is_set
    if factor is None or not stale.any():
        return old
    followed = np.minimum(srgb_to_linear(old.srgb[stale].astype(np.float64)) * factor, 1.0)
    srgb = old.srgb.copy()
    srgb[stale] = linear_to_srgb(followed)
    return UnitSphereCloud(srgb, old.distance_m, old.is_set, old.invalid)


def light_change(old: UnitSphereCloud, new: UnitSphereCloud, settings: LightFollowing) -> ArrayF64 | None:
    """(3,) the factor of each channel's light from `old` to `new`; None if it is the same, or if nobody can say."""
    nearness = np.abs(new.distance_m - old.distance_m)
    seen_again = old.is_set & new.is_set & (nearness <= settings.same_distance * old.distance_m)
    before, after = (srgb_to_linear(cloud.srgb[seen_again].astype(np.float64)) for cloud in (old, new))
    brighter = np.maximum(before, after)
    can_say = (brighter > DARKEST) & (brighter < BRIGHTEST)
    n_least = settings.smallest_share * len(old)
    asked = [c for c in range(3) if 0 < np.count_nonzero(can_say[:, c]) >= n_least]
    judged = [_stops(before[can_say[:, c], c], after[can_say[:, c], c], DARK_LIGHT) for c in asked]
    if not any(_agree(stops, float(np.median(stops)), settings) for stops in judged):
        return None
    followed = _stops(before, after, FIRST_CODE)
    medians = np.array([np.median(followed[can_say[:, c], c]) if c in asked else np.nan for c in range(3)])
    # A channel too dark or too bright to say goes with the others.
    factor: ArrayF64 = np.exp2(np.where(np.isfinite(medians), medians, np.nanmean(medians)))
    return factor


def _stops(before: ArrayF64, after: ArrayF64, added: float) -> ArrayF64:
    stops: ArrayF64 = np.log2((after + added) / (before + added))
    return stops


def _agree(stops: ArrayF64, median: float, settings: LightFollowing) -> bool:
    is_alike = np.sign(median) * stops >= abs(median) / 4
    return bool(abs(median) >= settings.smallest_stops and is_alike.mean() >= settings.agreeing_share)
