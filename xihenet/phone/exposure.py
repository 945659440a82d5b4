"""Frames of a session in time: which of them the phone delivers, and the exposure of each, which lags behind.

A scene may be animated at any rate; a phone delivers at its own. Chosen: of each interval of the phone's clock the
first frame of the scene, so that nothing is invented. Rejected: blending frames, which no range sensor does.

The exposure of a phone that meters by itself is a small state machine on its logarithm: each frame moves it towards
what the frame before asked for, exponentially in time, within clamps around the session's reference. Chosen: an
exponential approach in stops, as open camera stacks filter theirs; a doubling of the light is then followed as fast as
a halving. Rejected: a full model of shutter time and gain, of which only the product reaches the picture. The whole
session is one pure function of its meterings that never looks ahead: a run that is resumed, or whose frames are seen in
another order, gets the same exposures.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from xihenet.camera import encode_exposed
from xihenet.colour import LINEAR_OF_CODE
from xihenet.phone.settings import Required, Section, SessionFacts, known, number
from xihenet.records import ArrayBool, ArrayF64, RgbdFrame

SMALL_STOPS = 1 / 3  # the smallest step on a camera's exposure dial


@dataclass(frozen=True, kw_only=True)
class FrameRate(Section):
    """Frames per second, and the width of the range sensor's picture, which lengths in pixels refer to."""

    rate_hz: float = number("Hz", 0.1, 1000.0)
    width_px: float = number("px", 1.0, 100000.0)

    def required_by(self, facts: SessionFacts) -> Required:
        rate_hz = known(facts.frame_rate_hz, "the frame rate of the camera path")
        if rate_hz > self.rate_hz:
            return True, f"the path has {rate_hz:g} frames per second, the phone delivers {self.rate_hz:g}"
        return False, f"the phone delivers {self.rate_hz:g} frames per second, the path has {rate_hz:g}"


def delivered_frames(times_s: Sequence[float], settings: FrameRate | None) -> ArrayBool:
    """(N,) which frames of a session at `times_s`, never decreasing, reach the app; all without a frame rate."""
    if settings is None or not len(times_s):
        return np.ones(len(times_s), bool)
    times = np.asarray(times_s, np.float64)
    # A frame a rounding error before its tick still belongs to it; times since 1970 are rounded to 0.2 microseconds.
    rounding = max(1e-6, 2 * float(np.spacing(np.abs(times).max())) * settings.rate_hz)
    ticks = np.floor((times - times[0]) * settings.rate_hz + rounding)
    return np.concatenate([[True], np.diff(ticks) > 0])


@dataclass(frozen=True, kw_only=True)
class AutoExposure(Section):
    """How fast the exposure follows the light, and how far from the session's reference it may go."""

    time_constant_s: float = number("s", 0.0, 60.0)
    darkest_stops: float = number("stops below the reference", 0.0, 20.0)
    brightest_stops: float = number("stops above the reference", 0.0, 20.0)

    def required_by(self, facts: SessionFacts) -> Required:
        stops = known(facts.brightness_change_stops, "how much the brightness changes along the path")
        return stops > SMALL_STOPS, f"along the path the brightness changes by {stops:.1f} stops"


def follow_exposure(
    times_s: Sequence[float], metered: Sequence[float], *, reference: float, settings: AutoExposure
) -> ArrayF64:
    """(N,) the exposure of each frame of a session.

    `times_s` (N,) never decrease; `metered` (N,) is what each frame's own light asks for, as `metered_exposure`
    gives it; clamps lie around `reference`, the session's exposure. The first frame is metered well (a phone's preview
    ran before); each later one only knows the frames before it. ValueError for exposures that are not positive and
    finite, and if time runs backwards.
    """
    if len(times_s) != len(metered):
        raise ValueError(f"follow_exposure: expected as many times as meterings, got {len(times_s)} and {len(metered)}")
    if not all(math.isfinite(e) and e > 0 for e in (*metered, reference)):
        raise ValueError(f"follow_exposure: expected positive exposures, got {list(metered)!r:.80} and {reference}")
    if not (np.diff(times_s) >= 0).all():
        raise ValueError(f"follow_exposure: expected times that never decrease, got {list(times_s)!r:.80} s")
    exposures: ArrayF64 = np.array([_clamped(wanted, reference, settings) for wanted in metered], np.float64)
    targets = exposures.tolist()
    for i in range(1, len(targets)):
        elapsed_s = times_s[i] - times_s[i - 1]
        left = math.exp(-elapsed_s / settings.time_constant_s) if settings.time_constant_s else 0.0
        followed = targets[i - 1] * math.pow(exposures[i - 1] / targets[i - 1], left)
        exposures[i] = _clamped(followed, reference, settings)
    return exposures


def expose(frame: RgbdFrame, exposure: float, radiance: ArrayLike | None = None) -> RgbdFrame:
    """The frame as it is taken at `exposure`; at its own exposure the frame itself.

    With `radiance` (H, W, 3), linear and scene-referred, this is exact. Without it the 8-bit picture is decoded: what
    was clipped stays clipped, and brightening shows 8-bit steps.
    """
    if exposure == frame.exposure:
        return frame
    if radiance is not None:
        return replace(frame, srgb_u8=encode_exposed(radiance, exposure), exposure=exposure)
    light_of_byte = LINEAR_OF_CODE / frame.exposure
    return replace(frame, srgb_u8=encode_exposed(light_of_byte, exposure)[frame.srgb_u8], exposure=exposure)


def _clamped(exposure: float, reference: float, settings: AutoExposure) -> float:
    lowest = reference * math.pow(2.0, -settings.darkest_stops)
    return min(max(exposure, lowest), reference * math.pow(2.0, settings.brightest_stops))
