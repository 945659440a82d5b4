"""The results of a placement map: what placement.json says. Strict JSON: no NaN and no Infinity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

from xihe_blender.io.path_results import PathResults, Triple

ENOUGH = 20
"""Of verified places: with fewer, chance rules the rank correlation."""

N_EXTREMES = 10
"""Places that are listed as the best, and as the worst."""

Colour = Triple
RAMP: tuple[Colour, ...] = ((46, 134, 222), (236, 226, 198), (214, 48, 49))
"""Red, green and blue, 0 to 255, from the least error to the largest. Nearly everyone tells blue from red."""

UNKNOWN: Colour = (128, 128, 128)


@dataclass(frozen=True, kw_only=True)
class Place:
    """One place, and the light there after the last frame of the path."""

    position_m: Annotated[Triple, "in the world"]
    coverage: Annotated[float, "share of the directions that were seen from there; 0 where it never was in view"]
    expected_error: Annotated[float | None, "SHC RMSE; None where nothing is known, or the estimator expects none"]
    irradiance: Annotated[Triple | None, "upwards, as it is estimated, scene radiance x sr; None: unknown"]
    true_error: Annotated[float | None, "SHC RMSE against a rendered light probe; None without"] = None

    def colour(self, error_range: tuple[float, float]) -> Colour:
        """sRGB, 0 to 255, by where the expected error lies between the two; UNKNOWN where there is none."""
        if self.expected_error is None:
            return UNKNOWN
        low, high = error_range
        along = min(1.0, max(0.0, (self.expected_error - low) / max(high - low, 1e-9))) * (len(RAMP) - 1)
        first = min(int(along), len(RAMP) - 2)
        red, green, blue = (a + (along - first) * (b - a) for a, b in zip(RAMP[first], RAMP[first + 1], strict=True))
        return red, green, blue


@dataclass(frozen=True, kw_only=True)
class Verified:
    """How far the expected error tells the true one, over the places with a rendered light probe."""

    n_places: Annotated[int, "with both errors"]
    rank_correlation: Annotated[float | None, "Spearman's, of expected and true error; None where undefined"]
    interval: Annotated[tuple[float, float] | None, "in which it lies with 95 %, by bootstrap over places"]
    mean_error_of_best: Annotated[float | None, "true error of the ten with the lowest expected error"]
    mean_error_of_worst: Annotated[float | None, "true error of the ten with the highest"]


@dataclass(frozen=True, kw_only=True)
class PlacementResults(PathResults):
    """The content of placement.json."""

    spacing_m: Annotated[float, "between places"]
    clearance_m: Annotated[float | None, "of places above their surface; None for places in free air"]
    n_unknown: Annotated[int, "places that were never in view, or whose light is not known"]
    places: tuple[Place, ...]
    verified: Annotated[Verified | None, "None where nothing was verified"] = None

    @property
    def best_first(self) -> list[Place]:
        """The places with an expected error, in its order."""
        return [self.places[index] for index in best_first(self.places)]


def best_first(places: Sequence[Place]) -> list[int]:
    """Indices of the places with an expected error, in its order."""
    known = [index for index, place in enumerate(places) if place.expected_error is not None]
    return sorted(known, key=lambda index: places[index].expected_error or 0.0)


def error_range(places: Sequence[Place]) -> tuple[float, float]:
    """The least expected error, and one that a place in twenty exceeds: both ends of the map's colours."""
    errors = [places[index].expected_error or 0.0 for index in best_first(places)]
    return (errors[0], errors[int(0.95 * (len(errors) - 1))]) if errors else (0.0, 1.0)
