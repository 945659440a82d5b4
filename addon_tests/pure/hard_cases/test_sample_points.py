"""Hard cases of points: at the probe, beyond float32, broken, in crowds and by millions; and of probes far away."""

from typing import Any

import numpy as np

from addon_tests.hard_case import at_most, each, equal, refused, row, that
from xihenet.completeness import ENTROPY_SIZES, joint_entropy
from xihenet.records import PointCloud
from xihenet.sampling import sample_uniform, sample_unit_sphere
from xihenet.sphere import AnchorLattice

STAGE = "sample"
HERE = np.zeros(3)

ALONG = np.array([0.6, 0.0, 0.8])


def sampled(points_m: Any, colours: Any = 0.5, position_m: Any = HERE, n: int = 64) -> Any:
    points = np.array(points_m, float).reshape(-1, 3)
    return sample_unit_sphere(PointCloud(points, np.broadcast_to(colours, points.shape)), position_m, AnchorLattice(n))


def seen(points_m: Any) -> tuple[int, int, float]:
    """Anchors that are set, points that were skipped, and the largest distance."""
    cloud = sampled(points_m)
    return int(cloud.is_set.sum()), cloud.n_invalid_points, float(cloud.distance_m.max())


def seen_by_hand(points_m: Any) -> tuple[int, int, float]:
    """Naive: distance and direction as the textbook has them, in float32."""
    points = np.array(points_m, np.float32).reshape(-1, 3)
    distance_m = np.sqrt((points * points).sum(axis=1))
    anchors = np.argmax(points / distance_m[:, None] @ AnchorLattice(64).directions.T, axis=1)
    return len(np.unique(anchors)), 0, float(distance_m.max())


def seen_in_half(points_m: Any) -> tuple[int, int, float]:
    """Naive: distances kept as they go over the wire."""
    n_set, n_skipped, _ = seen(points_m)
    return n_set, n_skipped, float(np.linalg.norm(points_m, axis=-1).astype(np.float16).max())


def single(distance_m: float) -> list[float]:
    return (ALONG * distance_m).tolist()


def set_at(distance_m: float, share: float = 2e-7) -> Any:
    return that(
        f"one anchor set, at {distance_m:g} m",
        lambda came: came[:2] == (1, 0) and abs(came[2] - distance_m) <= share * distance_m,
    )


SMALLEST = float(np.float32(1e-45))


def last_wins(points: np.ndarray, n: int = 64) -> np.ndarray:
    """Naive: (n,) distances, each anchor's from the last point that fell on it."""
    distances = np.zeros(n)
    distances[AnchorLattice(n).nearest(points)] = np.linalg.norm(points, axis=1)
    return distances


def millions(n: int) -> np.ndarray:
    return np.random.default_rng(4).uniform(-5, 5, (n, 3)).astype(np.float32)


def metres_from_the_nearest(n: int) -> float:
    """The largest error of an anchor's distance for `n` points, against the least float64 distance in its cell."""
    points = millions(n)
    cloud = sample_unit_sphere(PointCloud(points, np.zeros_like(points)), HERE, AnchorLattice(64))
    return float(np.abs(cloud.distance_m - least_distances(points)).max())


def least_distances(points: np.ndarray) -> np.ndarray:
    least = np.full(64, np.inf)
    np.minimum.at(least, AnchorLattice(64).nearest(points), np.sqrt(np.einsum("pi,pi->p", points, points, dtype=float)))
    return least


def tie(_: object) -> float:
    colours = [[0.25] * 3, [0.75] * 3, [1.0] * 3]
    return float(sampled([single(2)] * 3, colours).srgb.max())


def metres_off_at(position_m: np.ndarray) -> float:
    """Error of the distance to a point 0.1 m beside a position, against float64 on the point as it is stored."""
    point = (position_m + [0.06, 0.0, 0.08]).astype(np.float32)
    cloud = sampled(point, position_m=position_m)
    return abs(float(cloud.distance_m.max()) - float(np.linalg.norm(point.astype(float) - position_m)))


def metres_off_by_hand(position_m: np.ndarray) -> float:
    """Naive: the position in float32, like the points."""
    point = (position_m + [0.06, 0.0, 0.08]).astype(np.float32)
    distance = np.linalg.norm(point - position_m.astype(np.float32))
    return abs(float(distance) - float(np.linalg.norm(point.astype(float) - position_m)))


def entropy_of(points_m: np.ndarray) -> float:
    """For lattices up to one whose tables are made in no time and where `ALONG` is far from the first anchor."""
    return joint_entropy(points_m, HERE, sizes=ENTROPY_SIZES[:9])


