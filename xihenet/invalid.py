"""Invalid data: what became of it, and why? Counts by reason, which travel with the records.

Nothing that is left out or clamped goes unnamed: a frame, a cloud and a step each carry how many of their pixels or
points it befell, by one of these reasons or by the name of the phone's effect that took a pixel. Reasons without a
count are absent, so an empty mapping says that all was sound. Chosen: a plain mapping, which can be summed up and
written as JSON. Rejected: warnings where it happens, which nobody adds up, and a mask for each reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

Counts = Mapping[str, int]  # How many, by reason; none is 0
Number = TypeVar("Number", int, float)

LEFT_OUT: Mapping[str, str] = {
    "no_surface": "no surface there: open sky, a window, fog or smoke, or beyond the camera's clip end",
    "no_distance": "no distance was measured: a plane depth of 0 or less",
    "low_confidence": "the sensor itself says that its distance is not to be trusted",
    "not_finite": "a plane depth or a position that is NaN or infinite",
    "colour_not_finite": "a colour that is NaN or infinite",
    "at_probe": "the point lies at the estimation position itself and has no direction",
    "too_far": "too far from the estimation position for 32-bit numbers",
    "colour_without_distance": "a colour sent without a distance",
}
"""Why pixels and points are left out; the phone's effects are reasons of their own, by their names."""

CLAMPED: Mapping[str, str] = {
    "negative_colour": "light below 0, such as that of a negative lamp, replaced by black",
    "infinite_colour": "an infinite colour, replaced by white",
    "distance_on_wire": "a distance that the wire format cannot hold, replaced by the nearest that it can",
    "distance_in_network": "a distance beyond the network's range, replaced by the farthest in range",
}
"""What is used, but not as it came."""

UNKNOWN: Mapping[str, str] = {
    "nothing_seen": "no surface was seen from there",
    "no_points": "the frame has no point to draw from",
    "estimate_not_finite": "the estimate was not finite",
    "no_answer": "the edge service did not answer",
}
"""Why the light at a position could not be known."""


def format_reason(reason: str) -> str:
    """Why, in words; a reason that is not listed here is the name of an effect of the phone."""
    return {**LEFT_OUT, **CLAMPED, **UNKNOWN}.get(reason, f"the phone's {reason.replace('_', ' ')}")


def format_unanswered(lights: Counts) -> str:
    """Of estimates whose `lights` could not be known, as a clause: ", 35 of which the edge service did not answer"."""
    n = lights.get("no_answer", 0)
    return f", {n:,} of which the edge service did not answer" if n else ""


def counted(**counts: int) -> dict[str, int]:
    """Those of `counts` that are not 0."""
    return {reason: int(n) for reason, n in counts.items() if n}


def added(each: Iterable[Mapping[str, Number]]) -> dict[str, Number]:
    """The sum by name, such as a reason, in the order in which names first turn up."""
    total: dict[str, Number] = {}
    for one in each:
        for name, n in one.items():
            total[name] = total.get(name, 0) + n
    return total


def left_out(counts: Counts) -> dict[str, int]:
    """Those of `counts` that say how much was left out; what was only clamped is in use."""
    return {reason: n for reason, n in counts.items() if reason not in CLAMPED}


def n_left_out(counts: Counts) -> int:
    """How much was left out in all."""
    return sum(left_out(counts).values())
