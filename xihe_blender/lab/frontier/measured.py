"""What was measured of one choice on one front, before anyone judges it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Measured:
    """A choice, its errors and its time.

    Parameters
    ----------
    label : the choice in words
    settings : the choice as frontier.json names it
    square_errors : squared errors by kind, one for each place; another number of places for another kind
    times_ms : processor time of a frame, one for each round; see `timing`
    preset : whose choice it is, or None
    """

    label: str
    settings: Mapping[str, Any]
    square_errors: Mapping[str, Sequence[float]]
    times_ms: Sequence[float]
    preset: str | None = None

    def as_json(self) -> dict[str, Any]:
        """For `Measured(**...)`."""
        return asdict(self)
