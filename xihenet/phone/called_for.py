"""Which sensor effects can this session show at all, and why?

One pure function for each effect, from facts about the session and the device's settings to on or off with a reason
that a lighting artist understands. A fact that is not known (None) leaves its effect on: leaving out needs proof.

Chosen: an effect is left out where it moves a point by less than a tenth of the angle between two anchors, as seen from
the nearest estimation position, or takes no pixel away; both follow from the settings. Rejected: thresholds on the
picture's error, which would need a simulation to know whether to simulate.
Not here: how the facts are gathered (that needs the scene), and what the light itself does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from xihenet.phone.depth import DistanceNoise, EdgeBleeding, Quantisation, RangeLimits
from xihenet.phone.exposure import AutoExposure
from xihenet.phone.frame_rate import FrameRate
from xihenet.phone.holes import DarkHoles, GlossyHoles, GrazingHoles, SpanHoles, TransparentHoles
from xihenet.phone.light_sensor import LightSensor
from xihenet.phone.motion import PoseDrift, RollingShutter
from xihenet.phone.network import Link
from xihenet.phone.profile import EFFECTS, PhoneProfile

Call = tuple[bool, str]
Choice = Literal["auto", "on", "off"]

SMALL_SHARE = 0.1
"""Of the angle between two anchors: a point that moves less stays with its anchor about nine times out of ten."""

SMALL_SHIFT_PX = 0.5
"""Rows that are off by less than this show the same pixels."""

SMALL_STOPS = 1 / 3
"""The smallest step on a camera's exposure dial."""


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


@dataclass(frozen=True)
class EffectState:
    """Whether an effect is simulated: `state` is on or off, `reason` says why in words."""

    name: str
    state: Literal["on", "off"]
    reason: str


def plan_phone(
    facts: SessionFacts, profile: PhoneProfile, choices: Mapping[str, Choice] | None = None
) -> list[EffectState]:
    """Every effect of EFFECTS in order, with its state and reason; `choices` of the user win over what is called for.

    ValueError for a choice about an unknown effect, one that is not auto, on or off, or on for an effect that the
    device does not have.
    """
    chosen = dict(choices or {})
    unknown = sorted(set(chosen) - set(EFFECTS))
    if unknown:
        raise ValueError(f"plan_phone: there is no effect {', '.join(unknown)}; choose from {', '.join(EFFECTS)}")
    return [_planned(name, facts, profile, chosen.get(name, "auto")) for name in EFFECTS]


def _planned(name: str, facts: SessionFacts, profile: PhoneProfile, choice: Choice) -> EffectState:
    if choice not in ("auto", "on", "off"):
        raise ValueError(f"plan_phone: {name}: expected auto, on or off, got {choice!r}")
    settings = profile.sections.get(name)
    if settings is None:
        if choice == "on":
            raise ValueError(f"plan_phone: {name} cannot be on: {profile.name} does not have it; use another profile")
        return EffectState(name, "off", f"{profile.name} does not have it")
    if choice != "auto":
        return EffectState(name, choice, "set by the user")
    is_called_for, reason = CALLS[name](facts, settings)
    return EffectState(name, "on" if is_called_for else "off", reason)


def calls_for_frame_rate(facts: SessionFacts, settings: FrameRate) -> Call:
    """A path with more frames than the phone delivers."""
    if facts.frame_rate_hz is None:
        return _unknown("the frame rate of the camera path")
    if facts.frame_rate_hz > settings.rate_hz:
        return True, f"the path has {facts.frame_rate_hz:g} frames per second, the phone delivers {settings.rate_hz:g}"
    return False, f"the phone delivers {settings.rate_hz:g} frames per second, the path has {facts.frame_rate_hz:g}"


