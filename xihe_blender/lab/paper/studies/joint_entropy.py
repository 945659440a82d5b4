"""Joint entropy: does sampling on the unit sphere keep more of what was seen? Pixels without depth decide that.

The measure is the paper's equation 1, one distribution per number of anchors, over 2 to 2048 of them as in its
published figures. There a position lies 0.1 m above a surface in view, and a pixel without depth stays in the cloud, as
a point at the camera. Each is switched here, one at a time. How many pixels have no depth is drawn, from shares that
the published entropies of its clouds imply. Depth noise stands in for a scanner's.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from xihe_blender.errors import UserError
from xihe_blender.lab.paper.clouds import view_errors, views, with_truth
from xihe_blender.lab.paper.records import Row, Session, Study, StudyOptions, measured, measured_ratio
from xihenet.camera import unproject_frame
from xihenet.camera_path.placement import evenly_chosen, upward_points
from xihenet.completeness import ENTROPY_SIZES, joint_entropy
from xihenet.paired import rank_correlation
from xihenet.records import ArrayF64, PointCloud
from xihenet.sampling import sample_farthest, sample_uniform, sample_unit_sphere
from xihenet.sphere import AnchorLattice

N_ANCHORS = 1280
SIZES = ENTROPY_SIZES[:-1]
GAINS = {"uniform": 0.545, "farthest": 0.359}
PER_CENT = {"uniform": 55.74, "farthest": 30.80}
WORDS = {"uniform": "uniform random", "farthest": "farthest point"}
ABOVE_M = 0.1
NOISE_PER_M = 0.01
SHARES_BETA = (2.4, 4.5)
HOLE_SHARES = (0.0, 0.2, 0.4, 0.6)
GAIN = (
    "The gain is the share of the whole cloud's entropy that unit-sphere sampling keeps beyond what the other sampling "
    "keeps, mean over clouds; ours is of 1280 anchors, the paper's a mean over seven numbers of anchors. "
)
FITTED = (
    "Shares of pixels without depth are drawn so that whole clouds are as incomplete as published (0.35 on average), "
    "which decides the gain over uniform sampling; the gain over farthest points was not fitted."
)
DEEP = "Farthest-point sampling picks distant points, so it loses more in deep views."
SWITCHED = "The paper's way with this one thing changed; its own figure stands beside the row that changes nothing."
CURVE = "The paper's way with the same share of pixels without depth in every view."
SPREAD = (
    "Whole clouds by the paper's way; the paper's are of the first 154 of the 2,037 clouds whose figures it published."
)
SPREADS = (("5th percentile", 0.05, 23.1), ("median", 0.5, 42.2), ("95th percentile", 0.95, 52.1))
ACCURACY = (
    "Spearman's correlation of a view's entropy with the error of the light from it, without holes. The paper shows a "
    "falling line for its own network, without a number."
)


@dataclass(frozen=True)
class Way:
    """How clouds are made and measured, each a switch; without arguments, as the paper's published figures were."""

    sizes: tuple[int, ...] = SIZES
    is_in_view: bool = True
    noise_per_m: float = NOISE_PER_M
    hole_share: float | None = None
    holes_are_points: bool = True
    is_one_distribution: bool = False
    unset_are_points: bool = False


PAPER_WAY = Way()
SWITCHES = {
    "the paper's way": PAPER_WAY,
    "pixels without depth left out": replace(PAPER_WAY, holes_are_points=False),
    "no pixel without depth": replace(PAPER_WAY, hole_share=0),
    "no depth noise": replace(PAPER_WAY, noise_per_m=0),
    "position at the camera": replace(PAPER_WAY, is_in_view=False),
    "2 to 4096 anchors": replace(PAPER_WAY, sizes=ENTROPY_SIZES),
    "one distribution over all numbers of anchors": replace(PAPER_WAY, is_one_distribution=True),
    "unset anchors kept as points": replace(PAPER_WAY, unset_are_points=True),
    "ours: none of it": Way(hole_share=0, noise_per_m=0, is_in_view=False, sizes=ENTROPY_SIZES),
}


