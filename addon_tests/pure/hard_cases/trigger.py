"""Hard cases of the trigger: thresholds of 0 and of infinity, flicker, noise, and what is NaN."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from addon_tests.pure.hard_cases.hard_case import HardCase, equal, refused, that
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.records import UnitSphereCloud
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, decide_trigger

STAGE = "trigger"
N = 256
LATTICE = AnchorLattice(N)
DEFAULT = TriggerSettings()
REFERENCE = TriggerSettings(policy="reference")


def cloud_of(srgb: Any, is_set: Any = True, n: int = N) -> UnitSphereCloud:
    known = np.broadcast_to(is_set, n)
    return UnitSphereCloud(np.broadcast_to(np.asarray(srgb, float), (n, 3)) * known[:, None], known * 1.0, known)


def decided(given: tuple[Any, UnitSphereCloud, TriggerSettings]) -> str:
    """The reason, which is "none" where nothing fires."""
    previous, current, settings = given
    return decide_trigger(previous, current, AnchorLattice(len(current)), settings).reason


def decided_by_hand(given: tuple[Any, UnitSphereCloud, TriggerSettings]) -> str:
    """Naive: fires where the mean colour moves by as much as theta, unset anchors being black."""
    previous, current, settings = given
    change = ((current.srgb - previous.srgb) ** 2).max()
    return "colour" if not change < settings.theta else "none"


def excess_by_hand(given: tuple[Any, UnitSphereCloud, TriggerSettings]) -> str:
    """Naive: fires where the change exceeds theta by a share of theta that is not below 0."""
    change = ((given[1].srgb - given[0].srgb) ** 2).max()
    return "none" if (change - given[2].theta) / given[2].theta < 0 else "colour"


RNG = np.random.default_rng(0)
ROOM = cloud_of(RNG.random((N, 3)), RNG.random(N) < 0.7)
NONE, COLOUR = equal("none"), equal("colour")
GREY, BLACK, WHITE = cloud_of(0.5), cloud_of(0.0), cloud_of(1.0)
HALF = np.arange(N) < N // 2
DIM_HALF, DIM_ALL = cloud_of(0.9, HALF), cloud_of(0.9)
ONE_LAMP = np.where(np.arange(N) == 77, 1.0, 0.0)[:, None] * np.ones(3)


def on_the_wire(cloud: UnitSphereCloud) -> UnitSphereCloud:
    return decode_cloud(encode_cloud(cloud), len(cloud))


FIRING = [
    HardCase(
        STAGE,
        "an identical cloud does not fire at theta 0",
        (ROOM, ROOM, TriggerSettings(theta=0)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "an identical cloud does not fire at theta 0 by the paper's rule",
        (ROOM, ROOM, replace(REFERENCE, theta=0)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "an identical cloud does not fire at theta 0 after the wire",
        (on_the_wire(ROOM), on_the_wire(on_the_wire(ROOM)), TriggerSettings(theta=0)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "a cloud against itself after the wire stays below theta 1e-5",
        (ROOM, on_the_wire(ROOM), TriggerSettings(theta=1e-5)),
        decided,
        NONE,
        lambda given: "none" if np.array_equal(given[0].srgb, given[1].srgb) else "colour",
    ),
    HardCase(
        STAGE,
        "one code of change fires at theta 0",
        (cloud_of(128 / 255), cloud_of(129 / 255), TriggerSettings(theta=0)),
        decided,
        COLOUR,
        lambda given: (
            "colour"
            if np.any(given[0].srgb.astype(np.float16) ** 2 - given[1].srgb.astype(np.float16) ** 2 > 0)
            else "none"
        ),
    ),
    HardCase(
        STAGE,
        "black to white does not fire at an infinite theta",
        (BLACK, WHITE, TriggerSettings(theta=np.inf)),
        decided,
        NONE,
        excess_by_hand,
    ),
    HardCase(
        STAGE,
        "black to white does not fire at theta 1, of which it is no more",
        (BLACK, WHITE, TriggerSettings(theta=1)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "black to white fires at theta just below 1",
        (BLACK, WHITE, TriggerSettings(theta=0.9999)),
        decided,
        COLOUR,
        lambda given: (
            "colour"
            if ((given[1].srgb - given[0].srgb).astype(np.float16) ** 2).mean() > np.float16(given[2].theta)
            else "none"
        ),
    ),
    HardCase(
        STAGE,
        "a newly seen bright wall is coverage, not colour",
        (DIM_HALF, DIM_ALL, DEFAULT),
        decided,
        equal("coverage"),
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "a newly seen bright wall is colour by the paper's rule",
        (DIM_HALF, DIM_ALL, REFERENCE),
        decided,
        COLOUR,
        lambda given: decided((*given[:2], DEFAULT)),
    ),
    HardCase(
        STAGE,
        "no cloud before this one fires for being first",
        (None, BLACK, DEFAULT),
        decided,
        equal("first"),
        lambda given: decided_by_hand((BLACK, *given[1:])),
    ),
    HardCase(
        STAGE,
        "nothing seen does not fire for being first",
        (None, UnitSphereCloud.empty(N), TriggerSettings(theta=0)),
        decided,
        NONE,
        lambda given: "first" if given[0] is None else "none",
    ),
    HardCase(
        STAGE,
        "nothing seen against a full cloud does not fire by the paper's rule",
        (WHITE, UnitSphereCloud.empty(N), replace(REFERENCE, theta=0)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "clouds without anchors do not fire",
        (UnitSphereCloud.empty(0), UnitSphereCloud.empty(0), DEFAULT),
        lambda given: decide_trigger(*given[:2], LATTICE, given[2]).reason,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "a lattice of one anchor fires when it changes",
        (cloud_of(0, n=1), cloud_of(1, n=1), DEFAULT),
        decided,
        COLOUR,
        lambda given: str(((given[1].srgb - given[0].srgb) ** 2)[LATTICE.neighbours(4)[0]].mean()),
    ),
    HardCase(
        STAGE,
        "a window wider than the sphere is the sphere",
        (BLACK, cloud_of(0.9), replace(DEFAULT, n_neighbours=10_000)),
        decided,
        COLOUR,
        lambda given: decided_by_hand(given) + str(LATTICE.neighbours(given[2].n_neighbours).shape),
    ),
    HardCase(
        STAGE,
        "a lamp in one anchor is averaged over its window",
        (BLACK, cloud_of(ONE_LAMP), DEFAULT),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "clouds that share no anchor do not change colour",
        (cloud_of(1.0, HALF), cloud_of(0.1, ~HALF), replace(DEFAULT, theta=0, coverage_theta=1)),
        decided,
        NONE,
        decided_by_hand,
    ),
    HardCase(
        STAGE,
        "the whole sphere newly seen does not fire at a coverage threshold of 1",
        (cloud_of(1.0, np.arange(N) == 0), WHITE, replace(DEFAULT, coverage_theta=1)),
        decided,
        NONE,
        decided_by_hand,
    ),
]

# ------------------------------------------------------------------------------------------- flicker and thresholds


def fires_for_flicker(settings: TriggerSettings) -> int:
    """How often a light fires that flickers a little around the threshold, in 100 frames."""
    last, n_fires = None, 0
    for step in range(100):
        brightness = np.sqrt(settings.theta * (1 + (0.01 if step % 2 else -0.01) + 0.02))
        last = decide_trigger(BLACK, cloud_of(brightness), LATTICE, settings, last=last)
        n_fires += last.fire
    return n_fires


def flickering(settings: TriggerSettings, share: float) -> list[bool]:
    """Whether each of ten frames fires whose change is theta x (1 + share)."""
    last, fired = None, []
    for _ in range(10):
        brightness = np.sqrt(settings.theta * (1 + share))
        last = decide_trigger(BLACK, cloud_of(brightness), LATTICE, settings, last=last)
        fired.append(last.fire)
    return fired


def fires_over_theta(policy: Any) -> list[bool]:
    """Whether a fixed change fires as theta rises."""
    thetas = np.linspace(0, 1, 40)
    return [
        decide_trigger(cloud_of(0.2), cloud_of(0.8), LATTICE, TriggerSettings(theta=float(t), policy=policy)).fire
        for t in thetas
    ]


def fires_over_dithered_theta(_: Any) -> list[bool]:
    """Naive: a little noise on the threshold, against flicker."""
    thetas = np.linspace(0, 1, 40) + np.random.default_rng(0).normal(0, 0.3, 40)
    return (thetas < 0.36).tolist()


FALLS_ONCE = that(
    "fires below its change, never above it", lambda came: came == sorted(came, reverse=True) and len(set(came)) == 2
)
STEADY = TriggerSettings(theta=0.2, hysteresis=0.5)
THRESHOLDS = [
    HardCase(
        STAGE,
        "light that flickers around the threshold fires every other frame at most",
        STEADY,
        fires_for_flicker,
        that("at most 50 of 100", lambda came: 0 < came <= 50),
        lambda settings: fires_for_flicker(replace(settings, hysteresis=0.0)),
    ),
    HardCase(
        STAGE,
        "light far above the threshold fires in every frame in spite of hysteresis",
        STEADY,
        lambda settings: flickering(settings, 0.6),
        equal([True] * 10),
        lambda settings: flickering(replace(settings, hysteresis=1.0), 0.6),
    ),
    HardCase(
        STAGE,
        "firing falls once as theta rises",
        "split",
        fires_over_theta,
        FALLS_ONCE,
        fires_over_dithered_theta,
    ),
    HardCase(
        STAGE,
        "firing falls once as theta rises by the paper's rule",
        "reference",
        fires_over_theta,
        FALLS_ONCE,
        fires_over_dithered_theta,
    ),
    *(
        HardCase(
            STAGE,
            f"{field} of {value} is refused",
            {field: value},
            lambda wrong: TriggerSettings(**wrong),
            refused(field),
            dict,
        )
        for field, value in (
            ("theta", np.nan),
            ("theta", -1.0),
            ("hysteresis", np.inf),
            ("ignored_share", 1.0),
            ("n_neighbours", 0),
        )
    ),
]

CASES = [*FIRING, *THRESHOLDS]
