"""The better path: where should the phone look for a second, so that the light at an object is known better?

A look is a turn of the phone away from its path at one frame, a second of holding still, and the turn back. Many are
tried on what the frames of the path show, and nothing is rendered. What lies in directions that nobody has seen is not
known, so it is guessed:

- its distance: the end of the convex hull of all that was seen, with 1 m of free air around each place of the phone,
  and around a position as much as it lies outside of that, 1 m at most;
- whether a look would show it: it falls into the picture, and nothing is known in that direction from the phone's
  place, else it would be hidden, or known not to be there;
- how much light comes from it: as much as from what was seen near it, half as much below the horizon.

The best look shows the most of that light. Rejected: counting directions alone, the light of the estimate in place of
the neighbours', what the estimator expects of the guessed cloud, and the mean over random completions of the unseen
part: held against 84 rendered places, each had a smaller gain or none (docs/better_path.md).

Not here: people and furniture that stand in the way of the turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from xihenet.camera import in_view
from xihenet.camera_path.looks import Look, LookSettings
from xihenet.colour import LUMINANCE, linear_to_srgb, srgb_to_linear
from xihenet.records import (
    FAR_M,
    AnchorSurfaces,
    ArrayBool,
    ArrayF64,
    Intrinsics,
    PointCloud,
    UnitSphereCloud,
)
from xihenet.sphere import AnchorLattice

FREE_M = 1.0
"""Around each place of the phone, taken to be free: nobody walks along a wall with the phone touching it. Around a
position that lies outside of all that was seen as well."""

HULL_SHARE = 98.0
"""Per cent of the points that lie within the hull: what is seen through a window does not make the room larger."""

MOST_POINTS = 100_000
MOST_HULL_POINTS = 10_000
NEAR = 20.0
"""How fast the light of neighbours counts less: exp(NEAR (cosine - 1)), half at 15 degrees."""

BELOW = 0.5
"""Of the light from below the horizon, over that from above: lamps, windows and sky are rarely below an object."""

LEAST_GAIN = 0.02
"""Of the likely light: a look that shows less is not worth a word."""

# ------------------------------------------------------------------------------------------------ what is not known yet


@dataclass(frozen=True, eq=False)
class KnownRoom:
    """All that the frames of a path show, for the question what they do not.

    Parameters
    ----------
    points_m : (P, 3) world, metres; what has no distance, such as the sky, lies `FAR_M` from where it was seen
    places_m : (F, 3) of the phone
    """

    points_m: ArrayF64
    places_m: ArrayF64

    @classmethod
    def of_frames(cls, clouds: Iterable[PointCloud], n_points: int) -> KnownRoom:
        """Of unprojected frames, each with its `grid`; of their points, `n_points` in all, an even share is taken:
        100,000 or less."""
        step = max(1, math.ceil(n_points / MOST_POINTS))
        points, places = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for cloud in clouds:  # Not kept: those of a long path take gigabytes.
            points += _points_of(cloud, step)
            places += [] if cloud.grid is None else [cloud.grid.camera_m[None]]
        return cls(np.concatenate(points), np.concatenate(places))

    def nearest_m(self, place_m: ArrayF64, lattice: AnchorLattice) -> ArrayF64:
        """(N,) distance of the nearest known point in the direction of each anchor from `place_m`; 0 where none is."""
        relative = self.points_m - place_m
        distance_m = np.linalg.norm(relative, axis=1)
        nearest_m = np.full(lattice.n, np.inf)
        is_usable = distance_m > 0
        np.minimum.at(nearest_m, lattice.nearest(relative[is_usable]), distance_m[is_usable])
        return np.where(np.isfinite(nearest_m), nearest_m, 0.0)

    def hull_m(self, lattice: AnchorLattice) -> ArrayF64:
        """(N,) how far the room reaches along each anchor's direction, as its support function about the origin."""
        step = max(1, math.ceil(len(self.points_m) / MOST_HULL_POINTS))
        # Row by row, and in place: along the columns it takes twice as long, of 100 MB.
        heights = lattice.directions @ self.points_m[::step].T
        seen = np.full(lattice.n, -np.inf)
        if heights.size:
            seen = np.percentile(heights, HULL_SHARE, axis=1, overwrite_input=True)
        free = (self.places_m @ lattice.directions.T).max(axis=0, initial=-np.inf) + FREE_M
        return np.maximum(seen, free)


def _points_of(cloud: PointCloud, step: int) -> Iterator[ArrayF64]:
    points = cloud.points_m[::step].astype(np.float64)
    yield points[np.isfinite(points).all(axis=1)]
    if cloud.grid is not None and cloud.grid.far is not None:
        yield cloud.grid.camera_m + FAR_M * cloud.grid.far.rays.T[::step].astype(np.float64)


@dataclass(frozen=True, eq=False)
class Unseen:
    """What is guessed of the directions that were not seen from one position.

    Parameters
    ----------
    cloud : what was seen by the end of the path, N anchors
    points_m : (N, 3) world, metres: where each anchor's surface is, or may be
    radiance : (N, 3) linear, at the session's exposure: the light from there, or what may come from there
    weight : (N,) share of the likely light of each anchor; all add up to 1
    """

    cloud: UnitSphereCloud
    points_m: ArrayF64
    radiance: ArrayF64
    weight: ArrayF64

    def with_shown(self, is_shown: ArrayBool, position_m: ArrayF64) -> UnitSphereCloud:
        """The cloud after anchors `is_shown` (N,) have been seen, as far as can be guessed."""
        is_new, old = is_shown & ~self.cloud.is_set, self.cloud
        srgb = np.where(is_new[:, None], linear_to_srgb(self.radiance), old.srgb)
        distance_m = np.where(is_new, np.linalg.norm(self.points_m - position_m, axis=1), old.distance_m)
        surfaces = old.surfaces
        if surfaces is not None:
            surfaces = AnchorSurfaces.of_facing(np.where(is_new, np.float32(1), surfaces.facing))
        return UnitSphereCloud(srgb.clip(0, 1), distance_m, old.is_set | is_new, surfaces=surfaces)


