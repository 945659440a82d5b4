"""Hard cases of what the trigger is given: NaN, lattices of another size, and frames of other exposures."""

from __future__ import annotations

from typing import Any

import numpy as np

from addon_tests.pure.hard_cases.hard_case import HardCase, refused, that
from addon_tests.pure.hard_cases.trigger import (
    BLACK,
    COLOUR,
    DEFAULT,
    GREY,
    LATTICE,
    STAGE,
    WHITE,
    N,
    cloud_of,
    decided,
    decided_by_hand,
)
from xihenet.camera import encode_exposed, unproject_frame
from xihenet.records import Intrinsics, PointCloud, RgbdFrame, TriggerDecision, UnitSphereCloud
from xihenet.sampling import sample_unit_sphere
from xihenet.sphere import AnchorLattice
from xihenet.trigger import TriggerSettings, decide_trigger

# ------------------------------------------------------------------------------------------------- NaN and mistakes


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


def reason_with_any_lattice(n: int) -> str:
    """Naive: whatever window comes is taken."""
    change = ((WHITE.srgb - BLACK.srgb) ** 2).mean(axis=1)
    return "colour" if change[AnchorLattice(n).neighbours(4) % N].mean(axis=1).max() > 0.6 else "none"


MISTAKES = [
    HardCase(
        STAGE,
        "one anchor that turned NaN does not keep the others from firing",
        "split",
        turned_nan,
        COLOUR,
        turned_nan_by_hand,
    ),
    HardCase(
        STAGE,
        "one anchor that turned NaN does not stop the paper's rule",
        "reference",
        turned_nan,
        COLOUR,
        turned_nan_by_hand,
    ),
    HardCase(
        STAGE, "one NaN point does not keep a changed wall from firing", np.nan, nan_pixel, COLOUR, nan_pixel_by_hand
    ),
    HardCase(
        STAGE,
        "a lattice of more anchors than the clouds is refused",
        2 * N,
        reason_with_lattice,
        refused("the lattice has 512 anchors and the clouds 256"),
        reason_with_any_lattice,
    ),
    HardCase(
        STAGE,
        "a lattice of fewer anchors than the clouds is refused",
        N // 2,
        reason_with_lattice,
        refused("the lattice has 128 anchors and the clouds 256"),
        reason_with_any_lattice,
    ),
    HardCase(
        STAGE,
        "clouds of different sizes are refused",
        (cloud_of(0.5, n=1), GREY, DEFAULT),
        decided,
        refused("1 and 256 anchors"),
        decided_by_hand,
    ),
]

# ---------------------------------------------------------------------------------------------- exposure alone

CAMERA = Intrinsics(48, 32, 24.0, 24.0, 24.0, 16.0)
PICTURE = np.random.default_rng(8).uniform(0.02, 0.2, (4, 6, 3)).repeat(8, axis=0).repeat(8, axis=1)


def exposed_cloud(exposure: float, reference: float | None) -> UnitSphereCloud:
    frame = RgbdFrame(encode_exposed(PICTURE, exposure), np.full((32, 48), 2.0), CAMERA, np.eye(4), exposure)
    points = unproject_frame(frame, reference_exposure=reference)
    return sample_unit_sphere(points, np.array([0.0, 0.0, -0.5]), LATTICE)


def reason_for_exposure(exposure: float) -> TriggerDecision:
    """The same room at two exposures, both brought to the session's."""
    return decide_trigger(exposed_cloud(1.0, 1.0), exposed_cloud(exposure, 1.0), LATTICE, TriggerSettings(theta=0.001))


def reason_for_raw_exposure(exposure: float) -> TriggerDecision:
    """Naive: colours as they came."""
    return decide_trigger(
        exposed_cloud(1.0, None), exposed_cloud(exposure, None), LATTICE, TriggerSettings(theta=0.001)
    )


EXPOSURE = [
    HardCase(
        STAGE,
        f"an exposure {name} does not fire by itself",
        exposure,
        reason_for_exposure,
        that("does not fire", lambda came: not came.fire),
        reason_for_raw_exposure,
    )
    for name, exposure in (("four times as long", 4.0), ("a quarter as long", 0.25), ("twice as long", 2.0))
]

CASES = [*MISTAKES, *EXPOSURE]