def calls_for_rolling_shutter(facts: SessionFacts, settings: RollingShutter) -> Call:
    """A camera that moves while the rows are read, by more than SMALL_SHIFT_PX at the nearest surface."""
    if facts.is_still:
        return False, "the camera does not move"
    speed, turn = facts.fastest_m_per_s, facts.fastest_turn_deg_per_s
    if speed is None or turn is None or facts.focal_px is None or not facts.nearest_m:
        return _unknown("how fast the camera moves past the nearest surface")
    shift_px = 0.5 * settings.readout_s * facts.focal_px * (math.radians(turn) + speed / facts.nearest_m)
    if shift_px > SMALL_SHIFT_PX:
        return True, f"while one picture is read the camera moves by up to {shift_px:.1f} pixels"
    return False, f"while one picture is read the camera moves by {shift_px:.2f} pixels at most"


def calls_for_auto_exposure(facts: SessionFacts, settings: AutoExposure) -> Call:
    """Frames that ask for different exposures."""
    if facts.brightness_change_stops is None:
        return _unknown("how much the brightness changes along the path")
    change = f"along the path the brightness changes by {facts.brightness_change_stops:.1f} stops"
    return facts.brightness_change_stops > SMALL_STOPS, change


def calls_for_edge_bleeding(facts: SessionFacts, settings: EdgeBleeding) -> Call:
    """A surface in front of another."""
    return _step(facts, settings.span_m, settings.radius_px > 0)


def calls_for_span_holes(facts: SessionFacts, settings: SpanHoles) -> Call:
    """A surface far in front of another."""
    return _step(facts, settings.span_m, True)


def calls_for_noise(facts: SessionFacts, settings: DistanceNoise) -> Call:
    """Errors that take points to other anchors."""
    if facts.farthest_m is None:
        return _unknown("how far the room goes")
    beyond_m = max(facts.farthest_m - settings.growth_from_m, 0.0)
    sigma_m = settings.sigma_m + settings.growth * beyond_m**settings.growth_power
    if settings.shift_px and facts.widest_step_m is None:
        return _unknown("whether one thing stands before another")
    if settings.shift_px and facts.widest_step_m:
        return True, "things stand before others, and at their edges the sensor mixes the two"
    return _moves_points(facts, 2 * sigma_m, "the sensor's error")


def calls_for_quantisation(facts: SessionFacts, settings: Quantisation) -> Call:
    """Steps that take points to other anchors."""
    return _moves_points(facts, settings.step_m / 2, "rounding")


def calls_for_range(facts: SessionFacts, settings: RangeLimits) -> Call:
    """Surfaces beyond the sensor's reach."""
    if facts.farthest_m is None or facts.nearest_m is None:
        return _unknown("how far the room goes")
    if facts.farthest_m > settings.farthest_m:
        return True, f"the room goes {facts.farthest_m:.1f} m away, the sensor reaches {settings.farthest_m:g} m"
    if facts.nearest_m < settings.nearest_m:
        return True, f"something is {facts.nearest_m:.2f} m away, the sensor begins at {settings.nearest_m:g} m"
    return False, f"everything lies within the sensor's {settings.nearest_m:g} to {settings.farthest_m:g} m"


def calls_for_dark_holes(facts: SessionFacts, settings: DarkHoles) -> Call:
    """Surfaces too dark for the sensor."""
    if facts.darkest_grey is None:
        return _unknown("how dark the darkest surface is")
    if facts.darkest_grey < settings.below_grey:
        return True, f"some surfaces are darker ({facts.darkest_grey:.2f}) than the sensor needs"
    return False, "no surface is too dark for the sensor"


def calls_for_glossy_holes(facts: SessionFacts, settings: GlossyHoles) -> Call:
    """Surfaces that mirror the sensor's light away."""
    if facts.smoothest_roughness is None:
        return _unknown("how glossy the glossiest surface is")
    if facts.smoothest_roughness < settings.below_roughness:
        return True, "there are surfaces that mirror the sensor's light away"
    return False, "no surface in view is glossy enough to mirror the sensor's light away"


def calls_for_transparent_holes(facts: SessionFacts, settings: TransparentHoles) -> Call:
    """Surfaces that the sensor's light goes through."""
    if facts.highest_transmission is None:
        return _unknown("whether anything is transparent")
    if facts.highest_transmission > settings.above_transmission:
        return True, "the sensor's light goes through something in view"
    return False, "no transmissive material is visible to the camera"


