"""The light in use between two estimates: what does it do while the room goes on, until the next one is there?

A lamp that is dimmed changes every frame, and an estimate is always of a frame gone by: the trigger waits for a change
that is worth its cost, and the network takes its time. The estimate is carried on: multiplied, per channel, by how much
light there is now against its own frame. It is always the estimate itself that is multiplied, never what was shown
before: so a change is never applied twice, nothing adds up and nothing decays. A late estimate has its own frame to
compare with, so that it comes with all that happened since.

The gain is told by surfaces of the estimate's frame that are seen again, under the same angle. Where nearly all changed
alike (`light_change`) it follows, else it stays as it is: under light that stands still it is 1 to the last bit,
whatever the noise. A phone that has walked on sees little of that frame again; its light stays until the next estimate,
unless all that is in view changes from one frame to the next as a lamp does that is switched.

Rejected: the ratio of two readings of the ambient sensor. AR toolkits derive them from the camera's picture, so they
change as much when the phone turns to a brighter wall (docs/trigger.md has both). A level of the light since the
session began, each surface against when it was first seen: in a walk under a lamp that swings, it noticed the lamp
going down more often than up and was off by two stops within seconds. A light that fades towards the new one for ever.

Not in the paper, whose light stands still between estimates. It is a guess where one lamp of several changes: what is
out of view is taken to change as what is in view does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from xihenet.colour import LUMINANCE, linear_to_srgb, srgb_to_linear
from xihenet.light.key_light import brighter, mean_light
from xihenet.light_change import ENCODED_BRIGHTEST, ENCODED_DARKEST, LightFollowing, light_change
from xihenet.records import ArrayBool, ArrayF64, LightEstimate, ObjectLight, UnitSphereCloud
from xihenet.trigger import MOST_UNCHANGED, SMALLEST_STOPS, seen_from_another_angle

CHANGE = LightFollowing(smallest_stops=0.02, agreeing_share=0.8, same_distance=0.05)
"""Which change of the light is followed: docs/trigger.md says what it was chosen by."""

CHANGE_AT_ONCE = LightFollowing(SMALLEST_STOPS, agreeing_share=0.9, most_unchanged=MOST_UNCHANGED)
"""The same from one frame to the next: a lamp that is switched, which a walk does not look like."""

LEAST_OF_FRAME = 0.3
"""Share of what a frame shows that has to be seen again: few surfaces say little."""

VIEW_ANGLE_DEG = 3.0  # as of the trigger: reflections move by as much
BLEND_S = 0.1
"""How long an estimate that comes late takes to replace those before it: a ramp, which ends."""

MOST_GAIN = 16.0
"""An estimate is carried up or down by no more: of what was darker than a sixteenth, its noise would be carried."""


@dataclass(frozen=True, eq=False)
class CarriedLight:
    """An estimate, and the light of the room now over that of its frame: `gain` (3,), by channel, above 0."""

    estimate: LightEstimate
    gain: ArrayF64 = field(default_factory=lambda: np.ones(3))

    def after(self, frame: UnitSphereCloud, before: UnitSphereCloud | None, directions: ArrayF64) -> CarriedLight:
        """After another frame; `frame` is what it alone shows at the position, `before` what the one before it did.

        By N anchors, with `directions` (N, 3).
        """
        base, factor = self.estimate.seen, None
        again = np.zeros(len(frame), bool) if base is None else _seen_again(base, frame, directions)
        if base is not None and np.count_nonzero(again) >= LEAST_OF_FRAME * np.count_nonzero(frame.is_set):
            factor = light_change(self._expected(base), _only(frame, again), CHANGE)
        elif before is not None:
            factor = light_change(before, frame, CHANGE_AT_ONCE)
        if factor is None:
            return self
        return replace(self, gain=np.clip(self.gain * factor, 1 / MOST_GAIN, MOST_GAIN))

    def moved(self) -> CarriedLight:
        """After the position moved: the gain stays, since what was seen from elsewhere cannot be asked any more."""
        return replace(self, estimate=replace(self.estimate, seen=None))

    @property
    def light(self) -> LightEstimate:
        """The estimate and its key lights times the gain; itself where that is 1. What was seen stays as it was."""
        estimate, gain = self.estimate, self.gain
        if (gain == 1).all():
            return estimate
        error = estimate.expected_error
        return replace(
            estimate,
            sh_radiance=estimate.sh_radiance * gain,
            expected_error=None if error is None else error * float(gain @ LUMINANCE),
            others={name: sh * gain for name, sh in estimate.others.items()},
            key=estimate.key and brighter(estimate.key, gain),
            other_keys={name: brighter(key, gain) for name, key in estimate.other_keys.items()},
        )

    def _expected(self, base: UnitSphereCloud) -> UnitSphereCloud:
        """What is to be seen again where nothing has changed any more."""
        if (self.gain == 1).all():
            return base
        lit = srgb_to_linear(base.srgb.astype(np.float64)) * self.gain
        return UnitSphereCloud.trusted(linear_to_srgb(lit).astype(np.float32), base.distance_m, base.is_set, {}, None)


def _only(cloud: UnitSphereCloud, kept: ArrayBool) -> UnitSphereCloud:
    return UnitSphereCloud.trusted(cloud.srgb * kept[:, None], cloud.distance_m * kept, kept, {}, None)


def _seen_again(base: UnitSphereCloud, frame: UnitSphereCloud, directions: ArrayF64) -> ArrayBool:
    """(N,) whose surface can be asked: the same one under the same angle, neither clipped nor dark in `base`."""
    brightest = base.srgb.max(axis=1)
    can_say = (brightest > ENCODED_DARKEST) & (brightest < ENCODED_BRIGHTEST)
    is_same = np.abs(frame.distance_m - base.distance_m) <= CHANGE.same_distance * base.distance_m
    again: ArrayBool = base.is_set & frame.is_set & can_say & is_same
    return again & ~seen_from_another_angle(base, frame, directions, VIEW_ANGLE_DEG)


def blended(lights: Sequence[tuple[float, ObjectLight]]) -> ObjectLight:
    """One light of several, each with its share, which add up to 1; ValueError for none. Reflections are left out.

    The key light is the strongest by its share: of two that cross, one fades before the other comes.
    """
    if len(lights) == 1:
        return lights[0][1]
    n, parts = len(lights), []
    for share, light in lights:
        gain = np.full(3, share * n)
        parts.append(ObjectLight(light.sh * gain, light.key and brighter(light.key, gain)))
    return mean_light(parts)
