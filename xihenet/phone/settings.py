"""Settings of one effect of the phone, and the facts of a session by which the effect is required or left out.

Settings are one frozen dataclass, a `Section`, whose fields say their own unit and range; making one checks every
field. A profile file's table becomes a section by name alone, so a new setting is one line in one place.
Chosen: the range beside the field. Rejected: a schema file, which would have to be kept in step with the code.

An effect is left out where it moves a point by less than a tenth of the angle between two anchors, as seen from the
nearest estimation position, or takes no pixel away; both follow from its settings. Rejected: thresholds on the
picture's error, which would need a simulation to know whether to simulate. `frame_facts` says where facts come from.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from xihenet.effects import Requirement

SectionT = TypeVar("SectionT", bound="Section")
Known = TypeVar("Known")
Required = tuple[bool, str]  # whether an effect is required, and why, for a lighting artist
SMALL_SHARE = 0.1
"""Of the angle between two anchors: a point that moves less stays with its anchor about nine times out of ten."""


class NotKnownError(Exception):
    """A fact that a rule needs is not known; its effect stays on."""


def known(fact: Known | None, what: str) -> Known:
    """`fact`; NotKnownError that names `what` it is where it is None."""
    if fact is not None:
        return fact
    raise NotKnownError(f"it is not known {what}" if what.startswith(("how", "whether")) else f"{what} is not known")


@dataclass(frozen=True)
class SessionFacts:
    """What is known of a session, over all its frames; None for what is not."""

    frame_rate_hz: float | None = None  # of the camera path
    duration_s: float | None = None  # first to last frame
    n_anchors: int = 1280  # of the estimates
    focal_px: float | None = None  # of the capture, the longer of the two
    nearest_m: float | None = None  # plane depth of any surface in view
    farthest_m: float | None = None  # the same
    clearance_m: float | None = None  # from an estimation position to the nearest surface in view
    fastest_m_per_s: float | None = None  # of the camera
    fastest_turn_deg_per_s: float | None = None  # of the camera
    widest_step_m: float | None = None  # largest step of plane depth between neighbouring pixels
    darkest_grey: float | None = None  # of the pictures (sRGB-encoded), or of materials where the sensor goes by these
    smoothest_roughness: float | None = None  # of any material in view; 1 where none is smooth
    highest_transmission: float | None = None  # of any material in view; 0 where none is clear
    steepest_deg: float | None = None  # largest angle between a surface in view and the camera facing it
    brightness_change_stops: float | None = None  # largest less smallest exposure that the frames ask for
    light_changes: bool | None = None  # whether any light is animated, driven or switched

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
        """Whether `what`, which moves points `by_m`, takes any from its anchor."""
        if by_m == 0:
            return False, f"{what} is none"
        clearance_m = known(self.clearance_m, "how near surfaces come to the virtual objects")
        words = f"{what} moves points by up to {1e3 * by_m:.1f} mm, {clearance_m:.2f} m from a virtual object"
        return (True, words) if by_m > self.small_angle * clearance_m else (False, words + ": too little to see")

    def has_step_over(self, span_m: float) -> Required:
        """Whether one thing stands further than `span_m` before another."""
        step_m = known(self.widest_step_m, "whether one object stands before another")
        if step_m > span_m:
            return True, f"things stand up to {step_m:.1f} m before what is behind them"
        return False, f"nothing stands more than {span_m:g} m before what is behind it"


def number(unit: str, low: float, high: float, *, kind: type = float) -> Any:
    """A field that holds a finite number from `low` to `high`, in `unit`; a whole one if `kind` is int."""
    what = "whole number" if kind is int else "number"
    expected = f"a {what} from {low:g} to {high:g} {unit}".rstrip()
    return field(metadata={"kind": kind, "expected": expected, "low": low, "high": high})


def text() -> Any:
    return field(metadata={"kind": str, "expected": "some text"})


def switch() -> Any:
    return field(metadata={"kind": bool, "expected": "true or false"})


@dataclass(frozen=True, kw_only=True)
class Section:
    """Settings of one sensor effect; making one raises ValueError naming the field that is wrong."""

    # Where the numbers come from, or that they were chosen and why.
    source: str = text()

    def __post_init__(self) -> None:
        for part in dataclasses.fields(self):
            object.__setattr__(self, part.name, _checked(part.name, getattr(self, part.name), part.metadata))

    def required_by(self, facts: SessionFacts) -> Required:
        """Whether a session of such `facts` shows the effect, and why; NotKnownError where a fact is missing."""
        raise NotImplementedError

    def requirement(self, facts: SessionFacts) -> Requirement:
        """The same for the planner; what is not known is required."""
        parts = (part for part in dataclasses.fields(self) if part.metadata["kind"] is not str)
        numbers = {part.name: getattr(self, part.name) for part in parts}
        try:
            is_required, reason = self.required_by(facts)
        except NotKnownError as error:
            is_required, reason = True, str(error)
        return Requirement(is_required, reason, numbers, numbers)


def section_from_table(kind: type[SectionT], table: object) -> SectionT:
    """The section that a table of a TOML file describes; ValueError names the key that is unknown, missing or wrong."""
    if not isinstance(table, Mapping):
        raise ValueError(f"expected a table of settings, got {table!r:.80}")
    names = sorted(part.name for part in dataclasses.fields(kind))
    for key in table:
        if key not in names:
            raise ValueError(f"{key}: there is no such setting; expected {', '.join(names)}")
    for key in names:
        if key not in table:
            raise ValueError(f"{key}: this setting is missing")
    return kind(**table)


def _checked(name: str, value: object, rule: Mapping[str, Any]) -> object:
    kind, wrong = rule["kind"], f"{name}: expected {rule['expected']}, got "
    is_blank = isinstance(value, str) and not value.strip()
    is_of_kind = isinstance(value, (int, float) if kind is float else kind)
    if is_blank or not is_of_kind or isinstance(value, bool) != (kind is bool):
        raise ValueError(f"{wrong}{value!r:.80}")
    # In this order: a whole number may be too long for a float, and NaN is in no range.
    if "low" in rule and not rule["low"] <= value <= rule["high"]:
        raise ValueError(wrong + str(value)[:20])
    return kind(value)
