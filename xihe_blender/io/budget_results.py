"""The results of an error budget: what budget.json says, and what would help an object most, in words.

What is said of a part is no more than its interval over several seeds allows: one whose interval holds 0 may help or
harm, and has no place in the order; of two whose intervals overlap nobody can say which is larger.

Errors are root mean squares of what a satin ball shows (`xihenet.satin_ball`), in radiance at the session's exposure.
Strict JSON: no NaN and no Infinity.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from xihe_blender.errors import UserError
from xihe_blender.io.json_records import read_record
from xihe_blender.io.path_results import PathResults
from xihenet.formats import format_percent

LEAST_HELP = 0.05
"""Of an object's error: a part that would take off less is not recommended."""


@dataclass(frozen=True)
class PartWords:
    """How a part of the budget is named, and what a perfect one would be."""

    label: str
    perfect: str


PARTS = {
    "field_of_view": PartWords("Field of view", "a phone that looks in all directions along its path"),
    "coverage": PartWords("Coverage", "seeing the room from the object itself, with nothing hidden"),
    "sensor": PartWords("Range sensor", "a phone that measures distances and poses without errors"),
    "clipping": PartWords("Clipping at white", "pictures in which nothing is clipped at white"),
    "hidden_lamps": PartWords("Lamps no camera sees", "knowing the light of the lamps that no camera sees"),
    "sampling": PartWords("Sampling", "keeping in each direction the mean of what is there, not the nearest point"),
    "network": PartWords("Network", "a network that makes no error of its own"),
    "delay": PartWords("Delay", "estimates that arrive at once, in every frame"),
    "order_2": PartWords("Order 2", "light of more than nine coefficients"),
}
"""By name in budget.json, in the order in which light goes through them."""


@dataclass(frozen=True, kw_only=True)
class BudgetPart:
    """One part of the chain, switched to perfect while all else stays as it was."""

    name: Annotated[
        str, "one of field_of_view, coverage, sensor, clipping, hidden_lamps, sampling, network, delay, order_2"
    ]
    state: Annotated[Literal["measured", "not simulated"], "not simulated: the phone of this session has no such error"]
    error: Annotated[float, "that is left of the object's error then"]
    gain: Annotated[float, "by how much that is less; below 0 where a perfect part makes it worse"]
    interval: Annotated[
        tuple[float, float] | None, "95 % confidence interval of that over seeds; none of a single seed"
    ] = None

    @property
    def low(self) -> float:
        """The least that the gain may be; of a single seed the gain itself."""
        return self.interval[0] if self.interval else self.gain

    @property
    def high(self) -> float:
        """The most."""
        return self.interval[1] if self.interval else self.gain

    @property
    def is_certain(self) -> bool:
        """Whether it is known to help, or to harm: the interval leaves 0 out. A single seed is taken at its word."""
        return self.interval is None or self.low > 0 or self.high < 0

    def is_apart_from(self, other: BudgetPart) -> bool:
        """Whether one is known to be larger: the intervals do not overlap. A single seed is taken at its word."""
        return self.interval is None or self.low > other.high or other.low > self.high


@dataclass(frozen=True, kw_only=True)
class ObjectBudget:
    """The error of one object and what it comes from. Parts overlap: their gains do not add up to the error."""

    name: str
    moments: Annotated[tuple[int, ...], "frames in which errors were measured; none: it was never in view"]
    brightness: Annotated[float | None, "root mean square of what a satin ball shows there"] = None
    error: Annotated[float | None, "of that under the estimated light"] = None
    least_squares_error: Annotated[float | None, "with the estimator `projection` instead of the one chosen"] = None
    parts: tuple[BudgetPart, ...] = ()

    @property
    def largest_first(self) -> list[BudgetPart]:
        """The parts that were measured, by what they would take off; those that may as well harm come last."""
        measured = [part for part in self.parts if part.state == "measured"]
        return sorted(measured, key=lambda part: (not part.is_certain, -part.gain))

    @property
    def best(self) -> list[BudgetPart]:
        """The part that would help most, and those that may help as much; none if none would surely help."""
        certain = [part for part in self.largest_first if part.is_certain]
        worth = [part for part in certain if part.gain > LEAST_HELP * (self.error or 0.0)]
        return [part for part in worth if part is worth[0] or not part.is_apart_from(worth[0])]

    def relative(self, error: float) -> float:
        """`error` as a share of the brightness."""
        return error / self.brightness if self.brightness else 0.0

    @property
    def advice(self) -> str:
        """What would help most, in a sentence."""
        if self.error is None:
            return f"Nothing is known of the error of {self.name}, which was never in view."
        if not self.brightness:
            return f"No light reaches {self.name}, so that its light has no error to divide."
        now = format_percent(self.relative(self.error))
        if not self.best:
            surely = "surely " if self._may_help_more(0.0) else ""
            return f"No single part would {surely}help {self.name} much: its light is off by {now} of its brightness."
        perfect = ", or ".join(PARTS[part.name].perfect for part in self.best)
        then = " or ".join(dict.fromkeys(format_percent(self.relative(part.error)) for part in self.best))
        falls = f"its error would fall from {now} to {then} of its brightness."
        doubts = ["Which of them helps more is not certain."] if len(self.best) > 1 else []
        *some, last = ["", *(PARTS[part.name].label.lower() for part in self._may_help_more(self.best[0].low))]
        open_ones = " or ".join(filter(None, [", ".join(some[1:]), last]))
        doubts += [f"Whether {open_ones} would help more is not certain."] if open_ones else []
        return " ".join([f"What would help {self.name} most is {perfect}: {falls}", *doubts])

    def _may_help_more(self, gain: float) -> list[BudgetPart]:
        """The parts without a place in the order that may take off more than `gain`, and more than is not worth it."""
        least = max(gain, LEAST_HELP * (self.error or 0.0))
        return [part for part in self.largest_first if not part.is_certain and part.high > least]


@dataclass(frozen=True, kw_only=True)
class BudgetResults(PathResults):
    """The content of budget.json."""

    objects: tuple[ObjectBudget, ...]


def read_budget(folder: Path) -> BudgetResults:
    """The error budget in `folder`, anew where the file changed; UserError if none that this version wrote."""
    file = folder / "budget.json"
    try:
        return _read(file, file.stat().st_mtime_ns)
    except (OSError, TypeError, ValueError) as error:
        raise UserError(f"{file} cannot be read ({error}): measure the error budget again") from error


@functools.lru_cache(maxsize=4)
def _read(file: Path, _changed_ns: int) -> BudgetResults:
    return read_record(BudgetResults, file)
