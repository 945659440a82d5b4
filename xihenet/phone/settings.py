"""Settings of one effect of the phone, how a profile file's table becomes them, and what calls for the effect.

They are one frozen dataclass, a `Section`, whose fields say their own unit and range; making one checks every field. A
profile file's table becomes a section by name alone, so a new setting is one line in one place.
Chosen: the range beside the field. Rejected: a schema file, which would have to be kept in step with the code.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from xihenet.effects import Requirement
from xihenet.phone.facts import NotKnownError, Required, SessionFacts

SectionT = TypeVar("SectionT", bound="Section")


def number(unit: str, low: float, high: float) -> Any:
    """A field that holds a finite number from `low` to `high`, in `unit`."""
    return field(metadata={"kind": float, "unit": unit, "low": low, "high": high})


def count(low: int, high: int) -> Any:
    """A field that holds a whole number from `low` to `high`."""
    return field(metadata={"kind": int, "unit": "", "low": low, "high": high})


def switch() -> Any:
    """A field that is true or false."""
    return field(metadata={"kind": bool})


@dataclass(frozen=True, kw_only=True)
class Section:
    """Settings of one sensor effect; making one raises ValueError naming the field that is wrong.

    Parameters
    ----------
    source : where the numbers come from, or that they were chosen and why; not empty
    """

    source: str = field(metadata={"kind": str})

    def __post_init__(self) -> None:
        for part in dataclasses.fields(self):
            object.__setattr__(self, part.name, _checked(part.name, getattr(self, part.name), part.metadata))

    def required_by(self, facts: SessionFacts) -> Required:
        """Whether a session of such `facts` shows the effect, and why; NotKnownError where a fact is missing."""
        raise NotImplementedError

    def requirement(self, facts: SessionFacts) -> Requirement:
        """The same for the planner; what is not known is required."""
        numbers = {name: value for name, value in dataclasses.asdict(self).items() if name != "source"}
        try:
            is_required, reason = self.required_by(facts)
        except NotKnownError as error:
            is_required, reason = True, str(error)
        return Requirement(is_required, reason, numbers, numbers)


def section_from_table(kind: type[SectionT], table: object) -> SectionT:
    """The section that `table` (a table of a TOML file) describes.

    ValueError names the key that is unknown, missing, of the wrong type or out of range.
    """
    if not isinstance(table, Mapping):
        raise ValueError(f"expected a table of settings, got {table!r:.80}")
    known = {part.name for part in dataclasses.fields(kind)}
    for key in table:
        if key not in known:
            raise ValueError(f"{key}: there is no such setting; expected {', '.join(sorted(known))}")
    for key in sorted(known):
        if key not in table:
            raise ValueError(f"{key}: this setting is missing")
    return kind(**table)


def _checked(name: str, value: object, rule: Mapping[str, Any]) -> object:
    kind = rule["kind"]
    if kind is str:
        if not isinstance(value, str) or not value.strip():
            raise ValueError(f"{name}: expected some text, got {value!r:.80}")
        return value
    if kind is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{name}: expected true or false, got {value!r:.80}")
        return value
    what = "whole number" if kind is int else "number"
    expected = f"expected a {what} from {rule['low']:g} to {rule['high']:g} {rule['unit']}".rstrip()
    if isinstance(value, bool) or not isinstance(value, int if kind is int else (int, float)):
        raise ValueError(f"{name}: {expected}, got {value!r:.80}")
    # In this order: a whole number may be too long for a float, and NaN is in no range.
    if not rule["low"] <= value <= rule["high"]:
        raise ValueError(f"{name}: {expected}, got {str(value)[:20]}")
    return kind(value)
