"""What does it cost to send every point to its true nearest anchor? Prints milliseconds and wrong answers.

Run it as `python addon_tests/bench/nearest.py`; it needs the extra `bench` (SciPy, fpsample). Methods take turns, one
call each, so that what else the machine does falls on all of them; ratios of medians are good to some 10 per cent.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Sequence

import numpy as np
from interleaved import interleaved_ms
from scipy.spatial import cKDTree

from xihenet.anchor_table import build_anchor_table, cells_for
from xihenet.completeness import joint_entropy
from xihenet.records import ArrayF32, ArrayF64, ArrayInt, PointCloud
from xihenet.sampling import sample_farthest, sample_uniform, sample_unit_sphere
from xihenet.sphere import AnchorLattice

N_POINTS = 256 * 192
N_ANCHORS = 1280
SIZES = (512, 768, 1024, 1280, 1536, 2048)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=60, help="calls per method (default 60)")
    parser.add_argument(
        "--points", type=int, default=1_000_000, help="points for the wrong answers (default 1,000,000)"
    )
    options = parser.parse_args()
    print(f"NumPy {np.__version__}, Python {platform.python_version()}, {platform.machine()}\n")
    print_times(options.repeats)
    print_sizes(options.points, options.repeats)
    print_entropy()


def in_cube(n_points: int, seed: int = 0) -> ArrayF32:
    """Points of a cube of 10 m around the origin."""
    return np.random.default_rng(seed).uniform(-5, 5, (n_points, 3)).astype(np.float32)


def n_wrong(lattice: AnchorLattice, points: ArrayF32, anchors: ArrayInt, best: ArrayInt) -> int:
    """How many anchors lie more than 1e-7 in cosine below the best, in float64."""
    directions = points / np.linalg.norm(points.astype(np.float64), axis=1, keepdims=True)
    lead = ((lattice.directions[best] - lattice.directions[anchors]) * directions).sum(axis=1)
    return int((lead > 1e-7).sum())


def print_row(cells: Sequence[object], widths: Sequence[int]) -> None:
    first, *others = (str(cell) for cell in cells)
    print(first.ljust(widths[0]) + "".join(cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)))


def print_times(repeats: int) -> None:
    """The table of methods, and unit-sphere sampling as a whole."""
    lattice, points = AnchorLattice(N_ANCHORS), in_cube(N_POINTS)
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
        wrong = n_wrong(lattice, points, finders[name](), best) if name in finders else ""
        median = np.median(values)
        print_row((name, f"{min(values):.3f}", f"{median:.3f}", f"{median / base:.2f}", wrong), widths)


def print_sizes(n_points: int, repeats: int) -> None:
    """Wrong answers, time against the table's, and build time, for each number of anchors."""
    points, frame = in_cube(n_points, seed=3), in_cube(N_POINTS, seed=4)
    widths = (10, 14, 14, 22, 10, 14, 14)
    print(f"\nwrong of {n_points} points; exact / table 1024x512 for {N_POINTS} points; seconds to build")
    print_row(
        ("anchors", "exact wrong", "table wrong", "ratio median (min)", "build s", "table MB", "neighbours s"), widths
    )
    for n in SIZES:
        lattice = AnchorLattice(n)
        start = time.perf_counter()
        table = build_anchor_table(lattice.directions, cells_for(n))
        built = time.perf_counter()
        lattice.neighbours(4)
        paired = time.perf_counter()
        best = lattice.nearest(points, "brute")
        wrong = [n_wrong(lattice, points, lattice.nearest(points, method), best) for method in ("exact", "table")]
        calls = {"exact": lambda at=lattice: at.nearest(frame), "table": lambda at=lattice: at.nearest(frame, "table")}
        exact_ms, table_ms = interleaved_ms(calls, 5 * repeats).values()
        ratio = f"{np.median(exact_ms) / np.median(table_ms):.2f} ({min(exact_ms) / min(table_ms):.2f})"
        seconds = f"{built - start:.2f}", f"{table.codes.nbytes / 1e6:.1f}", f"{paired - built:.3f}"
        print_row((n, *wrong, ratio, *seconds), widths)


def view_of_room(seed: int) -> tuple[PointCloud, ArrayF64]:
    """What a camera sees of an empty room of 5 x 4 x 2.6 m, and a position on the floor of its view."""
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(0, 2 * np.pi)
    forward = np.array([np.cos(yaw), np.sin(yaw), -0.3])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0])
    up = np.cross(right, forward)
    across, along = np.meshgrid(np.linspace(-0.65, 0.65, 256), np.linspace(0.5, -0.5, 192))
    rays = (forward + across[..., None] * right + along[..., None] * up).reshape(-1, 3)
    camera, walls = np.array([*rng.uniform(-1, 1, 2), 1.5]), np.array([[-2.5, -2, 0], [2.5, 2, 2.6]])
    with np.errstate(divide="ignore"):  # A ray along a wall never meets it: the infinite reach loses to another wall.
        reach = ((np.where(rays > 0, walls[1], walls[0]) - camera) / rays).min(axis=1)
    points = camera + rays * reach[:, None]
    return PointCloud(points, rng.random(points.shape)), np.array([*(camera[:2] + 0.8 * forward[:2]), 0.1])


def print_entropy() -> None:
    """Joint entropy of sampled clouds over the whole cloud's, as the paper compares them."""
    lattice, rng = AnchorLattice(N_ANCHORS), np.random.default_rng(5)
    relative: dict[str, list[float]] = {"unit sphere": [], "uniform random": [], "farthest point": []}
    for seed in range(10):
        cloud, position = view_of_room(seed)
        sampled = sample_unit_sphere(cloud, position, lattice)
        on_sphere = lattice.directions[sampled.is_set] * sampled.distance_m[sampled.is_set, None] + position
        raw = joint_entropy(cloud.points_m, position)
        relative["unit sphere"].append(joint_entropy(on_sphere, position) / raw)
        for name, sample in (("uniform random", sample_uniform), ("farthest point", sample_farthest)):
            relative[name].append(joint_entropy(sample(cloud, N_ANCHORS, rng).points_m, position) / raw)
    print("\njoint entropy relative to the whole cloud, 10 views of an empty room, 1280 anchors or points")
    ours = np.mean(relative["unit sphere"])
    for name, values in relative.items():
        gain = "" if name == "unit sphere" else f"   unit sphere {100 * (ours / np.mean(values) - 1):+.1f} %"
        print(f"{name:<20}{np.mean(values):.3f}{gain}")


if __name__ == "__main__":
    main()
