"""The results of `xihe look`: what look.json says. Strict JSON: no NaN and no Infinity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from xihe_blender.io.path_results import PathResults, Triple
from xihenet.formats import format_percent

MOST_FROM_BEHIND = 0.4
"""Of an object that stands free; up to 0.28 at 124 places of two furnished rooms, 0.56 in a closed box there."""


@dataclass(frozen=True, kw_only=True)
class LookAway:
    """One second of looking away from the path."""

    frame: Annotated[int, "of the path, at which the phone turns"]
    words: Annotated[str, "where to, such as 'up left', seen from the phone"]
    yaw_deg: Annotated[float, "to the left of the path's heading"]
    pitch_deg: Annotated[float, "above the horizon"]
    turn_deg: Annotated[float, "of the phone, there"]
    hold_s: Annotated[float, "for which it looks there"]
    whole_s: Annotated[float, "with the turn there and back"]
    place_m: Annotated[Triple, "of the phone, in the world"]
    direction: Annotated[Triple, "in which it looks, in the world, unit"]


@dataclass(frozen=True, kw_only=True)
class TrueErrors:
    """SHC RMSE against a rendered light probe at the object, mean over its estimation positions."""

    before: Annotated[float, "after the path alone"]
    after: Annotated[float, "after the path with the advised look, which was rendered"]
    coverage_after: Annotated[float, "share of the directions that were seen then"]
    random_after: Annotated[tuple[float, ...], "after the path with one random look, each"] = ()
    random_looks: tuple[LookAway, ...] = ()

    @property
    def lowered(self) -> float:
        """The share of the error that the advised look took away."""
        return 1 - self.after / self.before if self.before > 0 else 0.0

    @property
    def lowered_by_random(self) -> float | None:
        """The same of the mean random look; None without one."""
        if not self.random_after or self.before <= 0:
            return None
        return 1 - sum(self.random_after) / len(self.random_after) / self.before


@dataclass(frozen=True, kw_only=True)
class ObjectAdvice:
    """What to do for one virtual object, or for all places of the map."""

    name: str
    positions_m: Annotated[tuple[Triple, ...], "estimation positions, in the world"]
    coverage: Annotated[float, "share of the directions that the path shows, mean over the positions"]
    from_behind: Annotated[float, "share of those directions whose surface turns its unseen side to the object"]
    expected_error: Annotated[float | None, "SHC RMSE after the path; None where the estimator expects none"]
    look: Annotated[LookAway | None, "None where no look would add much"]
    gain: Annotated[float, "share of the likely light that the best look would show newly"]
    predicted_coverage: Annotated[float, "after the look"]
    predicted_error: Annotated[float | None, "SHC RMSE expected after the look, with guessed colours"]
    true_errors: Annotated[TrueErrors | None, "None where nothing was rendered to find out"] = None

    @property
    def in_short(self) -> str:
        """Such as "look up left at frame 12"."""
        return "no look would add much" if self.look is None else f"look {self.look.words} at frame {self.look.frame}"

    @property
    def sentence(self) -> str:
        """Such as "look up left for 1 second at frame 12: ..."."""
        if self.from_behind < MOST_FROM_BEHIND:
            return self._advised
        share = f"{format_percent(self.from_behind)} of the surfaces seen around the object turn their back to it"
        seems = "so the camera or the object seems to be inside or behind something"
        return f"{self._advised}. Check the places: {share}, {seems}"

    @property
    def _advised(self) -> str:
        if self.look is None:
            closer = ". Lead the path around the object or closer to it, or move the object"
            instead = closer if self.coverage < 0.5 else ""
            seen = f"it shows {format_percent(self.coverage)} of all directions"
            return f"no look away from this path would add much: {seen}{instead}"
        look = self.look
        seconds = f"{look.hold_s:g} second{'' if look.hold_s == 1 else 's'}"
        said = (
            f"look {look.words} for {seconds} at frame {look.frame}, {look.whole_s:.1f} s with the turns. The share of "
        )
        rise = f"{format_percent(self.coverage)} to {format_percent(self.predicted_coverage)}"
        said += f"directions that are seen rises from {rise}"
        if self.expected_error is not None and self.predicted_error is not None:
            now, then = f"{self.expected_error:.3f}", f"{self.predicted_error:.3f}"
            if self.predicted_error < self.expected_error and now != then:
                falls = f"the expected error falls from {now} to {then}"
                return f"{said}, and {falls} if the new ones have the light that was guessed"
            said += f", but the estimator expects no smaller error than {now}"
        return said


@dataclass(frozen=True, kw_only=True)
class LookResults(PathResults):
    """The content of look.json."""

    objects: tuple[ObjectAdvice, ...]
