"""Frames that the phone delivers of those that a scene has.

A scene may be animated at any rate; a phone delivers at its own. Chosen: of each interval of the phone's clock the
first frame of the scene, so that nothing is invented. Rejected: blending frames, which no range sensor does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from xihenet.phone.settings import Required, Section, SessionFacts, known, number
from xihenet.records import ArrayBool


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
    # A frame a rounding error before its tick still belongs to it.
    ticks = np.floor((np.asarray(times_s, np.float64) - times_s[0]) * settings.rate_hz + 1e-6)
    return np.concatenate([[True], np.diff(ticks) > 0])
