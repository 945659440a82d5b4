"""Hard cases of the estimators: light at both ends of its range, next to nothing seen, half-float weights, sessions."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from addon_tests.pure.hard_cases.hard_case import HardCase, at_most, equal, near, refused
from xihenet.colour import srgb_to_linear
from xihenet.estimators import Estimator, load
from xihenet.records import UnitSphereCloud
from xihenet.sh_basis import basis
from xihenet.sphere import AnchorLattice

STAGE = "estimate"
N = 1280
WHITE_LIGHT = float(np.sqrt(4 * np.pi))
"""The coefficient of white light from everywhere; clipped light has no larger one."""

HDR_BOUND = 4 * WHITE_LIGHT
"""Light that was clipped at white may have been brighter; four times white from everywhere is beyond any room."""


@cache
def estimator(name: str = "lattice", n: int = N, target: Any = "ldr") -> Estimator:
    return load(name, n, target)


def cloud_of(srgb: Any, distance_m: Any = 2.0, is_set: Any = True, n: int = N) -> UnitSphereCloud:
    known = np.broadcast_to(is_set, n)
    colours = np.broadcast_to(np.asarray(srgb, float), (n, 3)) * known[:, None]
    return UnitSphereCloud(colours, np.broadcast_to(distance_m, n) * known, known)


RNG = np.random.default_rng(0)
NOISE = RNG.random((N, 3))
ANCHORS = np.arange(N)
ONE, HALF, EVEN = ANCHORS == 400, ANCHORS < N // 2, ANCHORS % 2 == 0
DARK = {
    "all black": cloud_of(0.0),
    "denormal colours": cloud_of(NOISE * 1e-40),
    "colours of 1e-30": cloud_of(NOISE * 1e-30),
    "colours of a single code": cloud_of((NOISE > 0.5) / 255),
}
PATTERNS = {
    "one white anchor in black": cloud_of(ONE[:, None] * 1.0),
    "one black anchor in white": cloud_of(~ONE[:, None] * 1.0),
    "a white half beside a black one": cloud_of(HALF[:, None] * 1.0),
    "black and white by turns": cloud_of(EVEN[:, None] * 1.0),
    "one white anchor in a black half": cloud_of(ONE[:, None] * 1.0, 2.0, HALF),
    "saturated colours by turns": cloud_of(np.eye(3)[ANCHORS % 3]),
}
DISTANCES = {
    "noise at no distance": cloud_of(NOISE, 0.0),
    "noise at 1e-45 m": cloud_of(NOISE, 1e-45),
    "noise at 65,504 m": cloud_of(NOISE, 65504.0),
    "noise at 1e10 m": cloud_of(NOISE, 1e10),
    "noise at 3e38 m": cloud_of(NOISE, 3e38),
    "noise at 1e-30 m and 3e38 m": cloud_of(NOISE, np.where(HALF, 1e-30, 3e38)),
}
CLOUDS = DARK | PATTERNS | DISTANCES


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


EXTREMES = [
    HardCase(
        STAGE,
        f"the light from {name} is plausible ({target})",
        cloud,
        partial(largest, target=target),
        at_most(bound),
        naive,
    )
    for group, naive, of_ldr, of_hdr in (
        (DARK, relative_in_half, 0.01, 0.01),
        (PATTERNS, sun_where_clipped, WHITE_LIGHT, HDR_BOUND),
        (DISTANCES, by_log_distance, WHITE_LIGHT, WHITE_LIGHT),
    )
    for name, cloud in group.items()
    for target, bound in (("ldr", of_ldr), ("hdr", of_hdr))
]

# ------------------------------------------------------------------------------------------------- what must come out


def light_of(name: str) -> Callable[[UnitSphereCloud], np.ndarray]:
    return lambda cloud: estimator(name, len(cloud)).estimate(cloud)


def mean_of_all(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over all anchors, unset ones black."""
    return np.concatenate([[cloud.srgb.mean(axis=0) * WHITE_LIGHT], np.zeros((8, 3))])


def mean_of_set(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: the mean over the set anchors, of which there may be none."""
    return np.concatenate([[cloud.srgb[cloud.is_set].sum(axis=0) / cloud.is_set.sum()], np.zeros((8, 3))])


def constant(radiance: float) -> np.ndarray:
    return np.concatenate([np.full((1, 3), radiance * WHITE_LIGHT), np.zeros((8, 3))])


def summed_over_set(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: what is set stands for the whole sphere."""
    seen = basis(AnchorLattice(len(cloud)).directions)[cloud.is_set]
    return seen.T @ cloud.srgb[cloud.is_set] * (4 * np.pi / cloud.is_set.sum())


NOTHING = UnitSphereCloud.empty(N)
WHITE_ABOVE, ONE_WHITE = cloud_of(1.0, 2.0, HALF), cloud_of(1.0, 2.0, ONE)
KNOWN = [
    *(
        HardCase(
            STAGE,
            f"white above and nothing known of below is white to {name}",
            WHITE_ABOVE,
            light_of(name),
            near(constant(1.0), 1e-5),
            summed_over_set,
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE, f"nothing seen is black to {name}", NOTHING, light_of(name), equal(np.zeros((9, 3))), mean_of_set
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE,
            f"white seen in one anchor is white from everywhere to {name}",
            ONE_WHITE,
            light_of(name),
            near(constant(1.0), 1e-5),
            mean_of_all,
        )
        for name in ("lattice", "projection", "ambient")
    ),
    *(
        HardCase(
            STAGE,
            f"a lattice of {n:,} anchors sees white as white",
            cloud_of(1.0, 2.0, np.arange(n) % 2 == 0, n),
            light_of("lattice"),
            near(constant(1.0), 1e-5),
            mean_of_all,
        )
        for n in (2, 3, 512, 65_535)
    ),
    HardCase(
        STAGE,
        "a lattice of one anchor sees white as white",
        cloud_of(1.0, n=1),
        light_of("lattice"),
        near(constant(1.0), 1e-5),
        lambda cloud: light_by_formula(cloud),
    ),
    HardCase(
        STAGE,
        "a cloud of another size is refused",
        UnitSphereCloud.empty(640),
        lambda cloud: estimator().estimate(cloud),
        refused("made for 1280 anchors, got a cloud of 640"),
        lambda cloud: cloud.srgb.sum(),
    ),
]


def light_by_formula(cloud: UnitSphereCloud) -> np.ndarray:
    """Naive: anchors by the lattice's formula, which divides by the number of anchors less one."""
    z = 1 - 2 * np.arange(len(cloud)) / np.float64(len(cloud) - 1)
    return constant(float(z.mean()))


CASES = [*EXTREMES, *KNOWN]
