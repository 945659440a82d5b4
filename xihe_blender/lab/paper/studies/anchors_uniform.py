"""Evenly spread anchors beside the same number on a grid of latitude and longitude."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from xihe_blender.errors import UserError
from xihe_blender.lab.paper.clouds import views, walk_errors, with_truth
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio, of_rooms
from xihenet.metrics import shc_rmse
from xihenet.records import ArrayF64, ArrayInt
from xihenet.sh import project_anchors
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

ROWS, COLUMNS = 32, 40
N_ANCHORS = ROWS * COLUMNS
N_ACROSS = 2000
AREA = "The paper shows one picture of each and no figure. Here it is the spread of the anchors' shares of the sphere."
COMPLETENESS = (
    "The paper's completeness is the share of anchors that are set, which is a share of the sphere only for even "
    "anchors."
)
WHOLE = "All of an order-2 light is seen, and each anchor has the same weight, which is right for even anchors."
ERROR = "Regularised least squares on the set anchors of all frames, for both alike."


@dataclass(frozen=True)
class GridAnchors(AnchorLattice):
    """Anchors at the middle of the cells of a grid over polar angle and azimuth: dense at the poles."""

    n: int = N_ANCHORS

    @property
    def directions(self) -> ArrayF64:
        polar = np.repeat(np.pi * (np.arange(ROWS) + 0.5) / ROWS, COLUMNS)
        azimuth = np.tile(2 * np.pi * np.arange(COLUMNS) / COLUMNS, ROWS)
        across = np.sin(polar)
        return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(polar)], axis=1)

    def nearest_to_columns(self, columns: NDArray[Any], *_: Any, **__: Any) -> ArrayInt:
        """The anchor of the largest cosine: in the nearest column, and in the row of the direction or one beside it."""
        known = np.nan_to_num(columns)
        polar = np.arctan2(np.hypot(known[0], known[1]), known[2])
        column = np.rint(np.arctan2(known[1], known[0]) * COLUMNS / (2 * np.pi)).astype(np.intp) % COLUMNS
        row = (polar * ROWS / np.pi).astype(np.intp)
        candidates = np.clip([row - 1, row, row + 1], 0, ROWS - 1) * COLUMNS + column
        best = np.einsum("kpi,ip->kp", self.directions[candidates], known).argmax(axis=0)
        return np.asarray(np.take_along_axis(candidates, best[None], axis=0)[0])


ANCHORS: dict[str, AnchorLattice] = {"even": AnchorLattice(N_ANCHORS), "grid": GridAnchors()}


def areas(lattice: AnchorLattice, rng: np.random.Generator) -> ArrayF64:
    """(n,) the share of the sphere that is nearest to each anchor, by a random direction in each of equal cells."""
    across, height = rng.random((2, N_ACROSS, N_ACROSS)) + np.indices((N_ACROSS, N_ACROSS))
    counts = np.zeros(lattice.n)
    for azimuth, z in zip(2 * np.pi * across / N_ACROSS, 2 * height / N_ACROSS - 1, strict=True):
        from_axis = np.sqrt(1 - z * z)
        columns = np.stack([from_axis * np.cos(azimuth), from_axis * np.sin(azimuth), z])
        counts += np.bincount(lattice.nearest_to_columns(columns), minlength=lattice.n)
    return np.asarray(counts / N_ACROSS**2)


def relative_spread(shares: NDArray[Any]) -> float:
    """Standard deviation over mean."""
    return float(shares.std() / shares.mean())


def equally_weighted(light: ArrayLike, lattice: AnchorLattice) -> ArrayF64:
    """(9, 3) what anchors of equal weight make of light of order 2."""
    table = basis(lattice.directions)
    return np.asarray(4 * np.pi / lattice.n * table.T @ (table @ np.asarray(light)))


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    steady, rng = with_truth(sessions), options.rng
    found = list(views(sessions, 8 if options.quick else 40))
    if len(found) < 2 or sum(len(session.places) for session in steady) < 2:
        raise UserError("rooms whose light stands still have fewer than two places in view: give more --scenes")
    seen_in = [view.room for view in found]
    own = {name: areas(lattice, rng) for name, lattice in ANCHORS.items()}
    rooms = [session.name for session in steady for _ in session.places]
    lights = [place.true_ldr for session in steady for place in session.places]
    for name, lattice in ANCHORS.items():
        spread = measured(own[name], rng, statistic=relative_spread)
        what = f"{name}: spread of area over mean"
        yield Row(what, "of the mean", *spread, "cannot be compared", AREA, cases="anchors")
        clouds = [view.cloud(lattice) for view in found]
        off = [100 * abs(cloud.is_set.mean() - own[name][cloud.is_set].sum()) for cloud in clouds]
        wrong = measured(off, rng, groups=seen_in)
        what = f"{name}: share of set anchors off the share of the sphere"
        cases = of_rooms("views", seen_in)
        yield Row(what, "percentage points", *wrong, "cannot be compared", COMPLETENESS, cases=cases)
        errors = measured([shc_rmse(equally_weighted(one, lattice), one) for one in lights], rng, groups=rooms)
        what = f"{name}: all seen, equal weights"
        yield Row(what, "SHC RMSE", *errors, "cannot be compared", WHOLE, cases=of_rooms("places", rooms))
    even, grid = (walk_errors(steady, one, partial(project_anchors, lattice=one)) for one in ANCHORS.values())
    ratio = measured_ratio(grid, even, rng, groups=rooms)
    what = "grid over even, error of the walk"
    yield Row(what, "times", *ratio, "cannot be compared", ERROR, cases=of_rooms("places", rooms))


STUDY = Study(
    "anchors_uniform",
    "Even anchors, and a grid",
    60,
    "The paper shows the anchors of one view, evenly spread and grouped, and chooses even ones, since completeness "
    "depends on them.",
    measure,
)
