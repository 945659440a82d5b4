"""A figure that can be trusted: a number with its unit, its interval, its cases, and what it is held against.

A `Study` is one table or figure of the paper; measuring it yields rows, so that long ones can be stopped between two. A
`Session` is what studies measure on: a walk through a room as a phone recorded it, and the true light at places there.
Nothing here needs Blender.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihenet.formats import format_count
from xihenet.paired import expanded_tail
from xihenet.records import ArrayF32, ArrayF64, RgbdFrame

Work = Literal["same work", "other data", "other machine", "cannot be compared"]
N_DRAWS = 2000
DRAWN_AT_ONCE = 2**18  # Cases, so that many of them take little memory
OF_ROWS: tuple[Callable[..., Any], ...] = (np.mean, np.median, np.std)  # Asked of all draws at once


class Measured(NamedTuple):
    """A figure, its 95 % interval, and of how many cases it is."""

    value: float
    low: float
    high: float
    n: int


@dataclass(frozen=True)
class Row:
    """One figure of a study; ValueError where it lacks what makes it one.

    Parameters
    ----------
    what : was measured, in words of its own; "line: column" where it stands in a table of the documentation
    unit : of all four numbers; "share" and "ratio" are units
    value, low, high : and the 95 % interval, which holds it; what is counted and not drawn has no width
    n : number of cases
    work : how the figure stands beside the paper's: the "same work"; the same on "other data", or on an "other
        machine"; or one that "cannot be compared"
    sentence : what is the same and what is not
    paper : the paper's figure in the same unit; None where it has none
    cases : what was counted: "rooms", "pairs"
    series, at : line and place across in the study's drawing; without a series it is in none
    is_detail : one of many, such as a point of a curve: in the report, and not on the page of the documentation
    """

    what: str
    unit: str
    value: float
    low: float
    high: float
    n: int
    work: Work
    sentence: str
    paper: float | None = None
    cases: str = "cases"
    series: str = ""
    at: float | None = None
    is_detail: bool = False

    def __post_init__(self) -> None:
        is_complete = self.what and self.unit and self.sentence and bool(self.series) == (self.at is not None)
        is_held = self.n > 0 and self.low <= self.value <= self.high and math.isfinite(self.high - self.low)
        if not is_complete or not is_held:
            raise ValueError(f"Row {self.what!r}: expected words, a unit and an interval that holds it, got {self}")


@dataclass(frozen=True)
class StudyOptions:
    """How a study is run.

    Parameters
    ----------
    quick : whether all studies together are to take minutes and not hours
    seed : of all that is random
    folder : where the study may leave pictures (.png), which the report shows by name
    """

    quick: bool
    seed: int
    folder: Path

    @property
    def rng(self) -> np.random.Generator:
        """A new one, always the same."""
        return np.random.default_rng(self.seed)


@dataclass(frozen=True, eq=False)
class Place:
    """Where the light of a room is asked for: (3,) world, metres.

    `ldr` and `hdr` are the true light there, (9, 3) each, clipped at white and all of it, at the session's exposure;
    None in a session whose light changes. `spheres` (S, 3 S, 3) are a mirror, a matte silver and a diffuse one there,
    path-traced, at that exposure.
    """

    name: str
    position_m: ArrayF64
    ldr: ArrayF64 | None = None
    hdr: ArrayF64 | None = None
    spheres: ArrayF32 | None = None

    @property
    def true_ldr(self) -> ArrayF64:
        """ValueError where the truth is not known."""
        if self.ldr is None:
            raise ValueError(f"{self.name}: the true light is not known here")
        return self.ldr


@dataclass(frozen=True, eq=False)
class Session:
    """A walk through a room.

    Parameters
    ----------
    name : of the room
    frames : in order of time
    exposure : that all light carries
    places : where the light is asked for
    blend_file : of the room; None for one that was made in memory
    capture_change : the trigger's change between two captures of one and the same view, which is render noise
    n_between : frames that each of the file's was recorded as, see `open_walk`
    """

    name: str
    frames: Sequence[RgbdFrame]
    exposure: float
    places: Sequence[Place]
    blend_file: Path | None = None
    capture_change: float | None = None
    n_between: int = 1

    @property
    def has_truth(self) -> bool:
        return bool(self.places) and all(place.ldr is not None for place in self.places)


Measure = Callable[[Sequence[Session], StudyOptions], Iterable[Row]]


@dataclass(frozen=True)
class Study:
    """One table or figure of the paper.

    Parameters
    ----------
    name : as it is typed, and of its files
    title : in words
    place : in the order of the paper
    paper_did : what the paper did, in a sentence or two
    measure : yields the rows
    across, up : names of the axes of its drawing, with units; empty for a study without
    caption : of its pictures
    needs_rooms : whether it is measured on sessions; else they are not recorded for it alone
    """

    name: str
    title: str
    place: int
    paper_did: str
    measure: Measure
    across: str = ""
    up: str = ""
    caption: str = ""
    needs_rooms: bool = True


@dataclass(frozen=True)
class StudyResult:
    """The file of a study: its rows, or in one sentence why there are none."""

    name: str
    made_from: str
    measured_on: str
    elapsed_s: float
    machine: str
    rows: tuple[Row, ...] = ()
    failed_because: str = ""


def measured(
    cases: ArrayLike,
    rng: np.random.Generator,
    *,
    groups: Sequence[Hashable] | None = None,
    statistic: Callable[..., Any] = np.mean,
) -> Measured:
    """`statistic` of the N cases, rows of an array, and its interval by bootstrap.

    Cases of one of the `groups`, such as the frames of one room, are drawn together; one group alone is drawn case by
    case, which says nothing of other rooms. Fewer than two cases have no interval: ValueError. Percentiles are moved
    outwards as in `xihenet.paired`, and the interval always holds the value.
    """
    rows = np.asarray(cases)
    if len(rows) < 2 or (groups is not None and len(groups) != len(rows)):
        raise ValueError(f"measured: expected two cases or more and a group for each, got {len(rows)}")
    numbers = {group: number for number, group in enumerate(dict.fromkeys(groups or ()))}
    drawn = np.array([numbers[group] for group in groups]) if groups and len(numbers) > 1 else np.arange(len(rows))
    n_drawn = int(drawn.max()) + 1
    members = [np.flatnonzero(drawn == number) for number in range(n_drawn)]
    values: list[float] = []
    for n_draws in map(len, np.array_split(np.arange(N_DRAWS), -(-N_DRAWS * n_drawn // DRAWN_AT_ONCE))):
        draws = rng.integers(n_drawn, size=(n_draws, n_drawn))
        if n_drawn < len(rows):
            values += [statistic(rows[np.concatenate([members[k] for k in draw])]) for draw in draws]
        elif rows.ndim == 1 and statistic in OF_ROWS:
            values += statistic(rows[draws], axis=1).tolist()
        else:
            values += [statistic(rows[draw]) for draw in draws]
    tail, value = expanded_tail(n_drawn), float(statistic(rows))
    low, high = np.quantile(values, [tail, 1 - tail])
    return Measured(value, min(float(low), value), max(float(high), value), len(rows))


def of_rooms(what: str, rooms: Sequence[str]) -> str:
    """Words for the cases of a row: "views of 5 rooms"."""
    return f"{what} of {format_count(len(set(rooms)), 'room')}"


def measured_ratio(
    first: ArrayLike,
    second: ArrayLike,
    rng: np.random.Generator,
    *,
    groups: Sequence[Hashable] | None = None,
    average: Callable[..., NDArray[Any]] = np.mean,
) -> Measured:
    """`measured` of the average of `first` over that of `second`, case by case the same; medians are for times."""
    return measured(np.column_stack([first, second]), rng, groups=groups, statistic=partial(_ratio, average))


def _ratio(average: Callable[..., NDArray[Any]], pairs: NDArray[Any]) -> float:
    first, second = average(pairs, axis=0)
    return float(first / second)
