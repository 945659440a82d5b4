"""Hard cases of the estimators: light at both ends of its range, and next to nothing seen."""

from collections.abc import Callable
from functools import partial

import numpy as np

from addon_tests.hard_case import at_most, each, equal, near, row
from addon_tests.pure.hard_cases.hard_clouds import (
    DARK,
    DISTANCES,
    NOTHING,
    ONE_WHITE,
    PATTERNS,
    WHITE_ABOVE,
    WHITE_LIGHT,
    N,
    cloud_of,
    estimator,
)
from addon_tests.pure.made import constant
from xihenet.colour import srgb_to_linear
from xihenet.records import UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

STAGE = "estimate"
HDR_BOUND = 4 * WHITE_LIGHT
"""Light that was clipped at white may have been brighter; four times white from everywhere is beyond any room."""


def largest(cloud: UnitSphereCloud, target: str) -> float:
    """The largest coefficient; NaN and infinity are refused on the way."""
    sh_radiance, expected_error = estimator("lattice", len(cloud), target).estimate_with_error(cloud)
    assert expected_error is not None and np.isfinite(expected_error) and expected_error >= 0
    return float(np.abs(sh_radiance).max())


def relative_in_half(cloud: UnitSphereCloud) -> float:
    """Naive: light relative to its mean in half floats, as a network likes it, and never scaled back."""
    light = srgb_to_linear(cloud.srgb).astype(np.float16)
    return float((light / light.mean()).max())


def sun_where_clipped(cloud: UnitSphereCloud) -> float:
    """Naive: an anchor at white is taken for a sun of 2e5."""
    light = np.where(cloud.srgb >= 1, 2e5, srgb_to_linear(cloud.srgb))
    return float(np.abs(basis(AnchorLattice(len(cloud)).directions).T @ light * 4 * np.pi / len(cloud)).max())


def by_log_distance(cloud: UnitSphereCloud) -> float:
    """Naive: log distances enter as they come."""
    return float(np.abs(basis(AnchorLattice(N).directions).T @ np.log(cloud.distance_m)).max() * 4 * np.pi / N)


def light_of(name: str) -> Callable[[UnitSphereCloud], np.ndarray]:
    return lambda cloud: estimator(name, len(cloud)).estimate(cloud)


def mean_of_all(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over all anchors, unset ones black."""
    return np.concatenate([[cloud.srgb.mean(axis=0) * WHITE_LIGHT], np.zeros((8, 3))])


def mean_of_set(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over the set anchors, of which there may be none."""
    return np.concatenate([[cloud.srgb[cloud.is_set].sum(axis=0) / cloud.is_set.sum()], np.zeros((8, 3))])


def every_other(n: int) -> UnitSphereCloud:
    """White in every other anchor of `n`."""
    return cloud_of(1.0, 2.0, np.arange(n) % 2 == 0, n)


def summed(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: what is set stands for the whole sphere."""
    seen = basis(AnchorLattice(len(cloud)).directions)[cloud.is_set]
    return seen.T @ cloud.srgb[cloud.is_set] * (4 * np.pi / cloud.is_set.sum())


def light_by_formula(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: anchors by the lattice's formula, which divides by the number of anchors less one."""
    z = 1 - 2 * np.arange(len(cloud)) / np.float64(len(cloud) - 1)
    return constant(float(z.mean()))


LARGEST = {target: partial(largest, target=target) for target in ("ldr", "hdr")}
WHITE, NAMES = near(constant(1.0), 1e-5), ("lattice", "projection", "ambient")
PLAUSIBLE = [
    (DARK, relative_in_half, 0.01, 0.01),
    (PATTERNS, sun_where_clipped, WHITE_LIGHT, HDR_BOUND),
    (DISTANCES, by_log_distance, WHITE_LIGHT, WHITE_LIGHT),
]
CASES = [
    *(
        row(f"the light from {name} is plausible ({target})", cloud, LARGEST[target], at_most(bound), naive)
        for group, naive, of_ldr, of_hdr in PLAUSIBLE
        for name, cloud in group.items()
        for target, bound in (("ldr", of_ldr), ("hdr", of_hdr))
    ),
    *(
        row(f"white above and nothing known of below is white to {n}", WHITE_ABOVE, light_of(n), WHITE, summed)
        for n in NAMES
    ),
    *(
        row(f"nothing seen is black to {name}", NOTHING, light_of(name), equal(np.zeros((9, 3))), mean_of_set)
        for name in NAMES
    ),
    *(
        row(f"white seen in one anchor is white from everywhere to {n}", ONE_WHITE, light_of(n), WHITE, mean_of_all)
        for n in NAMES
    ),
    *(
        row(f"a lattice of {n:,} anchors sees white as white", every_other(n), light_of("lattice"), WHITE, mean_of_all)
        for n in (2, 3, 512, 65_535)
    ),
    row(
        "a lattice of one anchor sees white as white", cloud_of(1.0, n=1), light_of("lattice"), WHITE, light_by_formula
    ),
]

test_hard_case = each(CASES)
