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

from dataclasses import dataclass, replace

import numpy as np

from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.records import ArrayF32, ArrayF64, ArrayInt, UnitSphereCloud

# A channel is asked where the brighter of its two values lies between: linear light, 1 is where pictures clip.
BRIGHTEST, DARKEST = 0.95, 0.01
ENCODED_BRIGHTEST, ENCODED_DARKEST = (float(linear_to_srgb(np.array(light))) for light in (BRIGHTEST, DARKEST))

DARK_LIGHT = 1 / 512  # Added on both sides of a judged ratio: dark surfaces, which are noise, count as little changed
FIRST_CODE = 1 / (255 * 12.92)  # Added to a followed ratio, which DARK_LIGHT would draw to 1: lamps that go out leave 0
UNCHANGED_STOPS = 0.25  # A surface that changed by less may as well have kept its light
SURELY_UNCHANGED = 0.05  # Of its encoded colour: what changes by less is unchanged; a quarter of a stop is 7 % or more
ROUNDED_UP = 1 + 1e-12  # Shares that are just enough are so in whatever order they are worked out


@dataclass(frozen=True)
class LightFollowing:
    """When what is not seen follows a change of the light."""

    # Median change of a channel, in stops, from which the rest follows; walks through rooms whose light did not change
    # had one of 0.35 once.
    smallest_stops: float = 0.5
    # Of the anchors that can be asked, as many must have changed in that direction by a quarter of the median or more:
    # what moves through the picture changes some, a lamp all.
    agreeing_share: float = 0.9
    smallest_share: float = 0.05  # of the sphere that has to be seen again and can be asked
    same_distance: float = 0.02  # share by which two distances in one direction may differ that are of one surface
    most_unchanged: float = 1.0  # no larger share may have changed by less than UNCHANGED_STOPS; 1 does not ask

    def __post_init__(self) -> None:
        if not 0 < self.smallest_stops < np.inf:
            raise ValueError(f"LightFollowing.smallest_stops: expected a number above 0, got {self.smallest_stops}")
        for name in ("agreeing_share", "smallest_share", "same_distance", "most_unchanged"):
            if not 0 < getattr(self, name) <= 1:
                raise ValueError(f"LightFollowing.{name}: expected a share above 0, got {getattr(self, name)}")


def follow_light(old: UnitSphereCloud, new: UnitSphereCloud, settings: LightFollowing) -> UnitSphereCloud:
    """`old` with the anchors that `new` does not set changed as those that it does; itself if the light is the same.

    Both have N anchors. Colours stay within [0, 1]; distances and surfaces stay. Anchors that `new` sets are left
    alone: merging replaces them.
    """
    factor = light_change(old, new, settings)
    stale = old.is_set & ~new.is_set
    if factor is None or not stale.any():
        return old
    srgb = old.srgb.copy()
    srgb[stale] = linear_to_srgb(srgb_to_linear(old.srgb[stale].astype(np.float64)) * factor)
    return replace(old, srgb=srgb)


def follow_coarser(
    fine: UnitSphereCloud, before: UnitSphereCloud, after: UnitSphereCloud, beside: ArrayInt
) -> UnitSphereCloud:
    """`fine` with each of its K anchors changed as the one at `beside`, (K,), was from `before` to `after`.

    Those two have N anchors and the same ones set. Colours stay within [0, 1].
    """
    is_changed = (before.srgb != after.srgb).any(axis=1)[beside] & fine.is_set
    old, new = (srgb_to_linear(cloud.srgb[beside[is_changed]].astype(np.float64)) for cloud in (before, after))
    srgb = fine.srgb.copy()
    changed = srgb_to_linear(srgb[is_changed].astype(np.float64)) * np.exp2(_stops(old, new, FIRST_CODE))
    srgb[is_changed] = linear_to_srgb(np.clip(changed, 0, 1))
    return replace(fine, srgb=srgb)


def light_change(old: UnitSphereCloud, new: UnitSphereCloud, settings: LightFollowing) -> ArrayF64 | None:
    """(3,) the factor of each channel's light from `old` to `new`; None if it is the same, or if nobody can say."""
    nearness = np.abs(new.distance_m - old.distance_m)
    seen_again = old.is_set & new.is_set & (nearness <= settings.same_distance * old.distance_m)
    index = np.flatnonzero(seen_again)
    encoded = old.srgb.take(index, axis=0), new.srgb.take(index, axis=0)
    if _cannot_agree(*encoded, settings):
        return None
    before, after = (srgb_to_linear(colours.astype(np.float64)) for colours in encoded)
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
    return np.exp2(np.where(np.isfinite(medians), medians, np.nanmean(medians)))


def _cannot_agree(before: ArrayF32, after: ArrayF32, settings: LightFollowing) -> bool:
    """Whether in each channel of these encoded colours (K, 3) too many are unchanged, or too few change in one way.

    A fraction of the time that `_agree` takes, which says the same in the end: most frames of a walk end here.
    """
    brighter, change = np.maximum(before, after), after - before
    can_say = (brighter > ENCODED_DARKEST) & (brighter < ENCODED_BRIGHTEST)
    n_asked = np.count_nonzero(can_say, axis=0)
    unchanged = np.count_nonzero(can_say & (np.abs(change) < SURELY_UNCHANGED * brighter), axis=0)
    is_same = unchanged > settings.most_unchanged * n_asked * ROUNDED_UP
    if is_same.all():
        return True
    up, down = (np.count_nonzero(can_say & changed, axis=0) for changed in (change > 0, change < 0))
    disagree = np.maximum(up, down) * ROUNDED_UP < settings.agreeing_share * n_asked
    return bool((is_same | disagree).all())


def _stops(before: ArrayF64, after: ArrayF64, added: float) -> ArrayF64:
    return np.log2((after + added) / (before + added))


def _agree(stops: ArrayF64, median: float, settings: LightFollowing) -> bool:
    if abs(median) < settings.smallest_stops:
        return False
    is_alike = np.sign(median) * stops >= abs(median) / 4
    is_unchanged = np.abs(stops) < UNCHANGED_STOPS
    return bool(is_alike.mean() >= settings.agreeing_share and is_unchanged.mean() <= settings.most_unchanged)
