"""Hard cases of the least squares on the anchors: too few, all on one side, all alike, and at odds with each other."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from addon_tests.hard_case import at_most, each, equal, near, refused, row
from xihenet.colour import linear_to_srgb, srgb_to_linear
from xihenet.records import UnitSphereCloud
from xihenet.sh import basis, project_anchors
from xihenet.sphere import AnchorLattice

STAGE = "least squares"
CONSTANT = np.sqrt(4 * np.pi)
N = 1280
LATTICE = AnchorLattice(N)
BOUND = 5.0
"""White from everywhere has a coefficient of 3.5; what is plausible stays below this."""


@dataclass(frozen=True, eq=False)
class Given:
    """A cloud and the anchors it is on."""

    radiance: np.ndarray
    is_set: np.ndarray
    lattice: Any = LATTICE

    @property
    def cloud(self) -> UnitSphereCloud:
        known = np.broadcast_to(self.is_set, len(self.lattice.directions))
        srgb = linear_to_srgb(np.broadcast_to(self.radiance, (len(known), 3))) * known[:, None]
        return UnitSphereCloud(srgb, known * 1.0, known)


@dataclass(frozen=True, eq=False)
class Anchors:
    """Any directions, for fits on what no lattice gives."""

    directions: np.ndarray


def fitted(given: Given, order: int = 2) -> np.ndarray:
    return project_anchors(given.cloud, given.lattice, order)


def fitted_plainly(given: Given, order: int = 2) -> np.ndarray:
    """Naive: the normal equations as the textbook has them."""
    cloud = given.cloud
    seen = basis(given.lattice.directions, order)[cloud.is_set]
    return np.linalg.solve(seen.T @ seen, seen.T @ srgb_to_linear(cloud.srgb[cloud.is_set].astype(float)))


def summed_plainly(given: Given) -> np.ndarray:
    """Naive: a sum over the set anchors, as if they were the whole sphere."""
    cloud = given.cloud
    radiance = srgb_to_linear(cloud.srgb[cloud.is_set].astype(float))
    return basis(given.lattice.directions)[cloud.is_set].T @ radiance * (4 * np.pi / max(len(radiance), 1))


def size(given: Given, order: int = 2) -> float:
    """The largest coefficient."""
    return float(np.abs(fitted(given, order)).max())


def size_plainly(given: Given, order: int = 2) -> float:
    return float(np.abs(fitted_plainly(given, order)).max())


def size_summed(given: Given) -> float:
    return float(np.abs(summed_plainly(given)).max())


def miss(given: Given) -> float:
    """How far the fit is from the light that was seen, root mean square over the set anchors."""
    cloud = given.cloud
    there = basis(given.lattice.directions)[cloud.is_set] @ fitted(given)
    return float(np.sqrt(((there - srgb_to_linear(cloud.srgb[cloud.is_set].astype(float))) ** 2).mean()))


def only(*numbers: int, n: int = N) -> np.ndarray:
    return np.isin(np.arange(n), numbers)


def linear_light(n: int) -> np.ndarray:
    """(n,) light that rises from 0.1 below to 0.9 above."""
    return 0.5 + 0.4 * AnchorLattice(n).directions[:, 2]


def given_back(n: int) -> float:
    """Error of a fit of light that order 2 can hold, on all anchors."""
    truth = np.zeros(9)
    truth[0], truth[2] = 0.5 * CONSTANT, 0.4 * np.sqrt(4 * np.pi / 3)
    return float(np.abs(fitted(Given(linear_light(n)[:, None], True, AnchorLattice(n)))[:, 0] - truth).max())


def summed_in_half(n: int) -> float:
    """Naive: a sum over all anchors in half floats."""
    light, z = linear_light(n).astype(np.float16), AnchorLattice(n).directions[:, 2].astype(np.float16)
    return float(np.abs(np.cumsum(light * z, dtype=np.float16)[-1] * (4 * np.pi / n) - 0.4 * 4 * np.pi / 3).max())


Z = LATTICE.directions[:, 2]
NOISE = np.random.default_rng(0).random((N, 3))
UPPER, EQUATOR, STRIPE = Z > 0, np.abs(Z) < 0.01, np.abs(LATTICE.directions[:, 0]) < 0.02
CAP = Z > 0.97
LINE = Anchors(np.stack([np.cos(np.linspace(0, 1, 40)), np.sin(np.linspace(0, 1, 40)), np.zeros(40)], axis=1))
ONE_PLACE = Anchors(np.tile([[0.6, 0.0, 0.8]], (40, 1)))
AT_ODDS = np.where(np.arange(40) % 2, 1.0, 0.0)[:, None]
FLAT = np.array([0.25, 0.5, 1.0])
FLAT_SH = np.zeros((9, 3))
FLAT_SH[0] = srgb_to_linear(linear_to_srgb(FLAT).astype(np.float32).astype(float)) * CONSTANT
PLACES = {
    "two neighbours": Given(FLAT, only(77, 78)),
    "nine anchors, as many as coefficients": Given(FLAT, only(*range(0, 1280, 143))),
    "the equator": Given(FLAT, EQUATOR),
    "a line": Given(FLAT, True, LINE),
    "one place, forty times": Given(FLAT, True, ONE_PLACE),
}
NOISY = {
    "a cap of 1.5 % of the sphere": Given(NOISE, CAP),
    "nine anchors": Given(NOISE, only(*range(600, 609))),
    "two neighbours": Given(NOISE, only(600, 601)),
    "one line": Given(NOISE, STRIPE),
    "the equator": Given(NOISE, EQUATOR),
}
BOUNDED, BOUNDED_BY_WHITE = at_most(BOUND), at_most(CONSTANT)
DARKEST = float(srgb_to_linear(1 / 255))
DISPUTED = Given(AT_ODDS, True, ONE_PLACE)
ORDER_10 = partial(size, order=10), BOUNDED, partial(size_plainly, order=10)
CASES = [
    row("no anchor gives black", Given(FLAT, False), fitted, equal(np.zeros((9, 3))), fitted_plainly),
    *(
        row(f"constant light seen from {name} is constant", given, fitted, near(FLAT_SH, 1e-9), summed_plainly)
        for name, given in PLACES.items()
    ),
    *(row(f"noise on {name} stays bounded", given, size, BOUNDED, size_plainly) for name, given in NOISY.items()),
    row(
        "a white half beside a black one is bounded by white",
        Given(UPPER[:, None] * 1.0, True),
        size,
        BOUNDED_BY_WHITE,
        lambda given: size_summed(Given(given.radiance, UPPER)),
    ),
    row(
        "one white anchor in a black half is bounded by white",
        Given(only(3)[:, None] * 1.0, UPPER),
        size,
        at_most(CONSTANT * 0.1),
        lambda given: size_summed(Given(1.0, only(3))),
    ),
    row("65535 anchors give back the light they were lit by", 65_535, given_back, at_most(1e-5), summed_in_half),
    row(
        "black and white in one place are their mean",
        DISPUTED,
        lambda given: fitted(given)[0],
        near([0.5 * CONSTANT] * 3, 1e-6),
        lambda given: fitted_plainly(given)[0],
    ),
    row("black and white in one place leave the error that they have", DISPUTED, miss, near(0.5, 1e-9), size_plainly),
    row("order 10 on a cap stays bounded", Given(NOISE, CAP), *ORDER_10),
    row("order 10 on five anchors stays bounded", Given(NOISE[:5], True, AnchorLattice(5)), *ORDER_10),
    row(
        "the darkest code on the whole sphere is not lost",
        Given(DARKEST, True),
        lambda given: float(fitted(given)[0, 0] / CONSTANT),
        near(DARKEST, 1e-10),
        lambda given: float(fitted_plainly(given)[0, 0].astype(np.float16) / CONSTANT),
    ),
    row(
        "a cloud of another lattice is refused",
        UnitSphereCloud.empty(640),
        lambda cloud: project_anchors(cloud, LATTICE),
        refused("1280 anchors, got 640"),
    ),
]

test_hard_case = each(CASES)
