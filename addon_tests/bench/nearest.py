"""The nearest anchor: what does it cost to find the true one for every point? Prints milliseconds and wrong answers.

Run it as `python addon_tests/bench/nearest.py [--repeats 60] [--points 1000000]`, calls of each method and points for
the wrong answers; it needs the extra `bench` (SciPy). Methods take turns, one call each, so that what else the machine
does falls on all of them; ratios of medians are good to some 10 per cent.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence

import numpy as np
from given import given
from interleaved import interleaved_ms
from scipy.spatial import cKDTree

from xihe_blender.lab.paper.studies.acceleration_grid import in_cube, is_wrong
from xihenet.anchor_table import build_anchor_table, cells_for
from xihenet.records import ArrayInt, PointCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice

N_POINTS = 256 * 192
N_ANCHORS = 1280
SIZES = (512, 768, 1024, 1280, 1536, 2048)


def main() -> None:
    options = given(__doc__, repeats=60, points=1_000_000)
    print(f"NumPy {np.__version__}, Python {platform.python_version()}, {platform.machine()}\n")
    print_times(options.repeats)
    print_sizes(options.points, options.repeats)


def print_row(cells: Sequence[object], widths: Sequence[int]) -> None:
    first, *others = (str(cell) for cell in cells)
    print(first.ljust(widths[0]) + "".join(cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)))


def print_times(repeats: int) -> None:
    """The table of methods, and unit-sphere sampling as a whole."""
    lattice, points = AnchorLattice(N_ANCHORS), in_cube(N_POINTS, np.random.default_rng(0))
    tree = cKDTree(lattice.directions)
    finders: dict[str, Callable[[], ArrayInt]] = {
        "exact": lambda: lattice.nearest(points),
        "table 1024x512": lambda: lattice.nearest(points, "table"),
        "brute": lambda: lattice.nearest(points, "brute"),
        "SciPy k-d tree": lambda: tree.query(points / np.linalg.norm(points, axis=1, keepdims=True))[1],
    }
    cloud = PointCloud(np.asfortranarray(points), np.random.default_rng(1).random((N_POINTS, 3), np.float32))
    with_holes = np.where(np.random.default_rng(2).random((N_POINTS, 1)) < 0.2, np.nan, points)
    holey = PointCloud(np.asfortranarray(with_holes), cloud.srgb)
    position = np.array([0.1, 0.2, 0.3])
    samplers = {
        "sample_unit_sphere": lambda: sample_unit_sphere(cloud, position, lattice),
        "the same, 20 % of the points NaN": lambda: sample_unit_sphere(holey, position, lattice),
        "the same, by table": lambda: sample_unit_sphere(cloud, position, lattice, method="table"),
    }
    quick = interleaved_ms({name: finders[name] for name in ("exact", "table 1024x512")}, 5 * repeats)
    slow = interleaved_ms({name: finders[name] for name in ("brute", "SciPy k-d tree")}, max(3, repeats // 6))
    elapsed_ms = quick | slow | interleaved_ms(samplers, 5 * repeats)
    best = finders["brute"]()
    base = np.median(elapsed_ms["table 1024x512"])
    widths = (34, 10, 10, 12, 10)
    print(f"{N_POINTS} points, {N_ANCHORS} anchors")
    print_row(("", "min ms", "median ms", "x table", "wrong"), widths)
    for name, values in elapsed_ms.items():
        wrong = int(is_wrong(lattice, points, finders[name](), best).sum()) if name in finders else ""
        median = np.median(values)
        print_row((name, f"{min(values):.3f}", f"{median:.3f}", f"{median / base:.2f}", wrong), widths)


def print_sizes(n_points: int, repeats: int) -> None:
    """Wrong answers, time against the table's, and build time, for each number of anchors."""
    points, frame = (in_cube(n, np.random.default_rng(seed)) for n, seed in ((n_points, 3), (N_POINTS, 4)))
    widths = (10, 14, 14, 22, 10)
    print(f"\nwrong of {n_points} points; exact / table 1024x512 for {N_POINTS} points; seconds to build")
    print_row(("anchors", "exact wrong", "table wrong", "ratio median (min)", "build s"), widths)
    for n in SIZES:
        lattice = AnchorLattice(n)
        start = time.perf_counter()
        build_anchor_table(lattice.directions, cells_for(n))
        build_s = time.perf_counter() - start
        best = lattice.nearest(points, "brute")
        found = [lattice.nearest(points, method) for method in ("exact", "table")]
        wrong = [int(is_wrong(lattice, points, anchors, best).sum()) for anchors in found]
        calls = {"exact": lambda at=lattice: at.nearest(frame), "table": lambda at=lattice: at.nearest(frame, "table")}
        exact_ms, table_ms = interleaved_ms(calls, 5 * repeats).values()
        ratio = f"{np.median(exact_ms) / np.median(table_ms):.2f} ({min(exact_ms) / min(table_ms):.2f})"
        print_row((n, *wrong, ratio, f"{build_s:.2f}"), widths)


if __name__ == "__main__":
    main()