@dataclass(frozen=True, eq=False)
class Scan:
    """The points (P, 3) that a frame shows, its camera (3,), and a point (3,) of an upward surface; world, metres.

    `hole_share` of its pixels are without depth, where a `Way` does not say otherwise.
    """

    room: str
    points_m: ArrayF64
    camera_m: ArrayF64
    surface_m: ArrayF64
    hole_share: float = 0.0

    @property
    def depth_range(self) -> float:
        """How many times as far the farthest point is as the middle one."""
        distance_m = np.linalg.norm(self.points_m - self.camera_m, axis=1)
        return float(distance_m.max() / np.median(distance_m))


def scans(sessions: Sequence[Session], most: int, rng: np.random.Generator) -> Iterator[Scan]:
    """At most so many of each room, evenly over its walk; frames that show no upward surface are left out."""
    for session in sessions:
        for frame in evenly_chosen(session.frames, most):
            upward, points = upward_points([frame]), unproject_frame(frame).points_m.astype(np.float64)
            if len(upward):
                surface = np.asarray(upward[rng.integers(len(upward))], np.float64)
                points = points[np.isfinite(points).all(axis=1)]
                yield Scan(session.name, points, np.asarray(frame.world_from_camera[:3, 3], np.float64), surface)


def with_holes(found: Iterable[Scan], rng: np.random.Generator) -> list[Scan]:
    """By depth, with shares that are spread alike over views of any depth, in steps of the golden ratio."""
    by_depth = sorted(found, key=lambda scan: scan.depth_range)
    places = (rng.random() + (5**0.5 - 1) / 2 * np.arange(len(by_depth))) % 1
    shares = np.quantile(rng.beta(*SHARES_BETA, 10_000), places)
    return [replace(scan, hole_share=float(share)) for scan, share in zip(by_depth, shares, strict=True)]


def relative_entropy(scan: Scan, way: Way, seed: int) -> dict[str, float]:
    """Bits of the whole cloud, and of each sampling over those; equal seeds draw alike."""
    rng = np.random.default_rng(seed)
    share, draws = scan.hole_share, rng.standard_normal((len(scan.points_m), 1))
    away = scan.points_m - scan.camera_m
    distance_m = np.linalg.norm(away, axis=1, keepdims=True)
    points = scan.camera_m + away * (1 + way.noise_per_m * distance_m * draws)
    is_hole = rng.random(len(points)) < (share if way.hole_share is None else way.hole_share)
    points[is_hole] = scan.camera_m if way.holes_are_points else np.nan
    # Just beside the camera, where a hole's point still has a direction.
    position = scan.surface_m + (0, 0, ABOVE_M) if way.is_in_view else scan.camera_m + (0, 0, -0.001)
    whole = PointCloud(points.astype(np.float32), np.zeros(points.shape, np.float32))
    lattice = AnchorLattice(N_ANCHORS)
    sphere = sample_unit_sphere(whole, position, lattice)
    kept = sphere.is_set
    on_sphere = lattice.directions[kept] * sphere.distance_m[kept, None] + position
    if way.unset_are_points:  # At the origin, where a direction is not a number and all are taken for one anchor's.
        on_sphere = np.concatenate([on_sphere, np.tile(position + (0, 0, 1), (int((~kept).sum()), 1))])
    clouds = {
        "whole": whole.points_m,
        "uniform": sample_uniform(whole, N_ANCHORS, rng).points_m,
        "farthest": sample_farthest(whole, N_ANCHORS, rng).points_m,
        "sphere": on_sphere,
    }
    bits = {name: _bits(cloud, position, way) for name, cloud in clouds.items()}
    return {name: value if name == "whole" else value / bits["whole"] for name, value in bits.items()}


def _bits(points_m: ArrayF64, position_m: ArrayF64, way: Way) -> float:
    summed = joint_entropy(points_m, position_m, sizes=way.sizes)
    # All sizes equally likely: the entropy of which one, and the mean of theirs.
    return float(np.log2(len(way.sizes)) + summed / len(way.sizes)) if way.is_one_distribution else summed


