"""Unseen light: the error of an estimate if all that nobody saw were known, or all that was seen.

    python addon_tests/bench/unseen_light.py ROOMS... [--estimator lattice]

Each folder holds rooms as `xihe dataset build` or `infinigen_room.py` leaves them. Clipped light (LDR), SHC RMSE over
the clouds of a room, the mean of the rooms, from one view and from all, in numbers and over that of `ambient`:

    as it is        the estimator on the sampled anchors
    unseen known    anchors that no view set have their true colour, the others what was sampled; projected. No guess of
                    what is unseen can do better, unless it mends what was seen too.
    seen known      the estimator, with the true colour in each anchor that is set: what guessing alone costs
    both known      the true colour in every anchor: what 1280 anchors and a smoothed mirror ball cost
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
from given import given

from xihenet import estimators
from xihenet.buffers import merge_in_sight
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.estimators.ambient import constant_light
from xihenet.estimators.base import Estimator
from xihenet.mirror_ball import seen_in_ball
from xihenet.records import UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sh import anchor_basis
from xihenet.sphere import AnchorLattice
from xihenet.training.rooms import TrainingRoom, read_room, room_files

LATTICE = AnchorLattice(1280)
KINDS = ("as it is", "unseen known", "seen known", "both known", "ambient")


def lights_of(cloud: UnitSphereCloud, true_srgb: np.ndarray, ambient: np.ndarray, estimator: Estimator) -> np.ndarray:
    """(5, 9, 3) by `KINDS`; ambient (3,) is the mean of the pictures."""
    known = cloud.is_set[:, None]
    basis = anchor_basis(LATTICE, 2)

    def project(srgb: np.ndarray) -> np.ndarray:
        return np.asarray(4 * np.pi / len(srgb) * basis.T @ srgb_to_linear(srgb))

    seen_known = replace(cloud, srgb=(true_srgb * known).astype(np.float32))
    guesses = [estimator.estimate(one) for one in (cloud, seen_known)]
    return np.array(
        [
            guesses[0],
            project(np.where(known, cloud.srgb, true_srgb)),
            guesses[1],
            project(true_srgb),
            constant_light(ambient),
        ]
    )


def errors_of(room: TrainingRoom, estimator: Estimator) -> list[np.ndarray]:
    """Of one view and of all: (5,) root mean square over the clouds."""
    squares: list[list[np.ndarray]] = [[], []]
    means = [srgb_to_linear(view.srgb).mean(axis=0) for view in room.views]
    for index, position in enumerate(room.positions_m):
        sampled = [sample_unit_sphere(view, position, LATTICE) for view in room.views]
        true_srgb = linear_to_srgb(np.clip(seen_in_ball(room.balls[index], LATTICE.directions), 0, 1))
        cases = [(0, sampled[view], means[view]) for view in np.flatnonzero(room.is_in_view[:, index])]
        for is_all, cloud, ambient in [*cases, (1, reduce(merge_in_sight, sampled), np.mean(means, axis=0))]:
            lights = lights_of(cloud, true_srgb, ambient, estimator)
            squares[is_all].append(((lights - room.sh_ldr[index]) ** 2).mean(axis=(1, 2)))
    return [np.sqrt(np.mean(one, axis=0)) for one in squares if one]


def main() -> None:
    options = given(__doc__, "rooms+", estimator="lattice")
    estimator = estimators.load(options.estimator)
    errors = []
    for path in (path for folder in options.rooms for path in room_files(folder)):
        errors.append(errors_of(read_room(path), estimator))
    for i, views in enumerate(("one view", "all views")):
        mean = np.mean([one[i] for one in errors if len(one) == 2], axis=0)
        print(f"{views}, mean of {len(errors)} rooms (over ambient's):")
        for kind, error in zip(KINDS, mean, strict=True):
            print(f"    {kind:14s}{error:.4f}  {error / mean[-1]:.2f}")


if __name__ == "__main__":
    main()