def guess_unseen(cloud: UnitSphereCloud, position_m: ArrayF64, hull_m: ArrayF64, lattice: AnchorLattice) -> Unseen:
    """Guess what lies where `cloud` at `position_m` ((3,), world, metres) has seen nothing; `hull_m` (N,) as above."""
    reach_m = _hull_exit_m(hull_m - lattice.directions @ position_m, lattice)
    distance_m = np.where(cloud.is_set, cloud.distance_m, reach_m)
    radiance = likely_radiance(cloud, lattice)
    light = radiance @ LUMINANCE
    light = (light + light.mean()) * np.where(lattice.directions[:, 2] > 0, 1.0, BELOW)
    total = light.sum()
    weight = light / total if total > 0 else np.full(lattice.n, 1 / lattice.n)
    return Unseen(cloud, position_m + lattice.directions * distance_m[:, None], radiance, weight)


def _hull_exit_m(support_m: ArrayF64, lattice: AnchorLattice) -> ArrayF64:
    """(N,) where rays from a position leave the hull whose support about that position is (N,); at least 0.1 m.

    A ray along d leaves the half-space of direction n at support(n) / (d . n); the first of all counts. A position
    outside widens the hull by a ball around it, of the radius by which it is outside, `FREE_M` at most: else all that
    is unseen around it would be guessed to lie at the position itself, which a look shows at once or not at all.
    """
    cosines = lattice.directions @ lattice.directions.T
    support_m = np.maximum(support_m, np.clip(-support_m.min(), 0.1, FREE_M))
    exits = np.where(cosines > 0.05, support_m / np.maximum(cosines, 0.05), np.inf)
    nearest: ArrayF64 = exits.min(axis=1)
    return np.where(np.isfinite(nearest), nearest, FAR_M).clip(0.1, FAR_M)


def likely_radiance(cloud: UnitSphereCloud, lattice: AnchorLattice) -> ArrayF64:
    """(N, 3) linear: what was seen where an anchor is set, elsewhere the mean of what was seen around it, near first.

    All 0 where nothing was seen.
    """
    seen = srgb_to_linear(cloud.srgb.astype(np.float64))
    nearness = np.exp(NEAR * (lattice.directions[~cloud.is_set] @ lattice.directions[cloud.is_set].T - 1))
    total = nearness.sum(axis=1, keepdims=True)
    radiance = np.where(cloud.is_set[:, None], seen, 0.0)
    if nearness.size:
        radiance[~cloud.is_set] = nearness @ seen[cloud.is_set] / np.maximum(total, 1e-300)
    return radiance


def shown_by(
    poses: Sequence[ArrayF64], unseen: Unseen, known_m: ArrayF64, intrinsics: Intrinsics, lattice: AnchorLattice
) -> ArrayBool:
    """(N,) anchors, not set now, that frames at `poses`, (4, 4) world_from_camera at one place, would set.

    `known_m` (N,) is `KnownRoom.nearest_m` from that place: where something is known, it is in the way of what is
    guessed, or would be seen through it.
    """
    candidates = np.flatnonzero(~unseen.cloud.is_set)
    shown = np.zeros(len(unseen.cloud), bool)
    points_m = unseen.points_m[candidates]
    in_a_picture = np.zeros(len(candidates), bool)
    for pose in poses:
        in_a_picture |= in_view(points_m, intrinsics, pose)
    is_unknown = known_m[lattice.nearest(points_m - poses[0][:3, 3])] == 0
    shown[candidates] = in_a_picture & is_unknown
    return shown


# ----------------------------------------------------------------------------------------------------------- the advice


@dataclass(frozen=True, eq=False)
class Advice:
    """The best look, and what it would show of each position.

    Parameters
    ----------
    look : the best of those that were tried
    gain : share of the likely light that it would show newly, mean over the positions
    shown : (K, N) anchors that it would set, of each position
    """

    look: Look
    gain: float
    shown: ArrayBool

    @property
    def is_worth_it(self) -> bool:
        return self.gain >= LEAST_GAIN


def choose_look(
    looks: Sequence[Look], unseen: Sequence[Unseen], room: KnownRoom, intrinsics: Intrinsics,
    lattice: AnchorLattice, settings: LookSettings,
) -> Advice:  # fmt: skip
    """The look that would show the most of the likely light of all positions, whose `unseen` parts are given.

    Of looks that show as much, the first. ValueError without a look or a position.
    """
    if not looks or not unseen:
        raise ValueError(f"choose_look: expected looks and positions, got {len(looks)} and {len(unseen)}")
    best: Advice | None = None
    known_m: dict[int, ArrayF64] = {}
    for look in looks:
        if look.frame not in known_m:
            known_m[look.frame] = room.nearest_m(look.start[:3, 3], lattice)
        poses = look.poses(settings)
        shown = np.array([shown_by(poses, one, known_m[look.frame], intrinsics, lattice) for one in unseen])
        gain = float(np.mean([one.weight[of_one].sum() for one, of_one in zip(unseen, shown, strict=True)]))
        if best is None or gain > best.gain:
            best = Advice(look, gain, shown)
    assert best is not None
    return best