def measure(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    found = with_holes(scans(sessions, 4 if options.quick else 12, options.rng), options.rng)
    if len(found) < 8:
        raise UserError("fewer than eight frames show an upward surface: give more --scenes")
    for name, way in SWITCHES.items():
        of_views = [relative_entropy(scan, way, options.seed + k) for k, scan in enumerate(found)]
        if way == PAPER_WAY:
            yield from _as_the_paper(of_views, found, options)
        else:
            yield from _gains(name, of_views, found, options, SWITCHED)
    for share in HOLE_SHARES:
        way = replace(PAPER_WAY, hole_share=share)
        of_views = [relative_entropy(scan, way, options.seed + k) for k, scan in enumerate(found)]
        yield from _gains(f"{share:.0%} of pixels without depth", of_views, found, options, CURVE, at=share)
    yield from against_accuracy(sessions, options)


def _gains(
    name: str,
    of_views: Sequence[dict[str, float]],
    found: Sequence[Scan],
    options: StudyOptions,
    sentence: str,
    *,
    has_paper: bool = False,
    at: float | None = None,
) -> Iterator[Row]:
    rooms = [scan.room for scan in found]
    for other, paper in GAINS.items():
        gains = measured([one["sphere"] - one[other] for one in of_views], options.rng, groups=rooms)
        series = "" if at is None else f"over {WORDS[other]}"
        shown = paper if has_paper else None
        what, is_detail = f"{name}: over {WORDS[other]}", at is not None
        yield Row(what, "of whole", *gains, "other data", sentence, shown, "views", series, at, is_detail)


def _as_the_paper(of_views: Sequence[dict[str, float]], found: Sequence[Scan], options: StudyOptions) -> Iterator[Row]:
    """Of all views and of the deepest quarter, with the spread of entropy."""
    deep = np.array([scan.depth_range for scan in found])
    quarter = np.flatnonzero(deep >= np.quantile(deep, 0.75))
    for name, chosen in (("the paper's way", range(len(found))), ("the deepest quarter of these views", quarter)):
        some, scanned = [of_views[k] for k in chosen], [found[k] for k in chosen]
        rooms, sentence = [scan.room for scan in scanned], GAIN + (DEEP if chosen is quarter else FITTED)
        yield from _gains(name, some, scanned, options, sentence, has_paper=True)
        for other, paper in PER_CENT.items():
            both = [one["sphere"] for one in some], [one[other] for one in some]
            ratio = measured_ratio(*both, options.rng, groups=rooms)
            what = f"{name}: entropy over that of {WORDS[other]}"
            yield Row(what, "times", *ratio, "other data", sentence, 1 + paper / 100, "views")
    bits, rooms = [one["whole"] for one in of_views], [scan.room for scan in found]
    for words, share, paper in SPREADS:
        spread = measured(bits, options.rng, groups=rooms, statistic=partial(np.quantile, q=share))
        yield Row(f"entropy of the whole cloud: {words}", "bits", *spread, "other data", SPREAD, paper, "views")


def against_accuracy(sessions: Sequence[Session], options: StudyOptions) -> Iterator[Row]:
    """Whether views of higher entropy give better light: of one place, and of all together as the paper has it."""
    seen = list(views(with_truth(sessions), 20 if options.quick else 100))
    n_views = Counter((view.room, view.place.name) for view in seen)
    found = [view for view in seen if n_views[view.room, view.place.name] >= 3]
    if not found:
        return
    bits = np.array([joint_entropy(view.points.points_m, view.place.position_m, sizes=SIZES) for view in found])
    places = [(view.room, view.place.name) for view in found]
    for name in ("lattice", "xihenet"):
        pairs = np.stack([bits, view_errors(name, found, N_ANCHORS)], axis=1)
        what = f"entropy of a view and the error of {name}"
        by_place = {place: _correlation(pairs[[one == place for one in places]]) for place in dict.fromkeys(places)}
        within = {place: value for place, value in by_place.items() if np.isfinite(value)}
        if len(within) > 1:
            mean = measured(list(within.values()), options.rng, groups=[room for room, _ in within])
            yield Row(f"{what}: at one place", "rank correlation", *mean, "other data", ACCURACY, None, "places")
        pooled = measured(pairs, options.rng, groups=[room for room, _ in places], statistic=_correlation)
        yield Row(f"{what}: all rooms", "rank correlation", *pooled, "other data", ACCURACY, None, "views")


def _correlation(pairs: ArrayF64) -> float:
    return rank_correlation(pairs[:, 0], pairs[:, 1])


STUDY = Study(
    "joint_entropy",
    "Joint entropy: what sampling keeps, its spread, and accuracy",
    65,
    "The paper measures how evenly a cloud covers the directions around a position, relative to the whole cloud: with "
    "unit-sphere sampling 55.74 % better than with uniform random, 30.80 % better than with farthest point sampling.",
    measure,
    "share of pixels without depth",
    "Gain in relative joint entropy of sampling on the unit sphere.",
)
