"""Hard cases of the trigger: thresholds of 0 and of infinity, flicker, noise, and what is NaN."""

from dataclasses import replace
from typing import Any

import numpy as np

from addon_tests.hard_case import Must, each, equal, refused, row, that
from xihenet.codec import decode_cloud, encode_cloud
from xihenet.records import PointCloud, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
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
    decision = decide_trigger(previous, current, AnchorLattice(len(current)), settings)
    assert decision.fire == (decision.reason != "none")
    return decision.reason


def by_hand(given: tuple[Any, UnitSphereCloud, TriggerSettings]) -> str:
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


def fires(name: str, previous: Any, current: UnitSphereCloud, settings: Any, must: Must, naive: Any = None) -> Any:
    return row(name, (previous, current, settings), decided, must, naive)


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


def turned_nan(policy: Any) -> str:
    """A change everywhere, one anchor of which turns NaN in the caller's array after the record checked it."""
    srgb = np.full((N, 3), 0.9, np.float32)
    current = UnitSphereCloud(srgb, np.ones(N), np.ones(N, bool))
    srgb[7] = np.nan
    return decided((BLACK, current, TriggerSettings(policy=policy)))


def turned_nan_by_hand(policy: Any) -> str:
    change = np.full(N, 0.81)
    change[7] = np.nan
    return "colour" if change[LATTICE.neighbours(4)].mean(axis=1).max() > 0.6 else "none"


def nan_pixel(value: float) -> str:
    """A wall that turns white but for one broken point."""
    points = LATTICE.directions * 2.0
    colours = np.full((N, 3), 0.95)
    colours[5] = value
    return decided((BLACK, sample_unit_sphere(PointCloud(points, colours), np.zeros(3), LATTICE), DEFAULT))


def nan_pixel_by_hand(value: float) -> str:
    colours = np.full((N, 3), 0.95)
    colours[5] = value
    return "colour" if (colours**2).max() > 0.6 else "none"


def reason_with_lattice(n: int) -> str:
    return decide_trigger(BLACK, WHITE, AnchorLattice(n), DEFAULT).reason


NOTHING = UnitSphereCloud.empty(N)
WIRED, SHARES = on_the_wire(ROOM), (cloud_of(1.0, HALF), cloud_of(0.1, ~HALF))
FIRST_ALONE = cloud_of(1.0, np.arange(N) == 0)
CODE_128, CODE_129 = cloud_of(128 / 255), cloud_of(129 / 255)
AT_0, AT_1E_5, BELOW_1, AT_1, AT_INFINITY = (TriggerSettings(theta=theta) for theta in (0, 1e-5, 0.9999, 1, np.inf))
PAPER_AT_0 = replace(REFERENCE, theta=0)
NO_COVERAGE, WIDE = replace(DEFAULT, coverage_theta=1), replace(DEFAULT, n_neighbours=10_000)
WRONG = [("theta", np.nan), ("theta", -1.0), ("hysteresis", np.inf), ("ignored_share", 1.0), ("n_neighbours", 0)]
CASES = [
    fires("an identical cloud does not fire at theta 0", ROOM, ROOM, AT_0, NONE, by_hand),
    fires("an identical cloud does not fire at theta 0 by the paper's rule", ROOM, ROOM, PAPER_AT_0, NONE, by_hand),
    fires("an identical cloud does not fire at theta 0 after the wire", WIRED, on_the_wire(WIRED), AT_0, NONE, by_hand),
    fires("a cloud against itself after the wire stays below theta 1e-5", ROOM, WIRED, AT_1E_5, NONE),
    fires("one code of change fires at theta 0", CODE_128, CODE_129, AT_0, COLOUR),
    fires("black to white does not fire at an infinite theta", BLACK, WHITE, AT_INFINITY, NONE, excess_by_hand),
    fires("black to white does not fire at theta 1, of which it is no more", BLACK, WHITE, AT_1, NONE, by_hand),
    fires("black to white fires at theta just below 1", BLACK, WHITE, BELOW_1, COLOUR),
    fires("a newly seen bright wall is coverage, not colour", DIM_HALF, DIM_ALL, DEFAULT, equal("coverage"), by_hand),
    fires("a newly seen bright wall is colour by the paper's rule", DIM_HALF, DIM_ALL, REFERENCE, COLOUR),
    fires("no cloud before this one fires for being first", None, BLACK, DEFAULT, equal("first")),
    fires("nothing seen does not fire for being first", None, NOTHING, AT_0, NONE),
    fires(
        "nothing seen against a full cloud does not fire by the paper's rule", WHITE, NOTHING, PAPER_AT_0, NONE, by_hand
    ),
    fires("a lattice of one anchor fires when it changes", cloud_of(0, n=1), cloud_of(1, n=1), DEFAULT, COLOUR),
    fires("a window wider than the sphere is the sphere", BLACK, DIM_ALL, WIDE, COLOUR),
    fires("a lamp in one anchor is averaged over its window", BLACK, cloud_of(ONE_LAMP), DEFAULT, NONE, by_hand),
    fires("clouds that share no anchor do not change colour", *SHARES, replace(NO_COVERAGE, theta=0), NONE, by_hand),
    fires(
        "the whole sphere newly seen does not fire at a coverage threshold of 1",
        FIRST_ALONE,
        WHITE,
        NO_COVERAGE,
        NONE,
        by_hand,
    ),
    row(
        "clouds without anchors do not fire",
        (UnitSphereCloud.empty(0), UnitSphereCloud.empty(0), DEFAULT),
        lambda given: decide_trigger(*given[:2], LATTICE, given[2]).reason,
        NONE,
        by_hand,
    ),
    *(
        row(f"firing falls once as theta rises{by}", policy, fires_over_theta, FALLS_ONCE, fires_over_dithered_theta)
        for by, policy in (("", "split"), (" by the papers rule", "reference"))
    ),
    row(
        "light far above the threshold fires in every frame in spite of hysteresis",
        STEADY,
        lambda settings: flickering(settings, 0.6),
        equal([True] * 10),
    ),
    row(
        "light that flickers around the threshold fires every other frame at most",
        STEADY,
        fires_for_flicker,
        that("at most 50 of 100", lambda came: 0 < came <= 50),
        lambda settings: fires_for_flicker(replace(settings, hysteresis=0.0)),
    ),
    *(
        row(f"{field} of {value} is refused", {field: value}, lambda wrong: TriggerSettings(**wrong), refused(field))
        for field, value in WRONG
    ),
    *(
        row(f"one anchor that turned nan does not {what}", policy, turned_nan, COLOUR, turned_nan_by_hand)
        for what, policy in (("keep the others from firing", "split"), ("stop the papers rule", "reference"))
    ),
    row("one nan point does not keep a changed wall from firing", np.nan, nan_pixel, COLOUR, nan_pixel_by_hand),
    *(
        row(
            f"a lattice of {fewer} anchors than the clouds is refused",
            n,
            reason_with_lattice,
            refused(f"the lattice has {n} anchors and the clouds 256"),
        )
        for fewer, n in (("more", 512), ("fewer", 128))
    ),
    fires("clouds of different sizes are refused", cloud_of(0.5, n=1), GREY, DEFAULT, refused("1 and 256 anchors")),
]

test_hard_case = each(CASES)