def calls_for_grazing_holes(facts: SessionFacts, settings: GrazingHoles) -> Call:
    """Surfaces seen almost from the side."""
    if facts.steepest_deg is None:
        return _unknown("how flat the camera looks along surfaces")
    if facts.steepest_deg > settings.beyond_deg:
        return True, f"some surfaces are turned {facts.steepest_deg:.0f} degrees away from the camera"
    return False, f"no surface is turned more than {settings.beyond_deg:.0f} degrees away from the camera"


def calls_for_pose_drift(facts: SessionFacts, settings: PoseDrift) -> Call:
    """A walk long enough for tracking to be wrong."""
    if facts.is_still:
        return False, "the camera does not move"
    if facts.duration_s is None:
        return _unknown("how long the session is")
    walked = 2 * math.sqrt(facts.duration_s)
    if math.radians(settings.yaw_deg_per_sqrt_s) * walked > facts.small_angle:
        turned_deg = settings.yaw_deg_per_sqrt_s * walked
        return True, f"within {facts.duration_s:.0f} s tracking turns away by up to {turned_deg:.1f} degrees"
    return _moves_points(facts, settings.position_m_per_sqrt_s * walked, "tracking")


def calls_for_light_sensor(facts: SessionFacts, settings: LightSensor) -> Call:
    """Light that changes, which the sensor then follows."""
    if facts.light_changes is None:
        return _unknown("whether any light changes")
    return facts.light_changes, "some light changes" if facts.light_changes else "no light changes"


def calls_for_network(facts: SessionFacts, link: Link | None) -> Call:
    """A link, and something that changes while an estimate is under way."""
    if link is None:
        return False, "the phone estimates by itself"
    if facts.is_still and facts.light_changes is False:
        return False, "neither the camera nor the light changes while an estimate is under way"
    if facts.is_still is None or facts.light_changes is None:
        return _unknown("whether anything changes while an estimate is under way")
    return True, f"estimates arrive some {1e3 * (link.processing_s + link.median_s):.0f} ms after the frame they are of"


def _unknown(what: str) -> Call:
    return True, f"it is not known {what}" if what.startswith(("how", "whether")) else f"{what} is not known"


def _step(facts: SessionFacts, span_m: float, is_active: bool) -> Call:
    if not is_active:
        return False, "the sensor keeps edges sharp"
    if facts.widest_step_m is None:
        return _unknown("whether one thing stands before another")
    if facts.widest_step_m > span_m:
        return True, f"things stand up to {facts.widest_step_m:.1f} m before what is behind them"
    return False, f"nothing stands more than {span_m:g} m before what is behind it"


def _moves_points(facts: SessionFacts, by_m: float, what: str) -> Call:
    """`by_m` against the nearest surface around an estimation position."""
    if by_m == 0:
        return False, f"{what} is none"
    if facts.clearance_m is None:
        return _unknown("how near surfaces come to the virtual objects")
    words = f"{what} moves points by up to {1e3 * by_m:.1f} mm, {facts.clearance_m:.2f} m from a virtual object"
    if by_m > facts.small_angle * facts.clearance_m:
        return True, words
    return False, words + ": too little to see"


CALLS: Mapping[str, Callable[[SessionFacts, Any], Call]] = {
    "frame_rate": calls_for_frame_rate,
    "rolling_shutter": calls_for_rolling_shutter,
    "auto_exposure": calls_for_auto_exposure,
    "edge_bleeding": calls_for_edge_bleeding,
    "noise": calls_for_noise,
    "range": calls_for_range,
    "quantisation": calls_for_quantisation,
    "dark_holes": calls_for_dark_holes,
    "glossy_holes": calls_for_glossy_holes,
    "transparent_holes": calls_for_transparent_holes,
    "grazing_holes": calls_for_grazing_holes,
    "span_holes": calls_for_span_holes,
    "pose_drift": calls_for_pose_drift,
    "light_sensor": calls_for_light_sensor,
}
