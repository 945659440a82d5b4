"""Facts of a session by which the phone's effects are required or left out; see `frame_facts` for where they come from.

An effect is left out where it moves a point by less than a tenth of the angle between two anchors, as seen from the
nearest estimation position, or takes no pixel away; both follow from its settings. Rejected: thresholds on the
picture's error, which would need a simulation to know whether to simulate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

Known = TypeVar("Known")
Required = tuple[bool, str]
"""Whether an effect is required, and why, for a lighting artist."""

SMALL_SHARE = 0.1
"""Of the angle between two anchors: a point that moves less stays with its anchor about nine times out of ten."""


class NotKnownError(Exception):
    """A fact that a rule needs is not known; its effect stays on."""


def known(fact: Known | None, what: str) -> Known:
    """`fact`; NotKnownError that names `what` it is where it is None."""
    if fact is None:
        raise NotKnownError(
            f"it is not known {what}" if what.startswith(("how", "whether")) else f"{what} is not known"
        )
    return fact


@dataclass(frozen=True)
class SessionFacts:
    """What is known of a session, over all its frames; None for what is not.

    Parameters
    ----------
    frame_rate_hz : of the camera path
    duration_s : first to last frame
    n_anchors : of the estimates
    focal_px : of the capture, the longer of the two
    nearest_m, farthest_m : plane depth of any surface in view
    clearance_m : from an estimation position to the nearest surface in view
    fastest_m_per_s, fastest_turn_deg_per_s : of the camera
    widest_step_m : largest step of plane depth between neighbouring pixels
    darkest_grey : of the pictures (sRGB-encoded), or of the materials in view, whichever the sensor is judged by
    smoothest_roughness, highest_transmission : of any material in view; 1 and 0 where none is smooth or clear
    steepest_deg : largest angle between a surface in view and the camera facing it
    brightness_change_stops : largest less smallest exposure that the frames ask for
    light_changes : whether any light is animated, driven or switched
    """

    frame_rate_hz: float | None = None
    duration_s: float | None = None
    n_anchors: int = 1280
    focal_px: float | None = None
    nearest_m: float | None = None
    farthest_m: float | None = None
    clearance_m: float | None = None
    fastest_m_per_s: float | None = None
    fastest_turn_deg_per_s: float | None = None
    widest_step_m: float | None = None
    darkest_grey: float | None = None
    smoothest_roughness: float | None = None
    highest_transmission: float | None = None
    steepest_deg: float | None = None
    brightness_change_stops: float | None = None
    light_changes: bool | None = None

    @property
    def small_angle(self) -> float:
        """Radians that a point may move, seen from an estimation position, without any consequence."""
        return SMALL_SHARE * math.sqrt(4 * math.pi / self.n_anchors)

    @property
    def is_still(self) -> bool | None:
        """Whether the camera never moves; None if not known."""
        if self.fastest_m_per_s is None or self.fastest_turn_deg_per_s is None:
            return None
        return self.fastest_m_per_s == 0 and self.fastest_turn_deg_per_s == 0

    def moves_points(self, by_m: float, what: str) -> Required:
        """Whether `what`, which moves points `by_m`, takes any from its anchor, nearest to an estimation position."""
        if by_m == 0:
            return False, f"{what} is none"
        clearance_m = known(self.clearance_m, "how near surfaces come to the virtual objects")
        words = f"{what} moves points by up to {1e3 * by_m:.1f} mm, {clearance_m:.2f} m from a virtual object"
        return (True, words) if by_m > self.small_angle * clearance_m else (False, words + ": too little to see")

    def has_step_over(self, span_m: float) -> Required:
        """Whether one thing stands further than `span_m` before another."""
        step_m = known(self.widest_step_m, "whether one thing stands before another")
        if step_m > span_m:
            return True, f"things stand up to {step_m:.1f} m before what is behind them"
        return False, f"nothing stands more than {span_m:g} m before what is behind it"