def entropy_by_hand(points_m: np.ndarray) -> float:
    """Naive: every anchor's share enters the sum, those of 0 too."""
    points = np.asarray(points_m, float)
    units = points / np.linalg.norm(points, axis=1, keepdims=True)
    total = 0.0
    for n in (2, 4, 8):
        shares = np.bincount(AnchorLattice(n).nearest(units), minlength=n) / len(units)
        total -= float((shares * np.log2(shares)).sum())
    return total


def place_seen(place_m: list[float]) -> tuple[int, int]:
    cloud = sampled([single(1)] * 3, position_m=place_m)
    return int(cloud.is_set.sum()), cloud.n_invalid_points


def brightest(given: tuple[Any, Any]) -> list[float]:
    """Of each anchor that is set."""
    cloud = sampled(*given)
    return sorted(cloud.srgb.max(axis=1)[cloud.is_set].tolist())


def last_of_dict(_: object) -> float:
    return dict(zip([0, 0, 0], [0.25, 0.75, 1.0], strict=True))[0]


def drawn(points: np.ndarray) -> int:
    return len(sample_uniform(PointCloud(points, np.zeros((5, 3))), 3, np.random.default_rng(0)).points_m)


POINTS = [
    ("a point as near as float32 can be sets its anchor", [0, 0, SMALLEST], set_at(SMALLEST), seen_by_hand),
    ("a point 1e30 m away sets its anchor", single(1e30), set_at(1e30), seen_by_hand),
    ("a point 3e38 m away sets its anchor", [0, 0, 3e38], set_at(3e38), seen_by_hand),
    ("a point 65,535 m away keeps its distance", single(65535), set_at(65535), seen_in_half),
    ("a point 1e10 m away keeps its distance", single(1e10), set_at(1e10), seen_in_half),
    ("an empty cloud sets nothing", [], equal((0, 0, 0.0)), seen_by_hand),
    ("a cloud of NaN alone sets nothing", [[np.nan] * 3] * 5, equal((0, 5, 0.0)), seen_by_hand),
    (
        "one good point among broken ones is found",
        [[np.nan] * 3, [0, 0, 2], [np.inf] * 3, [0, 0, 0]],
        equal((1, 3, 2.0)),
        seen_by_hand,
    ),
    (
        "points at 1e-30 m and 1e30 m do not disturb each other",
        [single(1e-30), (-ALONG * 1e30).tolist()],
        that("two anchors set", lambda came: came[:2] == (2, 0)),
        seen_by_hand,
    ),
]
NO_ENTROPY = {
    "no point": np.zeros((0, 3)),
    "points at the position": np.zeros((4, 3)),
    "points in one direction": np.outer([1.0, 1e-200, 1e200], ALONG),
    "broken points": np.full((3, 3), np.nan),
}
BOTH_POLES, BOTH_SIDES = [[0, 0, 3], [0, 0, -4]], [[-1, 0.0, 0.1], [-1, -0.0, 0.1]]
FAR = {"10 km": [10000.0003, -10000.0003, 10000.0003], "1000 km": [1e6 + 0.01, 0, 1e6 - 0.02]}
CASES = [
    *(row(name, given, seen, must, naive) for name, given, must, naive in POINTS),
    row("of equally near points the first one gives the colour", None, tie, equal(0.25), last_of_dict),
    row("azimuth pi and minus pi are one direction", BOTH_SIDES, lambda points: seen(points)[0], equal(1)),
    row(
        "points on both poles set the first and the last anchor",
        BOTH_POLES,
        lambda points: np.flatnonzero(sampled(points).is_set).tolist(),
        equal([0, 63]),
    ),
    row(
        "a million points give each anchor its nearest one",
        1_000_000,
        metres_from_the_nearest,
        at_most(2e-6),
        lambda n: float(np.abs(last_wins(millions(n)) - least_distances(millions(n))).max()),
    ),
    row(
        "colours beyond white and below black are clipped",
        ([single(1), single(-1)], [[1.5] * 3, [-0.5] * 3]),
        brightest,
        equal([0.0, 1.0]),
    ),
    *(
        row(
            f"{far} from the origin distances are right to a tenth of a micrometre",
            np.array(place_m),
            metres_off_at,
            at_most(1e-7),
            metres_off_by_hand,
        )
        for far, place_m in FAR.items()
    ),
    row("a probe where float32 ends sees nothing and counts it", [1e39, 0, 0], place_seen, equal((0, 3))),
    *(
        row(f"the joint entropy of {name} is 0", points, entropy_of, equal(0.0), entropy_by_hand)
        for name, points in NO_ENTROPY.items()
    ),
    row("drawing from broken points alone draws none", np.full((5, 3), np.nan), drawn, equal(0)),
    row("65537 anchors are refused since an index has 16 bits", 65_537, AnchorLattice, refused("expected 1 to 65536")),
    row("no anchor is refused", 0, AnchorLattice, refused("expected 1 to 65536")),
]

test_hard_case = each(CASES)
