"""Left-out frames: how good is an estimator where no light probe has been? What a frame shows that it was not given.

Of a session, some frames are given and the others left out. The light is estimated from those that are given, and in
the directions that only the others show it is held against what they show. That needs no truth, so it can be asked of
frames from anywhere. It judges the light by its order-2 radiance in single directions, where every estimator errs much
by what order 2 cannot hold: differences between estimators mean something, the size of the error little.

Which estimator suits a recording, `score_session` says over places in its room. The frames are three parts in time, and
each is left out in turn. A place's error is the root of the mean square over the three. It is no error of the light: it
says how well unseen directions are guessed, and a lamp beyond white counts as white. So estimators are asked for light
clipped at white, target "ldr": all of the light rings in order 2, by more than pictures can show.

Colours are linear, at the session's exposure, clipped at white as the pictures are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from xihenet.buffers import FrameAtPosition, merge, merge_in_sight
from xihenet.camera import unproject_frame, valid_plane_depth
from xihenet.camera_path.placement import evenly_chosen, places_among, upward_points
from xihenet.colour import srgb_to_linear
from xihenet.estimators import Estimator
from xihenet.paired import CONFIDENCE, held_at_most, paired_difference
from xihenet.records import ArrayF64, RgbdFrame, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh_basis import basis, checked_sh
from xihenet.sphere import AnchorLattice

N_PARTS = 3
SMALLEST_SHARE = 0.02
"""Of the sphere, that left-out frames have to show alone to be asked."""

N_PLACES = 16
ABOVE_M = 0.1
SPACING_M = 0.4
BEFORE = 0.7
"""Where no upward surface was seen, places hang at this share of the way to what a frame shows in its middle."""


def left_out_error(sh_radiance: ArrayF64, given: UnitSphereCloud, left_out: UnitSphereCloud) -> float | None:
    """RMSE of the light (9, 3) in the directions that `left_out` shows and `given` does not; radiance is cut to 0 to 1.

    The light carries the session's exposure. None where these directions are less than `SMALLEST_SHARE` of the sphere.
    ValueError for clouds of different numbers of anchors, and for coefficients that are not finite.
    """
    coefficients, order = checked_sh(sh_radiance)
    if len(given) != len(left_out):
        raise ValueError(f"left out: expected as many anchors in both clouds, got {len(given)} and {len(left_out)}")
    is_asked = left_out.is_set & ~given.is_set
    if is_asked.mean() < SMALLEST_SHARE:
        return None
    said = basis(AnchorLattice(len(given)).directions[is_asked], order) @ coefficients
    shown = srgb_to_linear(left_out.srgb[is_asked].astype(np.float64))
    return float(np.sqrt(np.mean((said.clip(0, 1) - shown) ** 2)))


def left_out_errors(
    frames: Sequence[UnitSphereCloud], estimate: Callable[[UnitSphereCloud], ArrayF64], *, is_merged: bool = False
) -> Iterator[float]:
    """Errors over a session: of the light from each frame alone, by all others; or from two thirds, by the other third.

    `frames` are what each of them shows of one position, in their order, a third of which is left out in turn;
    `estimate` gives (9, 3) of a cloud. What cannot be asked is left out, so that there may be none.
    """
    parts = np.array_split(np.arange(len(frames)), N_PARTS if is_merged else len(frames)) if frames else []
    for part in parts:
        inside = [frame for i, frame in enumerate(frames) if i in part]
        outside = [frame for i, frame in enumerate(frames) if i not in part]
        if inside and outside:
            given, left_out = (reduce(merge, some) for some in ((outside, inside) if is_merged else (inside, outside)))
            error = left_out_error(estimate(given), given, left_out) if given.is_set.any() else None
            if error is not None:
                yield error


@dataclass(frozen=True)
class EstimatorScore:
    """Of one estimator over the places that could be asked.

    Parameters
    ----------
    estimator : its name
    rmse : mean over places of the error of radiance, linear, at the session's exposure
    low, high : 95 % confidence interval of that mean over places; None with fewer than six, which hold none of 95 %
    share_better : of the places, in which its error is below that of the first estimator of the table
    n_places : that could be asked: at others no part shows enough that the others do not
    """

    estimator: str
    rmse: float
    low: float | None
    high: float | None
    share_better: float
    n_places: int


def score_places(frames: Sequence[RgbdFrame], most: int = N_PLACES) -> ArrayF64:
    """(K, 3) world, metres, at most `most`: places above seen upward surfaces, or in the air where there are few.

    Empty where the frames have no valid plane depth.
    """
    places = places_among(upward_points(frames), SPACING_M) + (0, 0, ABOVE_M)
    if len(places) < most // 2:
        hung = [_before_middle(frame) for frame in frames if valid_plane_depth(frame.plane_depth_m).any()]
        places = np.concatenate([places, np.array(hung).reshape(-1, 3)])
    return np.array(evenly_chosen(list(places), most), np.float64).reshape(-1, 3)


def _before_middle(frame: RgbdFrame) -> ArrayF64:
    depth_m = np.median(frame.plane_depth_m[valid_plane_depth(frame.plane_depth_m)])
    pose = frame.world_from_camera
    return np.asarray(pose[:3, 3] - BEFORE * float(depth_m) * pose[:3, 2])


def score_session(
    frames: Iterable[RgbdFrame],
    n_frames: int,
    places_m: ArrayF64,
    estimators: Mapping[str, Estimator],
    rng: np.random.Generator,
    *,
    reference_exposure: float | None = None,
) -> list[EstimatorScore]:
    """The scores of `estimators`, which need nothing but a cloud, in their order; empty where no place could be asked.

    Parameters
    ----------
    frames : in order of time, `n_frames` of them, read once and one at a time
    places_m : (K, 3) world, metres
    rng : of the intervals
    reference_exposure : that errors carry; None takes that of the first frame

    ValueError for estimators of different numbers of anchors, or none.
    """
    sizes = {one.n_anchors for one in estimators.values()}
    if len(sizes) != 1:
        raise ValueError(f"score_session: expected estimators of one number of anchors, got {sorted(sizes)}")
    lattice = AnchorLattice(sizes.pop())
    shown = [[UnitSphereCloud.empty(lattice.n)] * N_PARTS for _ in places_m]
    for number, frame in enumerate(frames):
        reference_exposure = reference_exposure or frame.exposure
        points, part = unproject_frame(frame, reference_exposure=reference_exposure), number * N_PARTS // n_frames
        for place_m, parts in zip(places_m, shown, strict=True):
            sampled = sample_unit_sphere(points, place_m, lattice)
            parts[part] = merge_in_sight(parts[part], sampled, FrameAtPosition(frame, place_m, lattice))
    errors = {name: [_error_of_place(parts, one) for parts in shown] for name, one in estimators.items()}
    first = next(iter(errors.values()))
    asked = [k for k, error in enumerate(first) if error is not None]
    if not asked:
        return []
    base = np.array([first[k] for k in asked])
    return [_score(name, np.array([found[k] for k in asked]), base, rng) for name, found in errors.items()]


def _error_of_place(parts: Sequence[UnitSphereCloud], estimator: Estimator) -> float | None:
    """None where no part can be asked."""
    squares = []
    for number, left_out in enumerate(parts):
        given = reduce(merge_in_sight, [part for k, part in enumerate(parts) if k != number])
        if given.is_set.any():
            error = left_out_error(estimator.estimate(given), given, left_out)
            squares += [] if error is None else [error**2]
    return float(np.sqrt(np.mean(squares))) if squares else None


def _score(name: str, errors: ArrayF64, first: ArrayF64, rng: np.random.Generator) -> EstimatorScore:
    places = list(range(len(errors)))
    mean = paired_difference(errors.tolist(), [0.0] * len(errors), places, rng)
    share_better = float(np.mean(errors < first))
    low, high = (mean.low, mean.high) if held_at_most(len(errors)) >= CONFIDENCE else (None, None)
    return EstimatorScore(name, mean.mean, low, high, share_better, len(errors))
