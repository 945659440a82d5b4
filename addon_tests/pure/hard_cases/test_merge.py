"""Hard cases of merging: order, drift, things that move, and what nobody has looked at since."""

from functools import reduce
from itertools import permutations
from typing import Any

import numpy as np

from addon_tests.hard_case import each, equal, refused, row
from xihenet.buffers import merge
from xihenet.records import UnitSphereCloud

STAGE = "merge"
N = 64
ANCHORS = np.arange(N)


def cloud_of(is_set: np.ndarray, srgb: float = 0.5, distance_m: float = 1.0) -> UnitSphereCloud:
    """One colour at one distance."""
    return UnitSphereCloud(np.outer(is_set * srgb, np.ones(3)), is_set * distance_m, is_set)


def random_cloud(seed: int, is_set: np.ndarray | None = None) -> UnitSphereCloud:
    rng = np.random.default_rng(seed)
    known = rng.random(N) < 0.6 if is_set is None else is_set
    return UnitSphereCloud(rng.random((N, 3)) * known[:, None], rng.random(N) * known, known)


def parts(cloud: UnitSphereCloud) -> np.ndarray:
    """(N, 5) all there is in a cloud."""
    return np.column_stack([cloud.srgb, cloud.distance_m, cloud.is_set])


def merged(clouds: Any) -> np.ndarray:
    return parts(reduce(merge, clouds))


def averaged(clouds: Any) -> np.ndarray:
    """Naive: a running mean, what is not set being black."""
    return reduce(lambda old, new: (old + new) / 2, map(parts, clouds))


def nearest_kept(clouds: Any) -> np.ndarray:
    """Naive: the nearest ever seen stays."""
    stacked = np.array([parts(cloud) for cloud in clouds])
    nearest = np.where(stacked[..., 4] > 0, stacked[..., 3], np.inf).argmin(axis=0)
    return stacked[nearest, ANCHORS]


def brighter_kept(clouds: Any) -> np.ndarray:
    """Naive: black stands for "not seen"."""
    return reduce(lambda old, new: np.where(new[:, :1] > 0, new, old), map(parts, clouds))


def distance_says_set(clouds: Any) -> np.ndarray:
    """Naive: a distance above 0 stands for "seen"."""
    return reduce(lambda old, new: np.where(new[:, 3:4] > 0, new, old), map(parts, clouds))


ALL = np.ones(N, bool)
EVEN = ANCHORS % 2 == 0
THIRDS = [random_cloud(seed, seed == ANCHORS % 3) for seed in range(3)]
FIRST, SECOND = random_cloud(10), random_cloud(11)
BY_TURNS = [FIRST, SECOND] * 500


def all_orders(clouds: list[UnitSphereCloud]) -> int:
    """In how many different clouds the orders of merging end."""
    return len({merged(order).tobytes() for order in permutations(clouds)})


def all_orders_averaged(clouds: list[UnitSphereCloud]) -> int:
    return len({averaged(order).tobytes() for order in permutations(clouds)})


def wide(distances: tuple[float, float]) -> list[UnitSphereCloud]:
    return [cloud_of(EVEN, distance_m=distances[0]), cloud_of(~EVEN, distance_m=distances[1])]


NOTHING = UnitSphereCloud.empty(N)
BALL, WALL = cloud_of(ALL, 0.2, 1.0), cloud_of(ALL, 0.8, 5.0)
LAMP, LAMP_OFF, AT_0_M = cloud_of(ALL, 1.0), cloud_of(ALL, 0.0), cloud_of(ALL, 0.2, 0.0)
SKIPPED = UnitSphereCloud(np.zeros((1, 3)), np.zeros(1), np.zeros(1, bool), {"at_probe": 7})
CASES = [
    row("clouds that share no anchor merge alike in any order", THIRDS, all_orders, equal(1), all_orders_averaged),
    row("nothing merged with nothing is nothing", [NOTHING, NOTHING], lambda both: merged(both).sum(), equal(0.0)),
    row(
        "1e-45 m and 3e38 m stand side by side",
        (1e-45, 3e38),
        lambda distances: merged(wide(distances))[:, 3],
        equal(np.where(EVEN, np.float32(1e-45), np.float32(3e38))),
    ),
    row(
        "65,536 anchors merge anchor by anchor",
        65_536,
        lambda n: int(merge(cloud_of(np.arange(n) == 0), cloud_of(np.arange(n) == n - 1)).is_set.sum()),
        equal(2),
    ),
    row(
        "skipped points of a thousand frames are those of the last frame",
        [SKIPPED] * 1000,
        lambda clouds: reduce(merge, clouds).n_invalid_points,
        equal(7),
    ),
    row(
        "where clouds share anchors the last one wins",
        [FIRST, SECOND, FIRST],
        merged,
        equal(np.where(FIRST.is_set[:, None], parts(FIRST), parts(SECOND))),
        averaged,
    ),
    row(
        "a thousand merges of the same two clouds do not drift",
        BY_TURNS,
        merged,
        equal(merged([FIRST, SECOND])),
        averaged,
    ),
    row("a cloud merged with itself a thousand times is itself", [FIRST] * 1000, merged, equal(parts(FIRST))),
    row("a ball that moves away shows the wall behind it", [BALL, WALL], merged, equal(parts(WALL)), nearest_kept),
    row("a ball that moves in hides the wall behind it", [WALL, BALL], merged, equal(parts(BALL)), averaged),
    row("a lamp that goes out goes out", [LAMP, LAMP_OFF], merged, equal(parts(LAMP_OFF)), brighter_kept),
    row(
        "what was seen once is there after a thousand frames of other things",
        [cloud_of(EVEN), *[cloud_of(~EVEN)] * 1000],
        merged,
        equal(parts(cloud_of(ALL))),
        averaged,
    ),
    row("frames that see nothing change nothing", [FIRST, *[NOTHING] * 1000], merged, equal(parts(FIRST)), averaged),
    row("a surface at distance 0 is seen", [WALL, AT_0_M], merged, equal(parts(AT_0_M)), distance_says_set),
    row(
        "a cloud of one anchor is not stretched over another lattice",
        (1, N),
        lambda sizes: merge(*map(UnitSphereCloud.empty, sizes)),
        refused("as many anchors, got 1 and 64"),
    ),
]

test_hard_case = each(CASES)
