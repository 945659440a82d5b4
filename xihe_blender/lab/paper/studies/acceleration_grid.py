"""A table over angles: how many points go to another anchor than the nearest, and does the light suffer?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from xihe_blender.lab.paper.clouds import walk_errors, with_truth
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio, of_rooms
from xihenet import estimators
from xihenet.records import ArrayF32, ArrayF64, ArrayInt
from xihenet.sphere import AnchorLattice

N_POINTS = 1_000_000
N_BLOCKS = 20
TABLES = ((512, 256), (1024, 512), (1536, 768), (2048, 1024))
PAPER = {
    512: (3.30, 1.65, 1.11, 0.82),
    1280: (5.23, 2.58, 1.72, 1.31),
    2048: (6.50, 3.30, 2.20, 1.62),
}
SAME = (
    "The same number of points, drawn in the same way, and the same tables; the nearest anchor has the largest cosine."
)
OURS = "Ours finds the nearest anchor exactly."
LIGHT = "The paper's plot shows no effect on its network's error. Here it is projection on all frames of a walk."


def in_cube(n_points: int, rng: np.random.Generator) -> ArrayF32:
    """(P, 3) points of a cube of 10 m around the origin."""
    return rng.uniform(-5, 5, (n_points, 3)).astype(np.float32)


def is_wrong(lattice: AnchorLattice, points: ArrayF32, anchors: ArrayInt, best: ArrayInt) -> ArrayF64:
    """(P,) 1 where the anchor lies more than 1e-7 in cosine below the best, in float64."""
    directions = points / np.linalg.norm(points.astype(np.float64), axis=1, keepdims=True)
    lead = ((lattice.directions[best] - lattice.directions[anchors]) * directions).sum(axis=1)
    wrong: ArrayF64 = (lead > 1e-7).astype(np.float64)
    return wrong


def _per_cent_of_blocks(wrong: ArrayF64) -> ArrayF64:
    """Which are independent, and as many as a bootstrap needs."""
    return np.asarray(100 * wrong.reshape(N_BLOCKS, -1).mean(axis=1))


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    points = in_cube(N_POINTS, options.rng)
    for n, of_paper in PAPER.items():
        lattice = AnchorLattice(n)
        best = lattice.nearest(points)
        for size, paper in zip(TABLES, of_paper, strict=True):
            wrong = is_wrong(lattice, points, lattice.nearest(points, "table", size), best)
            found = measured(_per_cent_of_blocks(wrong), options.rng)._replace(n=N_POINTS)
            what = f"table {size[0]}x{size[1]}, points at another anchor than the nearest: {n} anchors"
            yield Row(what, "%", *found, "same work", SAME, paper, "points", f"{n} anchors", size[0])
        few = points[:100_000]
        wrong = is_wrong(lattice, few, best[:100_000], lattice.nearest(few, "brute"))
        found = measured(_per_cent_of_blocks(wrong), options.rng)._replace(n=len(few))
        yield Row(f"ours: {n} anchors", "%", *found, "same work", OURS, None, "points")
    yield from effect_on_light(sessions, options)


def effect_on_light(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    """The error of the light by table over the error without, room by room."""
    steady = with_truth(sessions)
    if not steady:
        return
    lattice, estimate = AnchorLattice(1280), estimators.load("projection", 1280, "ldr").estimate
    exact = walk_errors(steady, lattice, estimate)
    rooms = [session.name for session in steady for _ in session.places]
    for size in TABLES:
        by_table = walk_errors(steady, lattice, estimate, method="table", table_size=size)
        found = measured_ratio(by_table, exact, options.rng, groups=rooms)
        what = f"SHC RMSE of projection by table {size[0]}x{size[1]} over that without"
        cases, is_detail = of_rooms("places", rooms), size != TABLES[1]
        yield Row(what, "times", *found, "cannot be compared", LIGHT, cases=cases, is_detail=is_detail)


STUDY = Study(
    "acceleration_grid",
    "Acceleration grid",
    70,
    "The paper sorts points into anchors by a table over azimuth and polar angle, and counts how many of 1,000,000 "
    "points in a cube of 10 m reach the nearest anchor, by size of the table. The table here counts those that do not.",
    measure,
    "width of the table, cells",
    "Points at another anchor than the nearest, per cent.",
)
